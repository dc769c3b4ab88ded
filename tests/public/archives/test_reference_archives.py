"""Stored archives of interrupted runs are read, and resumed to the bits of a run of today.

Runs of sums, products, quotients and square roots alone: for vectors the bits do not depend on the machine. Products of
matrices depend on BLAS: such archives of another machine are read to round-off, and not resumed if their first step has
other bits.
"""

import zipfile
from pathlib import Path

import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF
from same_runs import check_same

ARCHIVES = Path(__file__).parent / "reference_archives"
SPAN, STEP, CUT, EVERY = (0.0, 4.0), 0.125, 13, 2
BODY, X = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.array([0.25, -1.0, 0.75])
RUNS = {
    "vector": (BODY, X, co.GaussLegendre(2), {"attitude": "coadjoint"}),
    "members": (BODY, np.multiply.outer([1.0, 0.5, 0.25], X), co.Splitting(order=4), {}),
    "damped": (BODY.with_forces(co.forces.LinearDamping(0.125)), X, co.GaussLegendre(1), {}),
}


@pytest.fixture(params=[1, 2])
def folder(request, tmp_path):
    with zipfile.ZipFile(ARCHIVES / f"format_{request.param}.zip") as archives:
        archives.extractall(tmp_path)
    return tmp_path


@pytest.mark.sensitive
@pytest.mark.parametrize("name", RUNS)
def test_vector_runs_resume_to_the_same_bits(folder, name):
    system, x0, method, options = RUNS[name]
    expected = co.integrate(system, x0, SPAN, STEP, method, save_every=EVERY, **options)
    found = co.open_archive(folder / f"{name}.zarr")
    assert (found.reached, found.finished) == (CUT, False)
    assert np.array_equal(found.x, expected.x[: CUT // EVERY + 1])
    check_same(co.resume(folder / f"{name}.zarr"), expected)
    assert co.open_archive(folder / f"{name}.zarr").attributes["archive_format"] == found.attributes["archive_format"]


@pytest.mark.sensitive
def test_ensembles_in_blocks_are_read(folder):
    check_same(co.open_archive(folder / "blocks.zarr"), co.integrate(BODY, RUNS["members"][1], SPAN, STEP))


@pytest.mark.sensitive
def test_matrix_runs_are_read_to_round_off(folder):
    """A product of matrices of N rows has an error of 2N round-offs, which grows as a change of the initial state."""
    fluid, method, N = co.systems.sphere_euler(4), co.IsospectralGauss(1), 4
    W = np.diag([0.75j, 0.25j, -0.5j, -0.5j]) + 0.125 * (np.eye(4, k=1) - np.eye(4, k=-1))
    expected = co.integrate(fluid, W, SPAN, STEP, method, save_every=EVERY)
    growth = 1.0
    for seed in range(4):
        near = W + 2.0**-26 * fluid.random(seed=seed)
        moved = co.integrate(fluid, near, SPAN, STEP, method, save_every=EVERY).x - expected.x
        growth = max(growth, np.abs(moved).max() / np.abs(near - W).max())
    tolerance = 8 * 2 * N * round(SPAN[1] / STEP) * UNIT_ROUNDOFF * growth
    found = co.open_archive(folder / "matrix.zarr")
    count = len(found.x)
    assert (found.reached, found.finished, count) == (CUT, False, CUT // EVERY + 1)
    assert np.array_equal(found.t, expected.t[:count])
    assert np.abs(found.x - expected.x[:count]).max() <= tolerance
    # Of matrices of size one the energy and traces of up to N-th powers change by at most 4 N times as much.
    # Archives of version 1.0 have the energy of a fluid in the unit of the matrix.
    of_surface = found.attributes["archive_format"] > 1
    energy = found.energy if of_surface else 4 * np.pi / (N**2 - 1) * found.energy
    assert np.abs(energy - expected.energy[:count]).max() <= 4 * N * tolerance
    for name, values in expected.casimirs.items():
        assert np.abs(found.casimirs[name] - values[:count]).max() <= 4 * N * tolerance, name
    try:
        resumed = co.resume(folder / "matrix.zarr")
    except ValueError as error:
        assert "differs in bits" in str(error) and not np.array_equal(found.x, expected.x[:count])
    else:
        assert np.abs(resumed.x - expected.x).max() <= tolerance
