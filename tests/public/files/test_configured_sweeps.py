"""Sweeps of configuration files: their members, and the numbers, states and systems of each."""

import math

import numpy as np
import pytest
import xarray
from scipy.linalg import expm

import coadjoint as co
from configuration_files import READY_MADE
from rounding import UNIT_ROUNDOFF
from same_runs import same_bits

BODY = READY_MADE.replace("t_span = [0, 1]\nstep = 0.1", "t_span = [0, 0.25]\nstep = 0.125")
BODY = BODY.replace("x = [1.0, 0.1, 0.5]", "x = [2, 1, 3]")
SPIRAL = """
algebra = {name = "A3,7", parameters = {a = 2.0}}
hamiltonian = {M = [1.0, 2.0, 0.5]}
initial = {x = [0.25, 1.0, -0.5]}
run = {t_span = [0, 0.125], step = 0.125}
"""
THIRD = '"system.parameters.inertia[2]"'


@pytest.fixture
def swept(files):
    """Run a sweep, and return the stored solution."""
    return lambda over, beside="", text=BODY: files.run(f"{text}[sweep]\n{beside}\n[sweep.over]\n{over}\n")


def thirds(sol):
    return [body.parameters["inertia"][2] for body in sol.system]


def test_the_last_key_varies_fastest(swept):
    sol = swept(f'{THIRD} = {{ linear = [1.5, 3.0], count = 4 }}\n"initial.x[1]" = [0.25, -0.5]')
    assert thirds(sol) == [1.5, 1.5, 2.0, 2.0, 2.5, 2.5, 3.0, 3.0]
    assert sol.x0.tolist() == [[2.0, x, 3.0] for x in [0.25, -0.5] * 4]
    assert sol.dataset["swept_x_1"].values.tolist() == [0.25, -0.5] * 4
    assert sol.dataset["swept_inertia_2"].attrs["long_name"] == "system.parameters.inertia[2]"


def test_members_have_the_bits_of_single_files(files, swept):
    over = (
        f'{THIRD} = [2.5, 2.75]\n"initial.x" = {{ sphere = 2.0 }}\n'
        '"system.parameters.inertia[0]" = { uniform = [0.75, 1.0] }'
    )
    sol = swept(over, "samples = 3\nseed = 1")
    assert sol.x.shape == (3, 6, 3)
    assert len({tuple(x) for x in sol.x0.tolist()}) == 3, "the same samples at both values of the grid"
    for member in range(6):
        inertia = [float(sol.dataset["swept_inertia_0"][member]), 2.0, [2.5, 2.75][member // 3]]
        alone = BODY.replace("[1.0, 2.0, 2.5]", repr(inertia)).replace("[2, 1, 3]", repr(sol.x0[member].tolist()))
        assert same_bits(files.run(alone, out="alone.nc", name="alone.toml").x, sol.x[:, member])


@pytest.mark.parametrize("count", [2, 7])
@pytest.mark.parametrize("ends", [[0, 1], [6, -6], [-3, 3.5], [0.1, 0.7], [-0.3, -2.9], [7.1, 1e-3], [2, 128]])
def test_grids_have_both_ends_and_equal_parts(swept, ends, count):
    found = swept(f'"initial.x[1]" = {{ linear = {ends}, count = {count} }}').x0[:, 1]
    assert (found[0], found[-1]) == tuple(ends), "exactly"
    # Both sides round a product and a sum of numbers up to twice the size.
    np.testing.assert_allclose(found, np.linspace(*ends, count), rtol=0, atol=8 * UNIT_ROUNDOFF * max(map(abs, ends)))
    if ends[0] * ends[1] > 0.0:
        found = swept(f'"initial.x[1]" = {{ logarithmic = {ends}, count = {count} }}').x0[:, 1]
        assert (found[0], found[-1]) == tuple(ends)
        np.testing.assert_allclose(found, np.geomspace(*ends, count), rtol=1e-14)


def test_integers_stay_integers_and_truncate_no_setting(swept):
    """Parameters such as a seed or a number of sites are integers."""
    toda = 'system = {name = "spin_lattice", parameters = {shape = 2}}\ninitial = {x = [1, 0, 0, 0, 1, 0]}\n'
    toda += "run = {t_span = [0, 0.125], step = 0.125}\n"
    sol = swept('"system.parameters.exchange" = { linear = [-2, 4], count = 4 }', text=toda)
    assert sol.dataset["swept_exchange"].values.tolist() == [-2, 0, 2, 4]
    assert sol.dataset["swept_exchange"].dtype.kind == "i"
    assert swept('"initial.x[1]" = [7, 0.25]').x0.tolist() == [[2.0, 7.0, 3.0], [2.0, 0.25, 3.0]]
    assert thirds(swept(f"{THIRD} = [2, 2.75]")) == [2.0, 2.75]


def test_rows_of_files_are_combined(files, swept):
    np.save("table.npy", np.array([[2.5, 0.25, 1.0], [3.0, 0.5, 2.0], [2.75, 0.75, 3.0]]))
    np.save("states.npy", np.eye(3)[:2] + 0.5)
    columns = [f'{{ file = "table.npy", column = {k} }}' for k in (0, 1)]
    sol = swept(f'{THIRD} = {columns[0]}\n"initial.x[1]" = {columns[1]}')
    assert thirds(sol) == [2.5, 3.0, 2.75] and sol.x0[:, 1].tolist() == [0.25, 0.5, 0.75]
    np.testing.assert_array_equal(swept('"initial.x" = { file = "states.npy" }').x0, np.eye(3)[:2] + 0.5)
    text = BODY.replace("x = [2, 1, 3]\n", "")
    assert swept('"initial.x" = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]', "", text).x0[1].tolist() == [0.0, 1.0, 0.5]


def draws(swept, key, kind, samples=1000, seed=1, text=BODY):
    return swept(f'"{key}" = {kind}', f"samples = {samples}\nseed = {seed}", text).x0


def test_samples_depend_on_seed_key_and_number(swept):
    few = draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 2, 7)
    np.testing.assert_array_equal(draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 5, 7)[:2], few)
    assert not np.any(draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 2, 8) == few)
    over = f'{THIRD} = {{ uniform = [2, 3] }}\n"initial.x" = {{ normal = [0.0, 1.0] }}'
    np.testing.assert_array_equal(swept(over, "samples = 2\nseed = 7").x0, few)
    zero = draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 2, 0)
    assert not np.any(zero == few)


def test_distributions_have_their_moments(swept):
    """Means of 1000 numbers are within five standard errors."""
    flat = draws(swept, "initial.x", "{ uniform = [[1.0, -2.0, 5.0], [3.0, 0.0, 6.0]] }")
    assert np.all((flat >= [1.0, -2.0, 5.0]) & (flat < [3.0, 0.0, 6.0]))
    assert np.all(abs(flat.mean(axis=0) - [2.0, -1.0, 5.5]) < 5 * 2 / math.sqrt(12 * 1000))
    bell = draws(swept, "initial.x", "{ normal = [[1.0, 0.0, -1.0], 0.5] }")
    assert np.all(abs(bell.mean(axis=0) - [1.0, 0.0, -1.0]) < 5 * 0.5 / math.sqrt(1000))
    assert np.all(abs(bell.var(axis=0) - 0.25) < 5 * 0.25 * math.sqrt(2 / 1000))
    ball = draws(swept, "initial.x", "{ sphere = 2.0 }")
    np.testing.assert_allclose(np.linalg.norm(ball, axis=1), 2.0, rtol=1e-15)
    assert np.all(abs(ball.mean(axis=0)) < 5 * 2 / math.sqrt(3 * 1000))
    # Spheres and orbits use the normal numbers of their key; means and widths may be zero.
    normal = draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 5)
    np.testing.assert_allclose(ball[:5], 2.0 * normal / np.linalg.norm(normal, axis=1, keepdims=True), rtol=1e-15)
    drawn = draws(swept, "initial.x", "{ normal = [[1.0, 2.0, 0.0], [0.5, 0, 2.0]] }", 5)
    np.testing.assert_array_equal(drawn, [1.0, 2.0, 0.0] + np.array([0.5, 0.0, 2.0]) * normal)


def test_random_numbers_of_keys_are_independent(swept):
    keys = ["initial.x[0]", "initial.x[1]", "initial.x[2]", "system.parameters.inertia[0]"]
    over = "\n".join(f'"{key}" = {{ uniform = [2.0, 3.0] }}' for key in keys)
    sol = swept(over, "samples = 64\nseed = 5", BODY.replace("[1.0, 2.0, 2.5]", "[2.0, 2.0, 2.5]"))
    assert sol.x0.shape == (64, 3), "random keys go together"
    found = np.array([*sol.x0.T, sol.dataset["swept_inertia_0"].values])
    assert len(set(found.ravel().tolist())) == 64 * len(keys), "no number occurs twice"
    # Correlations of 64 independent pairs have the deviation 1/8; five of them are exceeded once in a million.
    assert np.all(abs(np.corrcoef(found) - np.eye(len(keys))) < 5 / 8)


@pytest.mark.parametrize("first", ["samples", "grid"])
def test_orbits_are_those_of_the_algebra_of_the_member(swept, first):
    """exp(ad*) by SciPy is the reference: series of alternating sums lose at most e^2 for each piece of size 1."""
    lines = ['"initial.x" = { orbit = 0.75 }', '"algebra.parameters.a" = [0.5, 1.5]']
    sol = swept("\n".join(lines if first == "samples" else lines[::-1]), "samples = 3\nseed = 1", SPIRAL)
    normal = draws(swept, "initial.x", "{ normal = [0.0, 1.0] }", 3, 1, SPIRAL)
    for member, (system, state) in enumerate(zip(sol.system, sol.x0, strict=True)):
        sample, value = (member // 2, member % 2) if first == "samples" else (member % 3, member // 3)
        assert system.algebra == co.algebras.get("A3,7", a=[0.5, 1.5][value])
        exact = np.array(expm(system.algebra.coadjoint(0.75 * normal[sample]))) @ [0.25, 1.0, -0.5]
        np.testing.assert_allclose(state, exact, rtol=0, atol=1e-14 * np.linalg.norm(exact) * math.exp(2))


@pytest.mark.parametrize(("name", "size"), [("so(3)", 40.0), ("e(3)", 0.5), ("sl(2)", 0.5), ("A4,1", 0.5)])
def test_orbits_preserve_casimirs(swept, name, size):
    """Also over several turns."""
    g = co.algebras.get(name)
    x = np.linspace(0.5, 1.5, g.dim)
    text = SPIRAL.replace('"A3,7", parameters = {a = 2.0}', f'"{name}"').replace("[0.25, 1.0, -0.5]", str(x.tolist()))
    text = text.replace("[1.0, 2.0, 0.5]", str(np.linspace(1.0, 2.0, g.dim).tolist()))
    found = draws(swept, "initial.x", f"{{ orbit = {size} }}", 3, 2, text)
    assert np.all(np.linalg.norm(found - x, axis=1) > 0.1)
    for casimir in g.casimirs().values():
        # Each of 40 pieces loses a few units of the last place.
        assert [casimir(y) for y in found] == pytest.approx([casimir(x)] * 3, rel=1e-12 * max(1, size), abs=1e-12)


def test_named_states_forces_and_constants_are_swept(files, swept):
    fluid = """
    system = {name = "torus_euler", parameters = {N = 5}}
    initial = {kind = "random", seed = 1}
    run = {t_span = [0, 0.5], step = 0.5}
    """
    sol = swept('"initial.seed" = {linear = [1, 3], count = 3}', text=fluid)
    for member, seed in enumerate((1, 2, 3)):
        np.testing.assert_array_equal(sol.x0[member], co.systems.torus_euler(N=5).random(seed))
    over = '"algebra.parameters.a" = [0.5, 1.0]\n"hamiltonian.M[1]" = [2, 3]\n"forces[0].rate" = [0.1, 0.2]'
    sol = swept(over, text=SPIRAL + 'forces = [{name = "LinearDamping", rate = 0.1}]\n')
    assert [system.forces[0].rate for system in sol.system] == [0.1, 0.2] * 4
    assert [system.unforced.hamiltonian.value(np.array([0.0, 1.0, 0.0])) for system in sol.system] == [
        1,
        1,
        1.5,
        1.5,
    ] * 2


def test_swept_keys_are_coordinates_of_datasets_and_archives(files, swept):
    over = '"system.parameters.inertia" = [[1, 2, 3], [1, 2, 2.5]]\n"initial.x[2]" = [0.5, 0.25]\n'
    sol = swept(over)
    assert sol.dataset["swept_inertia_2"].values.tolist() == [3.0, 3.0, 2.5, 2.5]
    with xarray.open_dataset("run.nc", engine="h5netcdf") as stored:
        assert stored.swap_dims(member="swept_x_2").sizes["swept_x_2"] == 4
        assert stored["swept_inertia_0"].dims == ("member",)
    found = files.run(f'{BODY}[output]\narchive = "run.zarr"\n[sweep.over]\n{over}')
    assert same_bits(found.x, sol.x)
    archived = co.open_archive("run.zarr").to_xarray()
    assert archived["swept_x_2"].values.tolist() == [0.5, 0.25] * 2
    assert archived["swept_inertia_2"].values.tolist() == [3.0, 3.0, 2.5, 2.5]


def test_swept_matrices_and_equal_names_are_distinct_coordinates(swept):
    own = SPIRAL.replace("[1.0, 2.0, 0.5]", "[[1, 0, 0], [0, 2, 0], [0, 0, 1]]")
    over = '"hamiltonian.M" = [[[1, 0, 0], [0, 2, 0], [0, 0, 5]], [[2, 0.5, 0], [0.5, 3, 0], [0, 0, 1]]]'
    found = swept(f'{over}\n"initial.x" = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]', text=own).dataset
    for i in range(3):
        for j in range(3):
            assert found[f"swept_hamiltonian_M_{i}_{j}"].attrs["long_name"] == f"hamiltonian.M[{i}][{j}]"
    assert found["swept_hamiltonian_M_0_1"].values.tolist() == [0.0, 0.0, 0.5, 0.5]
    assert "swept_x_0" not in found.coords, "whole states are the initial states"
