"""Reference motions: a closed form, a function of time, or an interpolated run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import check_finite, read_numbers

Floats = NDArray[np.float64]
Motion = Callable[[Floats], Floats]

NODES = 8  # saved points around a time; with their slopes they define a polynomial of degree 15
FEWER_NODES = 6  # for the comparison that estimates the error
TOLERANCE = 2.0**-30  # largest difference of the polynomials of both degrees, relative to the largest state


def motion_of(system: System, reference: Any, x0: ArrayLike, member: int | None = None) -> Motion:
    """Return the motion of a closed form (None), a function or a run, as a function of times; NaN outside of a run."""
    if reference is None:
        if system.algebra is None or system.closed_form is None:
            raise TypeError(
                f"no closed form is known for {system.name}; give a reference: a better run, or a function of t"
            )
        return lambda t: np.asarray(system.exact(x0, t))  # type: ignore[union-attr]
    if isinstance(reference, Solution):
        return _interpolated(system, reference, member)
    if not callable(reference):
        raise TypeError(
            f"reference is {short(reference)}; give a Solution, a function of t, or None for the closed form"
        )

    check_arguments(reference, "reference", "t")

    def validated(t: Floats) -> Floats:
        states = read_numbers(reference(t), "what reference(t) returned")
        if states.shape != (len(t), system.dim):
            raise ValueError(f"reference(t) has the shape {states.shape}; it must be ({len(t)}, {system.dim})")
        check_finite(states, "what reference(t) returned")
        return states

    return validated


def check_same_times(reference: Floats, run: Floats) -> None:
    """Raise ValueError if a reference has other saved times than a run."""
    if not np.array_equal(reference, run):
        raise ValueError("the reference has other saved times than the run; save both at the same times")


def field_along(system: System, states: Floats, times: Floats) -> Floats:
    """Return the vector field at states of shape (k, n), each at its time."""
    values = [system.vector_field(state, t) for state, t in zip(states, times.tolist(), strict=True)]
    return np.array(values).reshape(states.shape)


def _interpolated(system: System, run: Solution, member: int | None) -> Motion:
    """Return a run as a function of time, by Hermite interpolation of its points and their slopes."""
    states = run.x if member is None or run.x.ndim == 2 else run.x[:, member]
    if states.ndim != 2:
        raise ValueError(
            f"the reference has states of the shape {run.x.shape}; it must be one run, or members as the run has"
        )
    if states.shape[1] != system.dim:
        raise ValueError(f"the reference has {states.shape[1]} coordinates; the system has {system.dim}")
    t = run.t
    if len(t) < NODES:
        raise ValueError(f"the reference has {len(t)} saved points; {NODES} are needed to interpolate")
    slopes = field_along(system, states, t)
    largest = float(np.max(np.abs(states)))
    direction = 1.0 if t[-1] > t[0] else -1.0
    ascending = direction * t

    def at(times: Floats) -> Floats:
        tolerance = (ascending[-1] - ascending[0]) * 2.0**-20
        inside = (direction * times >= ascending[0] - tolerance) & (direction * times <= ascending[-1] + tolerance)
        values = np.full((len(times), system.dim), np.nan)
        values[inside] = interpolate(times[inside])
        return values

    def interpolate(times: Floats) -> Floats:
        after = np.searchsorted(ascending, direction * times)
        fine, coarse = (_hermite(t, states, slopes, times, after, count) for count in (NODES, FEWER_NODES))
        # The polynomial of more points is more accurate than this difference by orders of magnitude.
        difference = float(np.max(np.abs(fine - coarse), initial=0.0))
        if difference > TOLERANCE * largest:
            raise ValueError(
                f"the saved points of the reference are too far apart for interpolation, with an error of about "
                f"{difference:.1e}; save it more often"
            )
        return fine

    return at


def _hermite(t: Floats, x: Floats, slopes: Floats, times: Floats, after: NDArray[np.int64], count: int) -> Floats:
    """Interpolate states at times, each by the `count` saved points around index `after` and their slopes."""
    first = np.clip(after - count // 2, 0, len(t) - count)
    index = first[:, None] + np.arange(count)
    unit = abs(t[-1] - t[0]) / (len(t) - 1)
    s = (t[index] - t[first][:, None]) / unit
    u = (times - t[first]) / unit
    distances = s[:, :, None] - s[:, None] + np.eye(count)
    from_node = u[:, None] - s
    factors = np.where(np.eye(count, dtype=bool), 1.0, from_node[:, None, :] / distances)
    basis = np.prod(factors, axis=2)
    basis_slopes = np.sum(np.where(np.eye(count, dtype=bool), 0.0, 1.0 / distances), axis=2)
    values = (1.0 - 2.0 * basis_slopes * from_node) * basis**2
    tangents = from_node * basis**2 * unit
    return np.asarray(np.einsum("kj,kjn->kn", values, x[index]) + np.einsum("kj,kjn->kn", tangents, slopes[index]))
