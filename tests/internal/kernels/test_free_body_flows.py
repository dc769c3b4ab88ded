"""Splittings into free bodies: each flow is the closed form, in every order of the axes and any representation."""

import itertools

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution
from group_elements import random_element
from rounding import UNIT_ROUNDOFF as U

SO3 = co.algebras.so(3)
ORDERS = list(itertools.permutations(range(3)))
SIGNS = list(itertools.product((1.0, -1.0), repeat=3))


def free_body(**options):
    return co.Splitting(parts="free_body", **options)


def body(M, sign=-1):
    return co.LiePoissonSystem(SO3, co.Quadratic(M), sign=sign)


def gap(size):
    """A state at a relative distance from the separatrix of m = (1, 0.5, 0.3)."""
    return (1.0, 0.5, 0.3), (np.sqrt(0.4) * 1.1 * (1.0 + size), 0.6, 1.1)


STATES = {
    "generic": ((1.0, 0.5, 1 / 3), (1.0, 2.0, 0.5)),
    **{f"gap {size:g}": gap(size) for size in (1e-2, -1e-4, 1e-6, -1e-8, 1e-10, -1e-12)},
    "separatrix": ((1.25, 1.0, 0.0), (2.0, 0.75, 1.0)),
    "middle axis": ((1.0, 0.5, 0.25), (0.0, -2.0, 0.0)),
    "at rest": ((1.0, 0.5, 0.25), (0.0, 0.0, 0.0)),
    "two equal": ((0.5, 0.5, 0.8), (0.3, -0.4, 1.2)),
    "almost equal": ((0.5, 0.5 + 2.0**-30, 0.8), (0.3, -0.4, 1.2)),
    "three equal": ((0.6, 0.6, 0.6), (0.3, -0.4, 1.2)),
    "of both signs": ((1.0, -0.5, 0.25), (1.0, 0.5, -1.0)),
}


@pytest.mark.thinned(5)
@pytest.mark.parametrize("name", STATES)
def test_a_step_of_any_length_is_the_closed_form_in_every_order_and_sign(name):
    m, x0 = (np.array(values) for values in STATES[name])
    for order in ORDERS:
        own, start = m[list(order)], x0[list(order)]
        ensemble = start * np.array(SIGNS)
        for sign, h in ((-1, 0.03), (-1, 2.0), (1, 7.0), (-1, -11.0)):
            found = co.integrate(body(own, sign), ensemble, (0.0, h), abs(h), free_body(), attitude=True)
            # 1/8 radian of nonlinear motion is a piece, with some 2^5 roundings; what they move grows with the phase.
            pieces = 1.0 + np.ptp(own) * np.linalg.norm(x0) * abs(h) * 8.0
            phase = 1.0 + np.abs(own).max() * np.linalg.norm(x0) * abs(h)
            bound = 2.0**5 * U * max(np.sqrt(pieces) * 2.0, phase)
            # Near a separatrix, exp(lam t) amplifies rounding, until |x|^2/gap.
            lam = np.ptp(own) * np.linalg.norm(x0) / 2.0
            bound *= np.exp(lam * abs(h)) if "gap" in name or "axis" in name or "separatrix" in name else 1.0
            for k, state in enumerate(ensemble):
                x, A = exact_solution(own, sign, state, h, True)
                assert np.abs(found.x[-1, k] - x).max() <= bound * np.linalg.norm(x0), (order, k, h)
                assert np.abs(found.attitude[-1, k] - A).max() <= bound, (order, k, h)


@pytest.mark.parametrize("seed", range(12))
def test_full_matrices_of_any_signature(seed):
    rng = np.random.default_rng(seed)
    B = rng.standard_normal((3, 3))
    M, x0, sign, h = B + B.T, rng.standard_normal(3), int(rng.choice([-1, 1])), float(rng.choice([0.1, 0.9, 4.0]))
    first = random_element(co.algebras.so(3).representation, seed)
    run = co.integrate(body(M, sign), x0, (0.0, 5 * h), h, free_body(), attitude=first)
    x, A = exact_solution(M, sign, x0, run.t, first)
    bound = 2.0**6 * U * (1.0 + 5 * h * np.linalg.norm(M, 2) * np.linalg.norm(x0)) * max(1.0, np.linalg.norm(x0))
    assert np.abs(run.x - x).max() <= bound
    assert np.abs(run.attitude - A).max() <= bound


def spin_representation():
    """su(2) on C^2 as real 4 x 4 matrices: every block turns by half the angle."""
    pauli = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
    rho = -0.5j * pauli
    return np.array([np.block([[r.real, -r.imag], [r.imag, r.real]]) for r in rho])


@pytest.mark.parametrize("seed", range(4))
def test_the_attitude_of_a_spinor_keeps_its_sign(seed):
    """Against steps so short that the turn in each is small: a whole turn is minus the unit matrix."""
    rng = np.random.default_rng(seed)
    M, x0 = np.diag(rng.uniform(0.5, 2.0, 3)), 2.0 * rng.standard_normal(3)
    spin = co.LiePoissonSystem(SO3, co.Quadratic(M), sign=-1, representation=spin_representation())
    fine = co.integrate(spin, x0, (0.0, 8.0), 2.0**-5, free_body(), attitude=True, save_every=16)
    coarse = co.integrate(spin, x0, (0.0, 8.0), 0.5, free_body(), attitude=True)
    assert np.abs(fine.attitude - coarse.attitude).max() <= 2.0**10 * U * np.linalg.norm(x0)
    assert any(np.trace(g) < 0 for g in coarse.attitude)
