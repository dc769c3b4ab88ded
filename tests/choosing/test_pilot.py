"""The window of a pilot: in the direction and at the time of the run, against a motion that is known."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing.pilot import Pilot
from coadjoint.choosing.sampling import sample_of
from coadjoint.methods.gauss_legendre import GaussLegendre

MASSES = np.array([1.0, 0.5, 0.4])
X0 = np.array([1.0, 1.5, -0.5])


def quickening(x, t):
    return 0.5 * math.exp(t) * (x[0] * x[0] + 0.5 * x[1] * x[1] + 0.4 * x[2] * x[2])


def quickening_gradient(x, t):
    return math.exp(t) * np.array([x[0], 0.5 * x[1], 0.4 * x[2]])


BODY = co.systems.rigid_body(1.0 / MASSES)
# A rigid body whose clock runs ever faster: x(t) is that of the body after the time e^t - e^t0.
SYSTEM = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(quickening, quickening_gradient), sign=-1)


def exact(t0, t, x0=X0):
    return BODY.exact(x0, np.exp(t) - math.exp(t0))


@pytest.mark.parametrize("t0", [0.0, 1.25, -0.75])
@pytest.mark.parametrize("span", [1.5, -1.5])
def test_the_reference_is_the_motion(t0, span):
    pilot = Pilot(SYSTEM, X0[None], t0, span)
    assert pilot.whole
    times = t0 + span * np.arange(pilot.points + 1) / pilot.points
    found = pilot.reference[:, 0]
    # Its rounding, over some hundred steps of a path of length some tens.
    assert np.max(np.abs(found - exact(t0, times))) < 1e-12
    steps = pilot.fitting(pilot.window / pilot.natural_step * 2)
    trial = pilot.trial(GaussLegendre(2), steps)
    run = co.integrate(SYSTEM, X0, (t0, t0 + span), abs(span) / steps, GaussLegendre(2))
    apart = np.linalg.norm(run.x - exact(t0, run.t), axis=1)[steps // 2 + 1 :] / np.linalg.norm(X0)
    # It looks at some points of the second half, among them the end.
    assert apart[-1] * 0.999 <= trial.error <= apart.max() * 1.001
    speeds = [np.linalg.norm(SYSTEM.vector_field(x, t)) for x, t in zip(found, times, strict=True)]
    assert pilot.speed == pytest.approx(max(speeds) / np.linalg.norm(X0), rel=0.1)


def test_the_natural_step_is_that_of_the_direction():
    """From t = 2 the clock is e^4 times as fast after four units of time as it was before them."""
    forward, backward = (Pilot(SYSTEM, X0[None], 2.0, span).natural_step for span in (2.0, -4.0))
    assert backward >= 2.0 * forward


@pytest.mark.parametrize("span", [3.0, -3.0])
def test_the_sample_has_the_members_that_are_hardest(span):
    """Momenta of any size in any order: the larger one is, the faster it turns."""
    rng = np.random.default_rng(4)
    sizes = rng.permutation(np.linspace(0.1, 3.0, 40))
    crowd = sizes[:, None] * X0
    hardest = set(np.argsort(-sizes)[:2].tolist())
    found = sample_of(BODY, crowd, 0.0, span)
    chosen = {int(np.flatnonzero(np.all(crowd == x, axis=1))[0]) for x in found}
    assert 0 in chosen and chosen >= hardest
