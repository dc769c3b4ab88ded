"""Radau methods on the energy surface: failures, and what is told where the multiplier is not defined."""

from __future__ import annotations

import numpy as np
import pytest
from stage_systems import systems

import coadjoint as co
from refusals import refused


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
