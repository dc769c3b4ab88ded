"""Radau methods on the energy surface: the loops and `Method.step`, energy, compositions, failures."""

from __future__ import annotations

import math

import numpy as np
import pytest
import stage_systems as stages

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U


def allocating(x):
    """cosh-like, and a burden for whoever does not own his memory: it allocates and frees arrays of all small sizes."""
    total = 0.0
    for size in range(1, 80):
        total += np.full(size, 1e3)[size - 1] - 1e3
    return 0.5 * x[0] * x[0] + x[1] * x[1] + 1.5 * x[2] * x[2] + 0.25 * x[0] ** 4 + total


def allocating_gradient(x):
    total = 0.0
    for size in range(1, 80):
        total += np.full(size, 1e3)[size - 1] - 1e3
    return np.array([x[0] + x[0] ** 3 + total, 2.0 * x[1], 3.0 * x[2]])


def systems():
    # x . grad H > 0 everywhere but at zero: the multiplier is always defined
    squares = {tuple(2 * (k == i) for k in range(6)): m / 2 for i, m in enumerate((1.0, 0.5, 0.25, 0.75, 1.5, 1.0))}
    quartic = co.Polynomial(squares | {(0, 0, 4, 0, 0, 0): 0.5, (0, 0, 0, 2, 2, 0): 0.25})
    own = co.Hamiltonian(allocating, allocating_gradient)
    return {name: stages.systems()[name] for name in ("top", "so(4)", "nonlinear J")} | {
        "quartic": (co.LiePoissonSystem(co.algebras.e(3), quartic, sign=-1), stages.systems()["quartic"][1]),
        "functions": (co.LiePoissonSystem(co.algebras.sl(2), own), np.array([1.0, 0.5, -0.25])),
    }


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", list(systems()))
def test_energy_is_kept_and_casimirs_are_not(name):
    """A random walk of 500 steps, each of some 4 n roundings of products of the size of H; six times its width."""
    system, x0 = systems()[name]
    run = co.integrate(system, x0, (0.0, 25.0), 0.05, co.RadauEnergy(2), save_every=500)
    drift = run.drift(relative=False)
    assert drift.pop("energy") < 6 * U * 4 * len(x0) * 5.0 * math.sqrt(500)
    assert all(lost > 1e-8 for lost in drift.values())


def test_compositions_of_steps():
    system, x = systems()["so(4)"]
    method, fractions = co.Kahan(), (0.5, -0.25, 0.5, -0.25, 0.5)
    found = co.stepper(system, co.Composition(method, fractions), 0.125)(x)
    for fraction in fractions:
        x = method.step(system, x, 0.0, 0.125 * fraction)
    assert np.max(np.abs(found - x)) < len(fractions) * 64 * len(x) * U * 2.0


def test_a_change_of_sign_of_x_grad_h_is_told_and_not_stepped_over():
    """Beyond it the scheme follows another solution: left to itself its error stays at 4e-3 whatever the step."""
    quartic = {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    system = co.LiePoissonSystem(co.algebras.e(3), co.Polynomial(quartic), sign=-1)
    x0 = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    truth = co.integrate(system, x0, (0.0, 1.0), 1 / 128, co.GaussLegendre(4))
    signs = [np.sign(x @ system.hamiltonian.gradient(x)) for x in truth.x]
    crossing = next(k for k in range(128) if signs[k + 1] != signs[0])
    told = []
    for steps in (16, 32, 64, 128, 256):
        with pytest.raises(co.IntegrationError) as failure:
            co.integrate(system, x0, (0.0, 1.0), 1 / steps, co.RadauEnergy(2))
        assert abs(failure.value.step / steps - (crossing + 1) / 128) <= 0.1
        told.append(str(failure.value))
    # Near the crossing the multiplier grows without bound: it may also be that the iteration does not get there.
    assert all("vanishes" in one or "converge" in one for one in told) and any("vanishes" in one for one in told)


def test_failures():
    """No convergence, and no multiplier where x . grad H = 0; other members go on."""
    system, x0 = systems()["so(4)"]
    with refused(co.IntegrationError, "converge") as failure:
        co.integrate(system, x0, (0.0, 60.0), 20.0, co.RadauEnergy(2))
    assert failure.value.step == 1
    saddle = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, -1.0, 2.0]))
    with refused(co.IntegrationError, "x . grad H(x) vanishes", "member 0") as failure:
        co.integrate(saddle, [[1.0, 1.0, 0.0], [1.0, 0.5, 0.25]], (0.0, 0.05), 0.01, co.RadauEnergy(2))
    partial = failure.value.partial
    assert partial.failed.tolist() == [True, False] and np.abs(partial.x[-1, 1] - [1.0, 0.5, 0.25]).max() > 1e-3
    with refused(co.IntegrationError, "vanishes"):
        co.RadauEnergy(2).step(saddle, [1.0, 1.0, 0.0], 0.0, 0.01)
