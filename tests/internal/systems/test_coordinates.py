"""Names and groups of coordinates, and what callers ask of any system: forced, in a batch, of matrices or own."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import coadjoint as co
from coadjoint.algebra.exact.sparse_sums import strongly_connected
from coadjoint.systems.coordinates import CoordinateGroups, coordinate_names, coordinates_of


@pytest.mark.parametrize("seed", range(20))
def test_strong_components_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    for _ in range(30):
        size, edges = rng.integers(1, 16), rng.integers(0, 40)
        first, second = rng.integers(0, size, edges), rng.integers(0, size, edges)
        graph = coo_array((np.ones(edges), (first, second)), shape=(size, size)).tocsr()
        _, expected = connected_components(graph, connection="strong")
        smallest = [int(np.flatnonzero(expected == number).min()) for number in expected]
        assert strongly_connected(size, first, second).tolist() == smallest


def groups(system):
    found = CoordinateGroups(system)
    return dict(zip(found.names(), np.bincount(found.labels).tolist(), strict=True))


@pytest.mark.parametrize(
    ("system", "expected"),
    [
        (co.systems.rigid_body(), {"x": 3}),
        (co.systems.heavy_top(), {"m": 3, "gamma": 3}),
        (co.systems.satellite(), {"L": 3, "p": 3, "r": 3, "z": 1}),
        (co.systems.manakov_top(), {"x": 6}),
        (co.systems.riccati(), {"x": 3}),
        (co.systems.spin_lattice("chain", 3), {"S[1]": 3, "S[2]": 3, "S[3]": 3}),
        (co.systems.toda(3), {"b1": 1, "b2": 1, "b3": 1, "a1": 1, "a2": 1}),
        (co.systems.vlasov_moments(), {"x20, x11, x02": 3, "x40, ..., x04": 5}),
        (co.systems.sklyanin(), {"x": 4}),  # no structure constants
        (co.systems.sphere_euler(N=5), {"x": 50}),  # matrices
        (co.systems.rigid_body().with_forces(co.forces.LinearDamping(0.1)), {"x": 3}),
        (co.batch([co.systems.heavy_top(), co.systems.heavy_top()]), {"m": 3, "gamma": 3}),
    ],
    ids=lambda value: getattr(value, "name", "") or "",
)
def test_of_ready_made_systems(system, expected):
    assert groups(system) == expected


@pytest.mark.parametrize("name", co.systems.names())
def test_names_are_unique_and_norms_those_of_the_coordinates(name):
    system = co.systems.get(name)
    found = CoordinateGroups(system)
    assert len(set(found.names())) == found.count == len(np.unique(found.labels))
    x = np.random.default_rng(1).normal(size=(2, 4, system.dim))
    expected = [np.linalg.norm(x[..., found.labels == g], axis=-1) for g in range(found.count)]
    np.testing.assert_allclose(found.norms(x), np.stack(expected, axis=-1), rtol=1e-14)


BODY = co.systems.rigid_body(inertia=(1, 2, 3))
DAMPED = BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0, 0, 0.2)))


def test_attributes_of_own_systems_are_not_those_of_forces_and_batches():
    own = type("Own", (co.System,), {"name": "own body", "dim": 3, "algebra": BODY.algebra, "systems": ("SI", "CGS")})()
    assert coordinates_of(own) == coordinate_names(own) == ("x1", "x2", "x3")
    assert coordinate_names(co.batch([DAMPED, DAMPED])) == coordinate_names(BODY)
