"""Stretching of tangent vectors along a run, in compiled loops or step by step by `Method.tangent`."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.tables.tangents import Frame, stretch_logarithms
from coadjoint.long_operations import note_progress
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.loops import loops_of_members
from coadjoint.runs.plan import Plan
from coadjoint.runs.run import Run
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.protocol import is_batch, member_of, members_of
from coadjoint.systems.system_checks import System

NEARLY_DEPENDENT = 2.0**-26  # as in the compiled loop: half of the digits are lost
_warned_types: set[type] = set()


class Stretching(NamedTuple):
    """Result of `stretching`.

    `logarithms` (points, members, k) are those of the stretching factors of the vectors since the start; NaN after a
    failure. `by` is "compiled", or "formula", "complex step" or "differences" for tangents in Python. `run` has the
    failures.
    """

    logarithms: NDArray[np.float64]
    by: str
    run: Run


def stretching(
    system: System | Batch, method: Method, times: Times, start: Start, frame: Frame, workers: int
) -> Stretching:
    """Carry the orthonormal tangent vectors of `frame` along a run of every member.

    `times` has the saved steps as marks; `start` has no group element. ValueError or TypeError: the scheme cannot be
    used for the system, or a derivative is unknown.
    """
    systems = members_of(system)
    prepared = []
    for m, member in enumerate(systems):
        try:
            method.properties(member)
            prepared.append(method.tangent_loop(member, times.h, frame))
        except (TypeError, ValueError) as error:
            if not is_batch(system):
                raise
            raise type(error)(f"member {m} of the batch: {error}") from error
    compiled = [loop for loop in prepared if loop is not None]
    if len(compiled) < len(systems):
        return _step_by_step(system, systems, method, times, start, frame)
    loops = loops_of_members(systems, compiled)
    run = Run(Plan(system, method, loops, times, start.groups.shape, workers=workers), start)
    logarithms = np.full((times.points, len(start.momenta), len(frame.vectors)), np.nan)
    for point, number in enumerate(times.saved.tolist()):
        if number == 0:
            logarithms[point] = 0.0
            continue
        run.advance(until=number)
        note_progress(f"step {number} of {times.steps}", number / times.steps)
        running = run.state["status"] == 0
        logarithms[point, running] = stretch_logarithms(run.state["memory"][running], len(frame.vectors))
    return Stretching(logarithms, "compiled", run)


def _step_by_step(
    system: System | Batch, systems: Sequence[System], method: Method, times: Times, start: Start, frame: Frame
) -> Stretching:
    """Take the steps in the loop of the scheme, then evaluate their tangents in Python."""
    numbers = (times.steps + 1) * (systems[0].dim + 2) * len(start.momenta)
    check_available_memory(8 * numbers, f"the states of {short(times.steps)} steps, for tangents in Python,")
    _warn_once(type(method))
    every_step = times.with_saved_steps(np.arange(times.steps + 1))
    loops = loops_of_members(systems, [method.loop(member, times.h, None) for member in systems])
    run = Run(Plan(system, method, loops, every_step, start.groups.shape), start)
    run.advance()
    ends = np.where(run.state["status"] == 0, times.steps, run.state["step"] - 1)
    logarithms = np.full((times.points, len(start.momenta), len(frame.vectors)), np.nan)
    for m in range(len(start.momenta)):
        member = member_of(system, m)
        states = run.saved["x"][: int(ends[m]) + 1, m]
        failed = _follow(member, method, times, states, frame, logarithms[:, m])
        if failed:
            run.mark_failed(m, failed, "PARALLEL")
    by = method.tangent_by(systems[0], start.momenta[0], times.t0, times.h)
    return Stretching(logarithms, by, run)


def _follow(
    system: System, method: Method, times: Times, states: NDArray[Any], frame: Frame, logarithms: NDArray[np.float64]
) -> int:
    """Fill in the logarithms of one member; return the step after which vectors are dependent, or 0."""
    total, remainder = np.zeros(len(frame.vectors)), np.zeros(len(frame.vectors))
    vectors = frame.vectors.T.copy()
    saved = {number: point for point, number in enumerate(times.saved.tolist())}
    for k in range(len(states)):
        note_progress(f"step {k} of {len(states)}", k / len(states))
        if k:
            before = float(times.t0 + (k - 1) * times.h)
            vectors = method.tangent(system, states[k - 1], before, times.h)[1] @ vectors
        if k and k % frame.every == 0:
            lengths = make_orthonormal(vectors)
            if lengths is None:
                return k
            increment = np.log(lengths) + remainder
            remainder = increment - ((total + increment) - total)
            total = total + increment
        if k in saved:
            lengths = make_orthonormal(vectors.copy())
            logarithms[saved[k]] = np.nan if lengths is None else total + (remainder + np.log(lengths))
    return 0


def make_orthonormal(vectors: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Orthonormalize the columns of (n, k) in place by modified Gram-Schmidt.

    Return the length of each column after the projections, (k,); None if a column is not finite or depends on the
    previous ones.

    Examples
    --------
    >>> vectors = np.array([[3.0, 5.0], [0.0, 2.0]])
    >>> make_orthonormal(vectors).tolist(), vectors.tolist()
    ([3.0, 2.0], [[1.0, 0.0], [0.0, 1.0]])
    """
    # cumsum adds in the order of the indices on every machine.
    lengths = np.sqrt(np.cumsum(vectors**2, axis=0)[-1])
    for r in range(vectors.shape[1]):
        vector = vectors[:, r]
        length = np.sqrt(np.cumsum(vector**2)[-1])
        if not (length > NEARLY_DEPENDENT * lengths[r] and np.isfinite(length)):
            return None
        lengths[r] = length
        vector /= length
        later = vectors[:, r + 1 :]
        later -= vector[:, None] * np.cumsum(vector[:, None] * later, axis=0)[-1]
    return np.asarray(lengths)


def _warn_once(scheme: type) -> None:
    if scheme in _warned_types:
        return
    _warned_types.add(scheme)
    warnings.warn(
        f"the tangents of {scheme.__name__} are computed in Python, about a hundred times slower than those of flow "
        "and Runge-Kutta methods, which are compiled",
        RuntimeWarning,
        stacklevel=2,
    )
