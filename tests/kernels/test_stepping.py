"""The loop for step methods and Radau on the energy surface: the plain reading, energy, substeps, failures."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.interface import codes
from coadjoint.kernels.loop import MemberBatch, StopFlag
from coadjoint.kernels.tables.invariants import watch_tables
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.kernels.tables.steps import STEP_LOOP, step_tables

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53


def run(system, method, x0, h, steps, *, t0=0.0, cuts=(), fractions=(1.0,)):
    """Return the final states, the largest deviations of energy and Casimirs, and the whole state, for all members."""
    momenta = np.atleast_2d(np.array(x0, dtype=float))
    members, n = momenta.shape
    prepared, watch = step_tables(system, method, None, fractions), watch_tables(system, system.casimirs)
    layout = Layout(Extent(members, 2, n, 0, 1 + len(system.casimirs), 0))
    saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
    state["momenta"][:] = momenta
    member_batch = MemberBatch(STEP_LOOP, prepared.tables, watch.tables, 0, members)
    for k0, k1 in pairwise([0, *cuts, steps]):
        member_batch.advance(layout, schedule_of(t0, h, steps, steps, True), saved, state, k0, k1, StopFlag())
    return state["momenta"], state["worst"].max(axis=1), state


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
    e3, so4 = co.algebras.e(3), co.algebras.so(4)
    top = co.Quadratic([1.0, 0.5, 0.25, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    # x . grad H > 0 everywhere but at zero: the multiplier is always defined
    squares = {tuple(2 * (k == i) for k in range(6)): m / 2 for i, m in enumerate((1.0, 0.5, 0.25, 0.75, 1.5, 1.0))}
    quartic = co.Polynomial(squares | {(0, 0, 4, 0, 0, 0): 0.5, (0, 0, 0, 2, 2, 0): 0.25})
    six = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    return {
        "top": (co.LiePoissonSystem(e3, top, sign=-1), np.array([1.0, -0.5, 1.5, 0.625, 0.25, 0.75])),
        "so(4)": (co.LiePoissonSystem(so4, co.Quadratic(np.linspace(0.5, 1.5, 6))), six),
        "quartic": (co.LiePoissonSystem(e3, quartic, sign=-1), six),
        "functions": (
            co.LiePoissonSystem(co.algebras.sl(2), co.Hamiltonian(allocating, allocating_gradient)),
            np.array([1.0, 0.5, -0.25]),
        ),
        "nonlinear J": (
            co.PoissonSystem(
                lambda x: np.array([[0.0, -x[2] * x[2], x[0]], [x[2] * x[2], 0.0, -x[1]], [-x[0], x[1], 0.0]]),
                co.Quadratic([1.0, 0.5, 0.25]),
            ),
            np.array([0.75, 0.5, -0.625]),
        ),
    }


@pytest.mark.thinned(8)
@pytest.mark.parametrize("stages", [1, 2, 3])
@pytest.mark.parametrize("name", list(systems()))
def test_compiled_step_is_the_plain_reading(name, stages):
    """The multipliers carry u T / (x . grad H): some ten times the round-off of a state."""
    system, x = systems()[name]
    method = co.RadauEnergy(stages)
    for h in (0.0625, -0.0625) if stages == 2 else (0.0625,):
        found, _, report = run(system, method, x, h, 1)
        assert report["status"][0] == 0
        assert np.max(np.abs(found[0] - method.step(system, x, 0.0, h))) < 64 * len(x) * U * np.max(np.abs(x))
        assert np.max(np.abs(found[0] - x)) > 1e-3


@pytest.mark.parametrize("name", ["top", "so(4)", "quartic", "functions", "nonlinear J"])
def test_energy_is_kept_and_casimirs_are_not(name):
    """A random walk of 500 steps, each of some 4 n roundings of products of the size of H; six times its width."""
    system, x0 = systems()[name]
    _, worst, report = run(system, co.RadauEnergy(2), x0, 0.05, 500)
    assert report["status"][0] == 0
    assert worst[0, 0] < 6 * U * 4 * len(x0) * 5.0 * math.sqrt(500)
    assert np.all(worst[0, 1:] > 1e-8)


def test_substeps():
    system, x0 = systems()["top"]
    method = co.RadauEnergy(2)
    found, _, _ = run(system, method, x0, 0.125, 1, fractions=(0.5, -0.25, 0.75))
    x = x0
    for fraction in (0.5, -0.25, 0.75):
        x = method.step(system, x, 0.0, 0.125 * fraction)
    assert np.max(np.abs(found[0] - x)) < 3 * 64 * len(x) * U * 2.0


def test_a_change_of_sign_of_x_grad_h_is_told_and_not_stepped_over():
    """Beyond it the scheme follows another solution: left to itself its error stays at 4e-3 whatever the step."""
    quartic = {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    system = co.LiePoissonSystem(co.algebras.e(3), co.Polynomial(quartic), sign=-1)
    x0 = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    truth = co.integrate(system, x0, (0.0, 1.0), 1 / 128, co.GaussLegendre(4))
    signs = [np.sign(x @ system.hamiltonian.gradient(x)) for x in truth.x]
    crossing = next(k for k in range(128) if signs[k + 1] != signs[0])
    found = set()
    for steps in (16, 32, 64, 128, 256):
        _, _, report = run(system, co.RadauEnergy(2), x0, 1 / steps, steps)
        assert abs(report["step"][0] / steps - (crossing + 1) / 128) <= 0.1
        found.add(int(report["status"][0]))
    # near the crossing the multiplier grows without bound: it may also be that the iteration does not get there
    status = codes("Status")
    assert found <= {status["NOT_CONVERGED"], status["UNDEFINED"]}
    assert status["UNDEFINED"] in found


def test_failures():
    """No convergence, and no multiplier where x . grad H = 0; other members go on."""
    system, x0 = systems()["so(4)"]
    _, _, report = run(system, co.RadauEnergy(2), x0, 20.0, 3)
    assert (report["status"][0], report["step"][0]) == (1, 1)
    saddle = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, -1.0, 2.0]))
    method = co.RadauEnergy(2)
    states, _, report = run(saddle, method, [[1.0, 1.0, 0.0], [1.0, 0.5, 0.25]], 0.01, 5)
    assert report["status"].tolist() == [codes("Status")["UNDEFINED"], 0]
    assert "x . grad H(x) vanishes" in method.failures["UNDEFINED"]
    with pytest.raises(co.IntegrationError, match="vanishes"):
        method.step(saddle, [1.0, 1.0, 0.0], 0.0, 0.01)
    assert np.max(np.abs(states[1] - [1.0, 0.5, 0.25])) > 1e-3
