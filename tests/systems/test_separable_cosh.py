"""Separable Hamiltonians that are no polynomials, on algebras that are not so(3) alone."""

import mpmath as mp
import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.kernels.functions.compiled_functions import FormulaFunction
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.recording import values_along

CASES = {
    "A3,7": ({"a": 1.5}, (1.0, 0.7, -0.3), (0.7, 0.5, 0.4)),
    "e(3)": ({}, (1.0, 0.5, 0.4, 0.3, 0.0, 0.2), (0.7, -0.5, 0.9, 0.6, 0.2, 0.8)),
    "so(4)": ({}, (0.8, 0.4, 0.7, 0.3, 0.5, 1.0), (0.7, 0.5, -0.4, 0.6, -0.8, 0.3)),
}


def made(name, stiffness=1.25):
    constants, masses, x0 = CASES[name]
    return co.systems.separable_cosh(name, masses, stiffness, constants), np.array(x0)


def by_hand(system, masses, kappa, x):
    """J(x) grad H, from the structure constants one by one, in the numbers that x has."""
    force = [m * mp.sinh(kappa * y) / kappa for m, y in zip(masses, x, strict=True)]
    slope = [mp.mpf(0)] * len(x)
    for i, j, k, c in zip(*(column.tolist() for column in system.algebra.triples), strict=True):
        slope[i] += c * x[k] * force[j]
        slope[j] -= c * x[k] * force[i]
    return slope


@pytest.mark.parametrize("name", CASES)
def test_energy_field_and_orders(name):
    system, x0 = made(name)
    masses = CASES[name][1]
    energy = sum(m * (np.cosh(1.25 * y) - 1) / 1.25**2 for m, y in zip(masses, x0, strict=True))
    assert system.energy(x0) == pytest.approx(energy, rel=1e-14) and system.sign == 1
    with mp.workdps(20):
        field = [float(v) for v in by_hand(system, masses, mp.mpf(1.25), [mp.mpf(v) for v in x0])]
        motion = mp.odefun(lambda t, x: by_hand(system, masses, mp.mpf(1.25), x), 0, [mp.mpf(v) for v in x0])
        wanted = np.array([float(v) for v in motion(0.5)])
    np.testing.assert_allclose(system.vector_field(x0), field, rtol=0, atol=2e-15)
    for method in (co.Splitting(order=2), co.Splitting(order=4)):
        assert_order(system, x0, 0.5, 0.0625, method, wanted)


@pytest.mark.parametrize("name", CASES)
def test_it_is_made_again_from_its_parameters(name):
    system, x0 = made(name)
    again = co.systems.get("separable_cosh", **system.parameters)
    assert again.parameters == system.parameters
    np.testing.assert_array_equal(again.vector_field(x0), system.vector_field(x0))
    assert again.energy(x0) == system.energy(x0)


def test_casimirs_are_kept_and_the_energy_is_bounded():
    system, x0 = made("e(3)")
    run = co.integrate(system, x0, (0.0, 50.0), 0.1, co.Splitting(order=2))
    assert all(run.drift()[name] < 500 * 1e-15 for name in system.casimirs) and len(system.casimirs) == 2
    assert_bounded_by_order(system.energy, system, x0, 20.0, 0.1, co.Splitting(order=2))


def test_hessian_and_small_momenta():
    system, x0 = made("A3,7", stiffness=2.0)
    np.testing.assert_allclose(
        np.diag(system.hamiltonian.hessian(x0)), (1.0, 0.7, -0.3) * np.cosh(2.0 * x0), rtol=1e-15
    )
    tiny = 1e-9 * x0
    assert system.energy(tiny) == pytest.approx(np.dot((0.5, 0.35, -0.15), tiny**2), rel=1e-14)


def test_the_kernels_have_the_formula_and_its_multiples():
    """Value, slope and curvature of each function by its tables, also of 3 H: rounding of a few operations."""
    mass, kappa = 0.7, 1.25
    system = co.systems.separable_cosh("A3,7", (1.0, mass, -0.3), kappa, {"a": 1.5})
    points = np.concatenate([np.linspace(-3.0, 3.0, 25), [1e-12, -1e-5, 40.0, 565.0]])
    for factor, hamiltonian in ((1.0, system.hamiltonian), (3.0, system.hamiltonian.times(3.0))):
        term = hamiltonian.functions()[1]
        with mp.workdps(40):
            exact = {
                "value": [mass * 2 * (mp.sinh(mp.mpf(kappa * y) / 2) / kappa) ** 2 for y in points],
                "gradient": [mass * mp.sinh(mp.mpf(kappa * y)) / kappa for y in points],
                "hessian": [mass * mp.cosh(mp.mpf(kappa * y)) for y in points],
            }
        for which, wanted in exact.items():
            table = invariants_table([(which, co.Invariant(getattr(term, which)))], 1)
            assert [type(kept) for kept in table.keepalive] == [FormulaFunction]
            found = np.empty((len(points), 1, 1))
            values_along(table.tables, points[:, None, None], np.zeros(len(points)), found)
            expected = [float(factor * number) for number in wanted]
            np.testing.assert_allclose(found[:, 0, 0], expected, rtol=2.0**-53 * 24)
