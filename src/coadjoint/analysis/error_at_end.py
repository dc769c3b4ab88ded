"""How far from the motion did a run end? Told by runs that are more accurate than it was."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.solution import Solution
from coadjoint.runs.times import Times

# A run is compared with runs of so many times its steps, one after the other until its error is told. None is a power
# of two, so that the rounding of their steps differs from that of the run.
FINER = (1.5, 1.75, 2.5, 3.5)
# What is expected of rounding, so many times, is told from truncation.
CLEARLY = 16.0
# A second run looks at its size at so many points, and at no more numbers at once.
POINTS = 256
EVEN = 2.0**-40  # so near to a whole number of steps a time is one
NUMBERS = 2**22


def error_at_end(solution: Solution) -> NDArray[np.float64]:
    """Return an estimate of the error of each member at the end of a run whose accuracy was asked for.

    The run is compared with one of half as many steps more, whose error is known in proportion by the order. Where that
    leaves no more than rounding, a third run, with other steps again, is compared as well. A finer run that fails gives
    way to the next one, four at most.

    Parameters
    ----------
    solution : Solution
        From ``integrate(..., accuracy=)``.

    Returns
    -------
    ndarray, shape (members,)
        Relative to the largest momentum of each member on the way; infinite where every finer run fails.

    Raises
    ------
    TypeError
        No accuracy was asked for.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
    >>> sol = co.integrate(body, x0, (0, 100), accuracy=1e-6)
    >>> error = max(abs(sol.x[-1] - body.exact(x0, 100.0)))
    >>> bool(error / 10 < error_at_end(sol)[0] < 10 * error)
    True
    """
    choice = solution.choice
    if choice is None:
        raise TypeError(
            "error_estimate is known for runs with accuracy= only; give integrate accuracy= in place of step=, or "
            "compare this run with one of half the step"
        )
    ends, starts = solution.x[-1:] if solution.x.ndim == 2 else solution.x[-1], solution._began
    assert starts is not None
    time = float(solution.t[-1]) - solution.t_span[0]
    steps = math.ceil(abs(time) / solution.step * (1.0 - EVEN))
    if steps == 0:
        return np.zeros(len(starts))
    squares, seen, untold = np.zeros(len(starts)), np.zeros(len(starts), dtype=int), np.arange(len(starts))
    for times in FINER:
        if not len(untold):
            break
        apart = _apart(solution, starts[untold], ends[untold], time, steps, times)
        sound = np.isfinite(apart)
        squares[untold[sound]] += apart[sound] ** 2
        seen[untold[sound]] += 1
        # One difference that rounding explains may be small by chance.
        told = sound & ((apart > CLEARLY * choice.roundoff) | (seen[untold] == 2))
        untold = untold[~told]
    squares[seen == 0] = np.inf
    return np.maximum(np.sqrt(squares / np.maximum(seen, 1)), UNIT_ROUNDOFF)


def _apart(
    solution: Solution,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    time: float,
    steps: int,
    times: float,
) -> NDArray[np.float64]:
    """Return how far ends are from those of a finer run, and from where that run strives to, in parts of the size."""
    finer = solution.method.finer(steps, times)
    points = max(2, min(POINTS, NUMBERS // starts.shape[1]))
    every = -(-finer.steps // points)
    plan = Times(solution.t_span[0], time / finer.steps, finer.steps, every)
    ready = PreparedRun(solution.system, finer.method, abs(plan.h), watch=False)
    at_once = max(1, NUMBERS // (points * starts.shape[1]))
    parts = [slice(first, first + at_once) for first in range(0, len(starts), at_once)]
    found = [_of_members(ready, plan, starts[part], ends[part]) for part in parts]
    return np.concatenate(found) / (1.0 - finer.left)


def _of_members(
    ready: PreparedRun, plan: Times, starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> NDArray[np.float64]:
    run = ready.begun(plan, ready.start(starts))
    run.advance()
    x: Any = run.saved["x"][..., : starts.shape[1]]
    failed = run.state["status"] != 0
    size = np.max(np.linalg.norm(x, axis=2), axis=0)
    apart = np.linalg.norm(ends - x[-1], axis=1)
    # At rest everything is zero, so that any size will do.
    return np.where(failed, np.inf, apart / np.where(size > 0.0, size, 1.0))
