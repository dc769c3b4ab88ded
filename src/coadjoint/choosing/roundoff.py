"""Model of the round-off of a run, from the measurements of a pilot."""

from __future__ import annotations

import math

from coadjoint.choosing.pilot import Pilot
from coadjoint.rounding import UNIT_ROUNDOFF

# Unbiased rounding of the momentum per flow, in units of u, measured by Casimirs of so(3) and e(3) after 10^7 steps.
# Smaller for Gauss methods, which preserve quadratic invariants and round only their slopes.
FLOW_WALK = 0.5
GAUSS_WALK = 0.1
# Largest bias per flow that was measured: Casimirs of so(3) with a full M.
FLOW_BIAS = 7e-4
# Runs of the reference with different rounding are samples of the rounding of any scheme: normal variables of one
# width along the direction of fastest growth. Another sample exceeds 4 / 3 ROUNDING_MARGIN times the largest of three
# differences from a fourth with probability 0.003.
ROUNDING_MARGIN = 4.0
# Largest part of the accuracy that rounding alone may take.
ROUNDING_SHARE = 0.5
# Coefficients of a composition are rounded independently, so its time error grows as the root of their number.
COEFFICIENT_ERROR = 3.0
# A compensated sum rounds only the increments. Flows move the state further than the motion does, since other parts
# partly undo their increments.
FLOW_PATH_RATIO = 4.0


def least_roundoff(pilot: Pilot) -> float:
    """Return the rounding error at the end of the span expected for every scheme."""
    return ROUNDING_MARGIN * pilot.noise * pilot.sensitivity.factor(pilot.windows)


def roundoff(pilot: Pilot, steps: int, flows: int, compensated: bool, windows: float, margin: float = 1.0) -> float:
    """Return the rounding error expected at the end, relative to the largest momentum; inf if it overflows.

    Each update of the momentum is rounded, and its error grows like a change of the initial state, so unbiased errors
    of N updates add up to sqrt(N) times one (Brouwer's law: phase errors like t^1.5). Rounded coefficients and steps
    change the unit of time: an error of u times the length of the path. The result is at least `margin` times the
    rounding seen in the reference. `flows` per step is 0 for schemes not composed of flows; `windows` is the length of
    the run in windows.
    """
    number = max(1.0, steps * max(1, flows))
    path = pilot.speed * pilot.window * windows
    growing = pilot.sensitivity.factor(windows)
    growth = max(1.0, pilot.sensitivity.whole * growing)
    if flows == 0:
        model = 1.0 + path + growth * GAUSS_WALK * math.sqrt(number)
        return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
    rounding, bias = (min(1.0, FLOW_PATH_RATIO * path / number), 0.0) if compensated else (1.0, FLOW_BIAS * number)
    model = (
        1.0 + COEFFICIENT_ERROR * path * math.sqrt(flows) + growth * (FLOW_WALK * rounding * math.sqrt(number) + bias)
    )
    return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
