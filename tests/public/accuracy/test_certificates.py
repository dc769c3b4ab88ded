"""Certificates of correct functions pass; those of defective steps and false declarations fail in their row."""

from functools import cache

import numpy as np
import pytest

import coadjoint as co
from digests.systems_under_test import cases
from long import long_where

pytestmark = pytest.mark.thinned(6)

STEP = 0.05
NOTHING = co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
SPLIT = co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="none")
EVERYTHING = co.methods.Properties(poisson=True, energy=True, casimirs="all", attitude="none")
GAUSS = co.methods.Properties(poisson=False, energy=True, casimirs="quadratic", attitude="none")


def strang(system):
    stepper = cache(lambda h: co.stepper(system, co.Splitting(order=2), h))
    return lambda x, h: stepper(h)(x)


def midpoint(system, tolerance=0.0):
    def step(x, h):
        y = x
        for _ in range(60):
            before, y = y, x + h * system.vector_field((x + y) / 2)
            if np.max(np.abs(y - before)) <= tolerance:
                break
        return y

    return step


def runge_kutta(system, weights=(1.0, 2.0, 2.0, 1.0)):
    def step(x, h):
        f = system.vector_field
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        return x + h / 6 * (weights[0] * k1 + weights[1] * k2 + weights[2] * k3 + weights[3] * k4)

    return step


BROKEN = {
    "time four times too slow": (lambda s: lambda x, h: strang(s)(x, h / 4), 2, True, SPLIT, "reference"),
    "backward": (lambda s: lambda x, h: strang(s)(x, -h), 2, True, SPLIT, "reference"),
    "a clock off by a thousandth": (lambda s: lambda x, h: strang(s)(x, 1.001 * h), 2, True, SPLIT, "reference"),
    "a wrong coefficient": (lambda s: runge_kutta(s, (1.0, 2.001, 2.0, 0.999)), 4, None, None, "order"),
    "coefficients that do not add up": (lambda s: runge_kutta(s, (1.0, 2.01, 2.0, 1.0)), 4, None, None, "reference"),
    "an order too many": (lambda s: runge_kutta(s), 5, None, None, "order"),
    "not symmetric": (lambda s: runge_kutta(s), 4, True, None, "symmetry"),
    "not Poisson": (lambda s: midpoint(s), 2, True, EVERYTHING, "poisson"),
    "loses the energy": (lambda s: strang(s), 2, True, EVERYTHING, "energy"),
    "an iteration that stops early": (lambda s: midpoint(s, 1e-9), 2, True, GAUSS, "energy"),
}


@pytest.mark.thinned(18)
@pytest.mark.parametrize("what", long_where(["backward", "time four times too slow"], BROKEN))
def test_defects_fail_in_their_row(what):
    make, order, symmetric, properties, row = BROKEN[what]
    system, x0, _ = cases()["so(4), diagonal" if row in ("poisson", "energy", "order") else "so(3), diagonal"]
    found = co.certify(
        system, make(system), x0, STEP, steps=40, order=order, symmetric=symmetric, properties=properties
    )
    assert not found.passed
    assert found[row].verdict == "fails", str(found)


@pytest.mark.parametrize("case", ["so(3), diagonal", "so(4), diagonal"])
def test_correct_functions_pass(case):
    system, x0, _ = cases()[case]
    for step, order, symmetric, properties in (
        (strang(system), 2, True, SPLIT),
        (runge_kutta(system), 4, False, NOTHING),
        (midpoint(system), 2, True, GAUSS),
    ):
        found = co.certify(system, step, x0, STEP, steps=40, order=order, symmetric=symmetric, properties=properties)
        assert found.passed, str(found)


class FalseTaylor(co.Taylor):
    """Declares everything; its order hides the defects at small steps, but not at large ones."""

    def properties(self, system):
        return EVERYTHING


class Slow(co.GaussLegendre):
    """Runs the motion and the group element at a quarter of the speed."""

    def coefficients(self, number=float):
        node, scale, mix, out = super().coefficients(number)
        return co.methods.Coefficients(node, scale / 4, mix, out)


class DeclaredSymmetric(co.ModifiedGaussLegendre):
    symmetric = True


@pytest.mark.parametrize("case", ["so(3), full, axes turned", "e(3), heavy top"])
@pytest.mark.parametrize(
    ("method", "failing"),
    [
        (FalseTaylor(12, projected=False), {"poisson", "energy"}),
        (Slow(2), {"order", "reference", "attitude"}),
        (DeclaredSymmetric(2, freeze="gradient"), {"symmetry"}),
    ],
    ids=["false Taylor", "slow Gauss", "declared symmetric"],
)
def test_false_declarations_fail(method, failing, case):
    system, x0, _ = cases()[case]
    for step in (0.01, -0.05):
        found = co.certify(system, method, x0, step, steps=40)
        assert failing <= {row.key for row in found.failures}, str(found)
        assert all(row.verdict == "fails" for row in found.failures), str(found)
