"""Bodies in fluids: by hand, where they are, and the integrals of bodies of revolution and of Clebsch."""

import json

import numpy as np
import pytest
from motions import FULL, ORDERS, U, assert_bounded, assert_integrals, by_hand, errors, turned

import coadjoint as co
from coadjoint.files.records.records import record_of, system_of

MASS = np.array([[3.0, -0.5, 0.2], [-0.5, 2.0, 0.1], [0.2, 0.1, 4.0]])
MIXED = np.array([[0.2, 0.5, -0.1], [0.0, -0.3, 0.4], [0.3, 0.1, 0.25]])


@pytest.mark.parametrize(
    ("inertia", "mass", "coupling"),
    [((1.0, 2.0, 3.5), (1.5, 0.5, 2.0), np.zeros((3, 3))), (FULL, MASS, MIXED), ((1.0, 2.0, 3.5), MASS, 0 * MIXED)],
)
def test_kirchhoffs_body_by_hand(inertia, mass, coupling):
    K = np.block(
        [
            [np.diag(inertia) if np.ndim(inertia) == 1 else inertia, coupling],
            [coupling.T, np.diag(mass) if np.ndim(mass) == 1 else mass],
        ]
    )
    body, x0 = co.systems.kirchhoff_body(inertia, mass, coupling), np.array([1.0, 0.5, -0.7, 0.6, 0.2, 0.8])

    def field(x):
        omega, v = np.split(np.linalg.solve(K, x), 2)
        return np.concatenate([np.cross(x[:3], omega) + np.cross(x[3:], v), np.cross(x[3:], omega)])

    np.testing.assert_allclose(body.vector_field(x0), field(x0), rtol=0, atol=64 * U)
    assert body.energy(x0) == pytest.approx(0.5 * x0 @ np.linalg.solve(K, x0), rel=64 * U)
    assert body.sign == -1 and body.integrals == {}
    coarse, fine = errors(body, x0, by_hand(field, x0, 5.0), 5.0, 0.05, co.Splitting(order=2))
    assert 3.0 < coarse / fine < 5.4
    again = system_of(json.loads(json.dumps(record_of(body))))
    np.testing.assert_array_equal(again.hamiltonian.hessian(x0), body.hamiltonian.hessian(x0))


def test_the_translation_of_a_body_in_a_fluid_is_its_position():
    K = np.block([[FULL, MIXED], [MIXED.T, MASS]])
    h, body = 1e-3, co.systems.kirchhoff_body(FULL, MASS, MIXED)
    sol = co.integrate(body, (1.0, 0.5, -0.7, 0.6, 0.2, 0.8), (0.0, 1.0), h, co.Splitting(order=4), attitude=True)
    A, r = sol.attitude[:, :3, :3], sol.attitude[:, :3, 3]
    m, p = (np.einsum("kij,kj->ki", A, part) for part in (sol.x[:, :3], sol.x[:, 3:]))
    rounding = 256 * U * len(sol.t)
    assert np.abs(p - p[0]).max() < rounding and np.abs(m + np.cross(r, p) - m[0]).max() < rounding
    velocity = np.einsum("kij,kj->ki", A, np.linalg.solve(K, sol.x.T).T[:, 3:])
    assert np.abs((r[2:] - r[:-2]) / (2 * h) - velocity[1:-1]).max() < h**2


@pytest.mark.parametrize("order", ORDERS)
def test_a_body_of_revolution_in_a_fluid(order):
    body = co.systems.kirchhoff_body(*turned(order, np.array([2.0, 2.0, 4.0]), np.array([1.0, 1.0, 0.5])))
    assert assert_integrals(body, [f"m{order.index(2) + 1}"]) == 4
    assert list(co.systems.kirchhoff_body((2, 2, 2), (1, 1, 1)).integrals) == ["m1", "m2", "m3"]


def test_a_body_is_of_revolution_by_its_inertia_and_by_its_mass_alike():
    assert co.systems.kirchhoff_body((1.0, 1.0, 2.0), (1.0, 1.0, 3.0)).integrals.keys() == {"m3"}
    for inertia, mass in (((1.0, 1.0, 2.0), (1.0, 2.0, 3.0)), ((1.0, 3.0, 2.0), (1.0, 1.0, 3.0))):
        assert co.systems.kirchhoff_body(inertia, mass).integrals == {}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("inertia", "c"),
    [((1, 1, 1), (1.0, 1.5, 3.0)), ((2, 2, 2), (-1, 0.5, 4)), ((1, 2, 4), (1.25, 2.0, 3.5)), ((1, 1, 4), (2, 2, 0.5))],
)
def test_clebschs_integral(order, inertia, c):
    inertia, c = turned(order, np.array(inertia, float), np.array(c, float))
    body = co.systems.clebsch_body(inertia, c)
    assert assert_integrals(body, ["F"]) == 4
    if (c > 0).all():
        same = co.systems.kirchhoff_body(inertia, 1 / c)
        x = np.cos(np.arange(6.0))
        np.testing.assert_allclose(body.vector_field(x), same.vector_field(x), rtol=0, atol=32 * U)
    if order == (0, 1, 2):
        assert_bounded(body, (1.0, -0.5, 0.6, 0.5, 1.0, -0.3))


def test_rounded_coefficients_of_clebsch_are_taken():
    rng = np.random.default_rng(5)
    for _ in range(50):
        inertia, (alpha, beta) = rng.uniform(0.3, 3.0, 3), rng.uniform(-2.0, 2.0, 2)
        assert co.systems.clebsch_body(inertia, alpha + beta * inertia).integrals


def test_nearest_clebsch_case_is_named():
    with pytest.raises(ValueError, match=r"not a Clebsch case: .* nearest valid .* 0\.833333, 1\.83333, 2\.83333"):
        co.systems.clebsch_body(inertia=(1, 2, 3))
