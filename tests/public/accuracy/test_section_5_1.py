"""Section 5.1: A3,7 with a = 2, H = x1^2/2 + x2^2 + x3^2/200, h = 0.01, from (1, 1, 1) over [0, 20]."""

import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U

A, MASSES = 2.0, (1.0, 2.0, 0.01)
X0, SPAN, STEP = np.array([1.0, 1.0, 1.0]), (0.0, 20.0), 0.01
SYSTEM = co.systems.paper_a37(A, MASSES)


def printed_flow(i, t, x):
    x1, x2, x3 = x
    m11, m22, m33 = MASSES
    if i == 0:
        return np.array([x1, x2, x3 + t * m11 * x1 * (-A * x1 + x2)])
    if i == 1:
        return np.array([x1, x2, x3 - t * m22 * x2 * (x1 + A * x2)])
    growth, angle = np.exp(A * m33 * x3 * t), m33 * x3 * t
    c, s = np.cos(angle), np.sin(angle)
    return np.array([growth * (c * x1 - s * x2), growth * (s * x1 + c * x2), x3])


@pytest.mark.thinned(1)
@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize("t", [0.01, 1.0, -3.0])
def test_printed_flows(i, t):
    masses = np.where(np.arange(3) == i, MASSES, 0.0)
    alone = co.LiePoissonSystem(co.algebras.A3_7(A), co.Quadratic(masses))
    x = np.array([0.6, -0.8, 2.5])
    printed = printed_flow(i, t, x)
    flow = co.stepper(alone, co.Splitting(order=1), t)(x)
    assert np.max(np.abs(flow - printed)) <= 32 * U * np.max(np.abs(printed))


def test_step_is_the_printed_composition_of_the_printed_flows():
    x = X0
    for i in (0, 1, 2, 2, 1, 0):
        x = printed_flow(i, STEP / 2, x)
    step = co.stepper(SYSTEM, co.Splitting(order=2, parts="coordinates"), STEP)
    assert np.max(np.abs(step(X0) - x)) <= 64 * U


@pytest.mark.parametrize("parts", ["auto", "coordinates"])
def test_splitting_preserves_the_casimir(parts):
    run = co.integrate(SYSTEM, X0, SPAN, STEP, co.Splitting(order=2, parts=parts))
    assert run.energy[0] == pytest.approx(1.505, abs=1e-15)
    # 3.7e-6 was measured to two digits: 5 per cent.
    assert run.drift(relative=False)["energy"] == pytest.approx(3.7e-6, rel=0.05)
    # "About 1e-14": 2000 steps of 5 flows, 10^4 roundings that go both ways, sqrt(10^4) u = 1.1e-14.
    assert run.drift(relative=False)["log C"] < 5e-14


def test_modified_midpoint_preserves_the_energy():
    run = co.integrate(SYSTEM, X0, SPAN, STEP, co.ModifiedGaussLegendre(1))
    assert run.drift(relative=False)["energy"] < 5e-14
    assert run.drift(relative=False)["log C"] == pytest.approx(5.5e-5, rel=0.05)
    # C itself, the angle unwrapped: exp(log C), 4.8e-6.
    values = np.exp(run.casimirs["log C"])
    assert np.max(np.abs(values - values[0])) == pytest.approx(4.8e-6, rel=0.05)


def test_orbits_are_heteroclinic():
    """x3 falls from +X to -X with X = sqrt(2 H / m33), and (x1, x2) -> 0."""
    run = co.integrate(SYSTEM, X0, (0.0, 60.0), STEP, co.Splitting(order=4))
    assert np.all(np.diff(run.x[:, 2]) <= 1e-12)
    assert run.x[-1, 2] == pytest.approx(-np.sqrt(2 * 1.505 / 0.01), rel=1e-6)
    assert np.max(np.abs(run.x[-1, :2])) < 1e-6
