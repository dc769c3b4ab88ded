"""Step size for a bound on the energy error, from short runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.methods.numerics.short_orbit import rate_at
from coadjoint.methods.protocol.method import Method, declared_properties
from coadjoint.methods.registry import read_method
from coadjoint.runs.preparation import Preparation, trial_run
from coadjoint.runs.start import momenta_of
from coadjoint.runs.times import Times
from coadjoint.short_repr import short
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_positive

# Radians of a trial run, and its least number of steps: those of whole radians are too few to find the largest change.
RADIANS, STEPS = 128.0, 512
# Steps of the run that comes first, in which a step that is much too large is recognized.
FIRST_STEPS = 8
# Smallest trial step, in units of the time of one radian; changes of smaller steps follow from the order.
SHORTEST = 2.0**-7
# Most trial runs until the bound is met, and between two steps; the change that suffices, relative to the bound.
MAX_REDUCTIONS, TRIALS, SUFFICIENT = 16, 12, 0.99
# Largest difference of the observed order from that of the scheme at which changes of smaller steps follow from it.
ORDER_TOLERANCE = 0.1


@suggest_keywords
@long_operation("suggest_step")
def suggest_step(
    system: LiePoissonSystem, method: Method | str | Mapping[str, Any], x0: npt.ArrayLike, energy: float
) -> float:
    """Return the largest step at which the energy stays within a bound, from short runs.

    A run by a Poisson map preserves H + h^p H_p + ..., so its energy varies as h^p H_p does along the motion, for any
    length of the run. Choose it to control the energy error. `choose` selects scheme and step for an error of the
    momentum over a span.

    Parameters
    ----------
    system : LiePoissonSystem
        With a Hamiltonian that does not depend on time and has second derivatives.
    method : Method, str or mapping
        A scheme that preserves the bracket or the energy, or its name as in `integrate`.
    x0 : array_like, shape (n,) or (k, n)
        The initial state, or a sample of states, for which the smallest step is returned.
    energy : float
        The largest accepted change of the energy, in units of H.

    Returns
    -------
    float
        A positive step, from runs over 128 radians of the motion or 512 steps. It is at most the time in which the
        motion turns by one radian; if it is smaller, the energy usually changes by 99 to 100 per cent of the bound.
        Steps below 1/128 of that time follow from the order of the scheme.

    Raises
    ------
    TypeError, ValueError
        The scheme preserves neither bracket nor energy on this system, or the energy depends on time.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
    >>> h = suggest_step(body, co.Splitting(), x0, energy=1e-5)
    >>> run = co.integrate(body, x0, (0, 1000 * h), h, co.Splitting())
    >>> 0.9e-5 < run.drift()["energy"].absolute < 1.1e-5
    True
    """
    scheme = read_method(method)
    if not isinstance(system, LiePoissonSystem):
        raise TypeError(f"the system is {short(system)}; suggest_step takes one LiePoissonSystem")
    check_one_system(system)
    if system.hamiltonian.timed:
        raise ValueError(f"the energy of {system.name} depends on time; `choose` selects a step by the error of x")
    declared = declared_properties(scheme, system)
    if not (declared.poisson or declared.energy):
        raise ValueError(
            f"{scheme} preserves neither the bracket nor the energy of {system.name}, so that the energy error grows "
            "with the length of the run; take Splitting, or select a step by `choose`"
        )
    bound = read_positive(energy, "energy")
    points, _ = momenta_of(system, x0)
    return min(_largest_step(system, scheme, start, bound) for start in points)


def _largest_step(system: LiePoissonSystem, method: Method, start: npt.NDArray[np.float64], bound: float) -> float:
    rate, order = rate_at(system, start), method.order
    target, shortest = 0.5 * (1.0 + SUFFICIENT) * bound, SHORTEST / rate
    prepared = Preparation(system, method, 1.0 / rate, threads=1)

    def change_in(h: float, count: int) -> float:
        run = trial_run(prepared, Times(0.0, h, count, count), start[None])
        largest = float(np.max(run.state["worst"][:, :, 0]))
        return largest if math.isfinite(largest) and not run.state["status"].any() else math.inf

    def change(h: float) -> float:
        """Return the largest change of the energy; infinite if a step fails, or half of it would be too large."""
        note_progress(f"the change of the energy at the step {h:.3g}")
        # Steps near the smallest one are tried in full, since those below are extrapolated from them.
        if h > 2.0 * shortest and change_in(h, FIRST_STEPS) > 2.0**order * bound:
            return math.inf
        return change_in(h, max(STEPS, math.ceil(RADIANS / (h * rate))))

    steps, changes = [1.0 / rate], [change(1.0 / rate)]
    while changes[-1] > bound:
        if steps[-1] <= shortest or len(steps) == MAX_REDUCTIONS:
            return _extrapolated(steps, changes, bound, order)
        steps.append(max(shortest, _smaller_step(steps, changes, target, order)))
        changes.append(change(steps[-1]))
    if len(changes) == 1:
        return steps[0]
    (high, low), (above, below) = steps[-2:], changes[-2:]
    for _ in range(TRIALS):
        if below >= SUFFICIENT * bound or low >= SUFFICIENT * high or not 0.0 < below < above:
            break
        # Between a step and one at which the change is unknown, it follows from the order.
        power = math.log(high / low) / math.log(above / below) if above < math.inf else 1.0 / order
        h = min(low * (target / below) ** power, math.sqrt(low * high) if above == math.inf else high)
        found = change(h)
        if found <= bound:
            low, below = h, found
        else:
            high, above = h, found
    return low


def _smaller_step(steps: list[float], changes: list[float], target: float, order: int) -> float:
    """Return the next trial step: that of the order, or half of the last unless its change follows the order."""
    by_order = steps[-1] * (target / changes[-1]) ** (1.0 / order)
    if len(steps) > 1 and abs(_observed_order(steps, changes, len(steps) - 1) - order) <= ORDER_TOLERANCE:
        return by_order
    return max(by_order, 0.5 * steps[-1])


def _observed_order(steps: list[float], changes: list[float], k: int) -> float:
    """Return the power of the step by which the change of a trial run differs from the previous one."""
    if not 0.0 < changes[k] < math.inf or not 0.0 < changes[k - 1] < math.inf:
        return math.inf
    return math.log(changes[k - 1] / changes[k]) / math.log(steps[k - 1] / steps[k])


def _extrapolated(steps: list[float], changes: list[float], bound: float, order: int) -> float:
    """Return the step for a bound below all changes, from the one near which they follow the order best."""
    # A correction that is linear in h changes from h' to h by h' / h - 1 times its value at h.
    deviations = [math.inf] + [
        abs(_observed_order(steps, changes, k) - order) * math.log(ratio) / (ratio - 1.0)
        for k, ratio in enumerate((a / b for a, b in pairwise(steps)), 1)
    ]
    k = int(np.argmin(deviations))
    if not math.isfinite(deviations[k]):
        raise ValueError("the motion from x0 cannot be followed at any step; take another state")
    return steps[k] * (bound / changes[k]) ** (1.0 / order)
