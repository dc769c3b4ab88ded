"""Rows that only rotate and shear are read ahead of the steps: the bits of reading tables, alone and in an ensemble."""

from __future__ import annotations

import numpy as np
import pytest
from test_flow import SO3, SYSTEMS

import coadjoint as co
from coadjoint.kernels.tables import flow
from coadjoint.program.blocks import Kind

pytestmark = pytest.mark.thinned(6)

I4 = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0]]) / 2
J4 = np.array([[0, 0, -1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [0, -1, 0, 0]]) / 2
QUATERNIONS = np.array([I4, J4, 2 * I4 @ J4])  # the group element turns at half the frequency
DIAGONAL = co.Quadratic([1.0, 0.5, 0.25], linear=[0.0, 0.5, 0.0])
# The first flow of a part moves both coordinates of the form of the second, their difference but for rounding not.
MOVED = co.LieAlgebra.from_brackets(5, {(0, 1): {4: 1.0}, (0, 2): {4: 1.0}, (1, 2): {4: 1.0}, (1, 3): {4: 1.0}})
DIFFERENCE = np.diag([1.0, 1.0, 1.0, 1.0, 0.0])
DIFFERENCE[1, 2] = DIFFERENCE[2, 1] = -1.0
ALGEBRAS = {
    "moved form": (MOVED, co.Quadratic(DIFFERENCE)),
    **SYSTEMS,
    "so(3) diagonal": (SO3, DIAGONAL),
    "so(4) diagonal": (co.algebras.so(4), co.Quadratic(np.linspace(0.5, 1.5, 6))),
    "so(6) diagonal": (co.algebras.so(6), co.Quadratic(np.linspace(0.5, 1.5, 15))),
    "su(3) diagonal": (co.algebras.su(3), co.Quadratic(np.linspace(0.5, 1.5, 8))),
    "10 spins": (co.algebras.copies(SO3, 10), co.Quadratic(np.linspace(0.5, 1.5, 30))),
}
CASES = {
    **{name: co.LiePoissonSystem(*given) for name, given in ALGEBRAS.items()},
    "so(3), quaternions": co.LiePoissonSystem(SO3, DIAGONAL, representation=QUATERNIONS),
}
METHODS = (
    co.Splitting(order=2),
    co.Splitting(order=4, compensated=True),
    co.Splitting(order=2, parts="coordinates"),
)
compiled_tables = flow.flow_tables


def read_row_by_row(program, h, compensated, compact=False):
    """Tables of the same flows in which no part only rotates and shears: each ends with scalings of no coordinate."""
    found = compiled_tables(program, h, compensated, compact)
    actions = {name: with_idle_scalings(getattr(found.tables, name)) for name in ("state", "group")}
    return found._replace(tables=found.tables._replace(**actions))


def with_idle_scalings(action):
    ends = action.run[1:].astype(np.int64)
    columns = ("angles", "repeat", "angle", "position", "constant", "width", "entries", "degree")
    longer = {name: np.insert(getattr(action, name), ends, 0) for name in columns}
    kind = np.insert(action.kind, ends, int(Kind.SCALE))
    return action._replace(run=action.run + np.arange(len(action.run), dtype=np.uint32), kind=kind, **longer)


RUNS = [
    (name, attitude)
    for name, system in CASES.items()
    for attitude in (False, "coadjoint", True)
    if attitude is not True or system.representation is not None
]


@pytest.mark.thinned(60)
@pytest.mark.parametrize("method", METHODS, ids=repr)
@pytest.mark.parametrize(("name", "attitude"), RUNS)
def test_rows_read_ahead_have_the_bits_of_the_tables(monkeypatch, name, attitude, method):
    system = CASES[name]
    x0, span, h = np.linspace(-0.5, 0.7, system.dim), (0.0, 2.0), 0.0625

    def run(x):
        return co.integrate(system, x, span, h, method, attitude=attitude, save_every=4, threads=1)

    ahead, ensemble = run(x0), run(np.tile(x0, (5, 1)))
    monkeypatch.setattr(flow, "flow_tables", read_row_by_row)
    by_row = run(x0)
    for field in ("x", "energy", *(["attitude"] if attitude else [])):
        found = getattr(ahead, field)
        assert np.array_equal(found, getattr(by_row, field))
        assert np.array_equal(found, getattr(ensemble, field)[:, 4])
    assert ahead.stats.evaluations == by_row.stats.evaluations
