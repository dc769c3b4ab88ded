"""Negative controls: wrong input is refused, and wrong schemes fail the helpers that correct ones pass."""

import numpy as np
import pytest

import coadjoint as co

from . import measures
from .measures import Defect, drift_bounds, measured_order, order_of, poisson_defect
from .schemes_under_test import TRIPLE_JUMP
from .systems_under_test import Case, all_cases, cases, full_matrix
from .test_absolute_references import SYSTEMS, numbers, states_at, system_of


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("n", [4, 5, 7])
def test_random_antisymmetric_constants_are_no_lie_algebra(n, seed):
    c = np.random.default_rng(seed).uniform(-1, 1, (n, n, n))
    with pytest.raises(ValueError, match="Jacobi"):
        co.LieAlgebra(c - c.transpose(1, 0, 2))


@pytest.mark.parametrize("size", [1e-6, 1e-12])
def test_small_perturbation_of_an_algebra_is_refused(size):
    """so(4) with one constant off by a relative 1e-12, thousands of times round-off."""
    rows = [list(row) for row in zip(*co.algebras.so(4).triples, strict=True)]
    rows[0][3] *= 1 + size
    with pytest.raises(ValueError, match="Jacobi"):
        co.LieAlgebra([tuple(row) for row in rows], dim=6)


def test_rescaled_constants_of_so3_are_an_algebra():
    """So so(3) alone proves nothing."""
    rows = [(0, 1, 2, 0.3), (1, 2, 0, 1.7), (0, 2, 1, -2.5)]
    assert co.LieAlgebra(rows, dim=3).generic_rank() == 2


class QuarterSpeed(co.GaussLegendre):
    """A scheme whose coefficients run the motion at a quarter of its speed."""

    def coefficients(self, number=float):
        found = super().coefficients(number)
        return found._replace(scale=found.scale / 4)


@pytest.mark.parametrize("case", ["so(4), diagonal", "e(3), heavy top"])
def test_wrong_speed_is_detected_by_order_and_reference(case):
    slow = QuarterSpeed(3)
    system, x0, _ = cases()[case]
    run = co.integrate(system, x0, (0.0, 100.0), 0.1, slow, save_every=20)
    bounds = drift_bounds(run)
    assert all(run.drift()[name] <= bounds[name] for name in bounds)
    with pytest.raises(AssertionError):
        assert measured_order(slow, case).agrees_with(6)
    given = SYSTEMS["heavy_top_generic"]
    times = [state["t"] for state in given["states"]]
    found = states_at(system_of(given, given["sign"]), numbers(given["x0"]), times, 1, 16, slow)
    assert np.max(np.abs(found[0] - numbers(given["states"][0]["x"]))) > 1e-2


@pytest.mark.parametrize("what", ["sign", "index"])
def test_wrong_sign_and_index_are_detected(what):
    for name, given in SYSTEMS.items():
        wrong = (
            {**given, "hamiltonian": [[e[1:] + e[:1], c] for e, c in given["hamiltonian"]]}
            if what == "index"
            else given
        )
        if what == "index" and name.startswith("heisenberg"):
            continue  # this permutation is nearly a symmetry of the ring
        system = system_of(wrong, given["sign"] if what == "index" else -given["sign"])
        times = [given["states"][0]["t"]]
        found = states_at(system, numbers(given["x0"]), times, 1, 32, co.GaussLegendre(6))
        exact = numbers(given["states"][0]["x"])
        assert np.max(np.abs(found[0] - exact)) > 1e-3 * np.max(np.abs(exact)), name


WRONG_COEFFICIENTS = {
    # The last digits of c1 wrong: of order 2, with a small constant.
    "a wrong digit": (TRIPLE_JUMP[0] + 1e-3, 1 - 2 * TRIPLE_JUMP[0] - 2e-3, TRIPLE_JUMP[0] + 1e-3),
    "not a palindrome": (0.3, 0.5, 0.2),
    "plain thirds": (1 / 3, 1 / 3, 1 - 2 / 3),
}


@pytest.mark.parametrize("what", WRONG_COEFFICIENTS)
@pytest.mark.parametrize("base", [co.Splitting(order=2), co.GaussLegendre(1)])
@pytest.mark.parametrize("case", ["so(4), diagonal", "A3,7, full"])
def test_wrong_composition_is_not_of_order_four(case, base, what):
    wrong = co.Composition(base, WRONG_COEFFICIENTS[what])
    assert wrong.order < 4
    assert not measured_order(wrong, case).agrees_with(4)


def test_asymmetric_composition_is_not_symmetric():
    wrong, case = (
        co.Composition(co.Splitting(order=2), WRONG_COEFFICIENTS["not a palindrome"]),
        cases()["so(4), diagonal"],
    )
    assert not wrong.symmetric
    back = co.stepper(case.system, wrong, -0.25)(co.stepper(case.system, wrong, 0.25)(case.x0))
    assert np.max(np.abs(back - case.x0)) > 1e6 * measures.U


class DefectiveStep:
    """A stepper with one defect in its tangent or its state."""

    def __init__(self, step, state=None, tangent=None):
        self._step, self._state, self._tangent = step, state or (lambda x: x), tangent or (lambda P: P)
        self.system, self.method, self.h = step.system, step.method, step.h

    def __call__(self, x):
        return self._state(self._step(x))

    def tangent(self, x):
        return self._tangent(self._step.tangent(x))


@pytest.mark.parametrize("case", ["A3,7, full", "so(4), full, another basis", "e(3), split"])
def test_poisson_defect_detects_small_errors(case):
    system, x0, _ = cases()[case]
    step = co.stepper(system, co.Splitting(order=2), 0.1)
    right = poisson_defect(step, x0)
    assert right.value <= right.bound
    wrongs: list[Defect] = [
        poisson_defect(DefectiveStep(step, tangent=lambda P: P.T), x0),
        poisson_defect(DefectiveStep(step, tangent=lambda P: P * (1 + 1e-9)), x0),
        poisson_defect(DefectiveStep(step, state=lambda x: x + 1e-9), x0),
    ]
    assert all(wrong.value > wrong.bound for wrong in wrongs)


def test_drift_bound_detects_small_damping():
    case = cases()["so(4), full, another basis"]
    run = co.integrate(case.system, case.x0, (0.0, 100.0), 0.1, co.Splitting(order=2), save_every=10)
    bounds = drift_bounds(run)
    # |x| smaller by 1e-10 in each of a thousand steps moves a quadratic Casimir by 2e-7 of itself.
    for name, casimir in case.system.casimirs.items():
        assert 2e-7 * abs(casimir(case.x0)) > bounds[name]


def test_slope_fit_separates_neighbouring_orders():
    h = [0.2 / 2 ** (k / 2) for k in range(5)]
    for p in (1, 2, 4, 8):
        found = order_of(h, [3 * x**p * (1 + 0.8 * x) for x in h], 1)
        assert found.agrees_with(p)
        assert not found.agrees_with(p + 1) and not found.agrees_with(p - 1)
    # A plateau agrees with no order.
    assert not any(order_of(h, [1e-12 * (1 + 0.3 * (-1) ** k) for k in range(5)], 1).agrees_with(p) for p in (1, 2, 4))


def test_order_measurement_detects_a_wrong_energy(monkeypatch):
    """A system with another M than that of the reference has no order."""
    right = cases()["e(3), full, axes permuted"]
    other = co.LiePoissonSystem(right.system.algebra, co.Quadratic(full_matrix(5, 6) * 1.01))
    everything = all_cases() | {"planted": Case(other, right.x0)}
    monkeypatch.setattr(
        measures, "reference_states", lambda name: measures.final_states(co.GaussLegendre(8), right, 48)
    )
    monkeypatch.setattr(measures, "all_cases", lambda: everything)
    with pytest.raises(AssertionError):
        assert measured_order(co.GaussLegendre(2), "planted").agrees_with(4)
