"""A model of the round-off of a run, with what a pilot measured."""

from __future__ import annotations

import math

from coadjoint.choosing.pilot import Pilot
from coadjoint.rounding import UNIT_ROUNDOFF

# In units of u. Each flow rounds the momentum without bias by so much, as Casimirs of so(3) and e(3) show after 10^7
# steps; Gauss methods, which keep quadratic invariants and round their slopes alone, by less.
FLOW_WALK = 0.5
GAUSS_WALK = 0.1
# The largest bias that flows were seen to have: Casimirs of so(3) with a full M.
FLOW_BIAS = 7e-4
# Runs of the reference that differ by rounding alone are samples of what rounding does to any scheme. Along the
# direction that grows fastest they are normal variables of one width: another one exceeds 4 / 3 times this, times the
# largest of three differences from a fourth, with a probability of 0.003. Truncation takes less than the rest.
MARGIN = 4.0
# Each coefficient of a composition is rounded on its own, so that its time is wrong by the root of their number.
COEFFICIENTS = 3.0
# Of a compensated sum only the increments are rounded. A flow moves further than the motion does in the same time,
# since what other parts undo is moved too.
DETOUR = 4.0


def least_roundoff(pilot: Pilot) -> float:
    """Return the rounding error at the end of the span that every scheme is expected to have."""
    return MARGIN * pilot.noise * pilot.sensitivity.factor(pilot.windows)


def roundoff(pilot: Pilot, steps: int, flows: int, compensated: bool, windows: float, margin: float = 1.0) -> float:
    """Return the error at the end that rounding is expected to leave, relative to the largest momentum.

    Every update of the momentum is rounded, and what that leaves grows as a change of the start grows, so that an
    unbiased error of N updates is sqrt(N) times one of them (Brouwer's law: a phase error like t^1.5). Besides, rounded
    coefficients and a rounded step are another unit of time: an error of u times the length of the path. At the least
    there is what the reference was seen to have.

    Parameters
    ----------
    pilot : Pilot
        The window, with its sensitivity and speed.
    steps : int
        Steps of the run.
    flows : int
        Those of a step, each of which rounds the momentum; 0 for schemes that are not made of flows.
    compensated : bool
        Whether the momentum is summed with compensation.
    windows : float
        Length of the run in windows of the pilot.
    margin : float
        Factor of the rounding that the reference was seen to have: `MARGIN` for what the error hardly ever exceeds.

    Returns
    -------
    float
        Infinite where changes of the start grow beyond all numbers.
    """
    number = max(1.0, steps * max(1, flows))
    path = pilot.speed * pilot.window * windows
    growing = pilot.sensitivity.factor(windows)
    growth = max(1.0, pilot.sensitivity.whole * growing)
    if flows == 0:
        model = 1.0 + path + growth * GAUSS_WALK * math.sqrt(number)
        return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
    rounding, bias = (min(1.0, DETOUR * path / number), 0.0) if compensated else (1.0, FLOW_BIAS * number)
    model = 1.0 + COEFFICIENTS * path * math.sqrt(flows) + growth * (FLOW_WALK * rounding * math.sqrt(number) + bias)
    return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
