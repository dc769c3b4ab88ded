"""Signals of runs at equidistant times: momentum, attitude, invariants, observables, or functions of the state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import missing_attitude
from coadjoint.runs.times import accumulated_rounding
from coadjoint.short_repr import short
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import check_finite, read_finite, read_integer, read_numbers, to_array


class SampledSignal(NamedTuple):
    """A signal at equidistant times, with values (members, k, channels).

    `members` and `channels` state whether the argument had these axes.
    """

    t: NDArray[np.float64]
    values: NDArray[Any]
    members: bool
    channels: bool


def sampled(given: Any, signal: Any = None, min_count: int = 2) -> SampledSignal:
    """Return the signal of a run, or samples, at equidistant times; at least `min_count` of them.

    For the kinds of signals see `frequencies`. Raise ValueError for uneven times, too few samples, or values that are
    not finite or do not match the times, and TypeError for another type of signal.

    >>> sampled([0.0, 0.5, 1.0], [1.0, 2.0, 4.0]).values.shape
    (1, 3, 1)
    """
    if isinstance(given, Solution):
        t, values, several = given.t, _signal_of_run(given, signal), given.failed is not None
    else:
        t, several = read_finite(given, "t"), False
        if signal is None or isinstance(signal, str) or callable(signal):
            raise TypeError(f"signal is {short(signal)}; with times t, give its samples as an array")
        values = to_array(signal, "signal", "iufc")
        several = values.ndim == 3
    count = _count_equidistant(t, min_count)
    values = values.astype(np.complex128) if values.dtype.kind == "c" else read_numbers(values, "signal")
    shapes = ((2, 3) if several else (1, 2)) if isinstance(given, Solution) else (1, 2, 3)
    if values.ndim not in shapes or len(values) != len(t):
        expected = (
            f"({len(t)}, members) or ({len(t)}, members, channels)"
            if several
            else f"({len(t)},) or ({len(t)}, channels)"
        )
        raise ValueError(f"signal has the shape {values.shape}; it must be {expected}")
    check_finite(values, "signal")
    channels = values.ndim == (3 if several else 2)
    if not channels:
        values = values[..., None]
    if not several:
        values = values[:, None]
    if 0 in values.shape:
        raise ValueError(f"signal has the shape {values.shape}; it must have at least one member and one channel")
    return SampledSignal(t[:count], np.swapaxes(values[:count], 0, 1), several, channels)


def _signal_of_run(run: Solution, signal: Any) -> NDArray[Any]:
    several = run.failed is not None
    if run.failed is not None and np.any(run.failed):
        raise ValueError(f"member {int(np.argmax(run.failed))} of the run failed; run again without it")
    if signal is None:
        return _flat(run.x, several)
    if isinstance(signal, str):
        if signal == "attitude":
            if run.attitude is None:
                raise ValueError(missing_attitude(run))
            return _flat(run.attitude, several)
        if signal == "energy":
            return run.energy
        if signal not in run.observed:
            known = ", ".join(map(repr, ("attitude", "energy", *run.observed)))
            raise ValueError(f"signal is {short(signal)}; give {known}, or the number of a component")
        return np.asarray(run.observed[signal])
    if callable(signal):
        check_arguments(signal, "signal", "x")
        function: Callable[..., Any] = signal
        return to_array(function(run.x), "what signal(sol.x) returned", "iufc")
    samples = to_array(signal, "signal", "iufc")
    if samples.ndim == 0:
        components = _flat(run.x, several)
        return np.asarray(components[..., read_integer(signal, "signal", 0, components.shape[-1] - 1)])
    return samples


def _flat(values: NDArray[Any], several: bool) -> NDArray[Any]:
    return values.reshape(*values.shape[: 2 if several else 1], -1)


def _count_equidistant(t: NDArray[np.float64], min_count: int) -> int:
    """Return the number of equidistant times; the last time, which may be off the grid, is then not counted."""
    if t.ndim != 1 or len(t) < min_count:
        raise ValueError(f"t has the shape {t.shape}; give at least {min_count} equidistant times, (k,)")
    spacing = (t[-2] - t[0]) / (len(t) - 2) if len(t) > 2 else t[-1] - t[0]
    off = np.abs(t - (t[0] + spacing * np.arange(len(t))))
    rounding = accumulated_rounding(len(t), float(np.min(t)), float(np.max(t)), abs(spacing))
    on_grid = off <= max(64.0 * UNIT_ROUNDOFF * float(np.max(np.abs(t))), rounding)
    count = len(t) - (not on_grid[-1])
    if spacing == 0.0 or not np.all(on_grid[:count]) or count < min_count:
        raise ValueError(f"t is {short(t)}; give at least {min_count} equidistant times")
    return count
