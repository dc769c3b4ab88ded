"""Negative controls: wrong systems, schemes and steps fail the measures that correct ones pass."""

import pytest

import coadjoint as co
from digests.measures import order_of, poisson_defect
from digests.systems_under_test import cases


class DefectiveStep:
    """A stepper with one defect in its tangent or its state."""

    def __init__(self, step, state=lambda x: x, tangent=lambda P: P):
        self.right, self.wrong_state, self.wrong_tangent = step, state, tangent
        self.system, self.method, self.h = step.system, step.method, step.h

    def __call__(self, x):
        return self.wrong_state(self.right(x))

    def tangent(self, x):
        return self.wrong_tangent(self.right.tangent(x))


@pytest.mark.parametrize("name", ["A3,7, full", "so(4), full, another basis", "e(3), heavy top"])
def test_poisson_defect_detects_small_errors(name):
    system, x0, _ = cases()[name]
    step = co.stepper(system, co.Splitting(order=2), 0.1)
    right = poisson_defect(step, x0)
    assert right.value <= right.bound
    for wrong in (
        DefectiveStep(step, tangent=lambda P: P.T),
        DefectiveStep(step, tangent=lambda P: P * (1 + 1e-9)),
        DefectiveStep(step, state=lambda x: x + 1e-9),
    ):
        found = poisson_defect(wrong, x0)
        assert found.value > found.bound


def test_slope_fit_separates_neighbouring_orders():
    h = [0.2 / 2 ** (k / 2) for k in range(5)]
    for p in (1, 2, 4, 8):
        found = order_of(h, [3 * x**p * (1 + 0.8 * x) for x in h], 1)
        assert found.agrees_with(p)
        assert not found.agrees_with(p + 1) and not found.agrees_with(p - 1)
    # A plateau agrees with no order.
    assert not any(order_of(h, [1e-12 * (1 + 0.3 * (-1) ** k) for k in range(5)], 1).agrees_with(p) for p in (1, 2, 4))
