"""Step size for a bound on the energy error, from short runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.long_operations import long_operation
from coadjoint.methods.numerics.short_orbit import rate_at
from coadjoint.methods.protocol.method import Method, declared_properties
from coadjoint.methods.registry import read_method
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.times import Times
from coadjoint.short_repr import short
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_finite, read_positive

# Radians of a trial run, and its least number of steps: those of whole radians are too few to find the largest change.
RADIANS, STEPS = 128.0, 512
# Trial steps are halved up to so many times; changes of much smaller steps follow from the order.
HALVINGS = 8
# Trial runs between two steps, and the change that suffices, relative to the bound.
TRIALS, SUFFICIENT = 12, 0.999


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
        motion turns by one radian. Steps below 1/256 of that time follow from the order of the scheme.

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
    if system.hamiltonian.timed:
        raise ValueError(f"the energy of {system.name} depends on time; `choose` selects a step by the error of x")
    declared = declared_properties(scheme, system)
    if not (declared.poisson or declared.energy):
        raise ValueError(
            f"{scheme} preserves neither the bracket nor the energy of {system.name}, so that the energy error grows "
            "with the length of the run; take Splitting, or select a step by `choose`"
        )
    bound = read_positive(energy, "energy")
    points = np.atleast_2d(read_finite(x0, "x0"))
    if points.ndim != 2 or points.shape[1] != system.dim:
        raise ValueError(f"x0 has the shape {points.shape}; it must be ({system.dim},) or (k, {system.dim})")
    return min(_largest_step(system, scheme, start, bound) for start in points)


def _largest_step(system: LiePoissonSystem, method: Method, start: npt.NDArray[np.float64], bound: float) -> float:
    rate = rate_at(system, start)
    steps, changes = [1.0 / rate], []
    ready = PreparedRun(system, method, steps[0], threads=1)

    def change(h: float) -> float:
        count = max(STEPS, math.ceil(RADIANS / (h * rate)))
        run = ready.begun(Times(0.0, h, count, count), ready.start(start))
        run.advance(False)
        largest = float(np.max(run.state["worst"][:, :, 0]))
        return largest if math.isfinite(largest) and not run.state["status"].any() else math.inf

    for _ in range(HALVINGS):
        changes.append(change(steps[-1]))
        if changes[-1] <= bound:
            break
        steps.append(0.5 * steps[-1])
    else:
        return _extrapolated(steps[:-1], changes, bound, method.order)
    if len(changes) == 1:
        return steps[0]
    (high, low), (above, below) = steps[-2:], changes[-2:]
    for _ in range(TRIALS):
        if below >= SUFFICIENT * bound or not 0.0 < below < above < math.inf:
            break
        h = low * (high / low) ** (math.log(bound / below) / math.log(above / below))
        found = change(h)
        if found <= bound:
            low, below = h, found
        else:
            high, above = h, found
    return low


def _extrapolated(steps: list[float], changes: list[float], bound: float, order: int) -> float:
    """Return the step for a bound below all changes, from the one near which they follow the order best."""
    finite = [k for k in range(1, len(steps)) if 0.0 < changes[k] and changes[k - 1] < math.inf]
    if not finite:
        raise ValueError("the motion from x0 cannot be followed at any step; take another state")
    k = min(finite, key=lambda k: abs(math.log2(changes[k - 1] / changes[k]) - order))
    return steps[k] * (bound / changes[k]) ** (1.0 / order)
