"""Phase errors of states against a closed form, a function of time or an interpolated run; angles between attitudes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import check_finite, read_finite, read_numbers

Floats = npt.NDArray[np.float64]
Motion = Callable[[Floats], Floats]

NODES = 8  # saved points around a time; with their slopes they define a polynomial of degree 15
FEWER_NODES = 6  # for the comparison that estimates the error
TOLERANCE = 2.0**-30  # largest difference of the polynomials of both degrees, relative to the largest state

MAX_ITERATIONS = 30  # of Newton's method, which needs some five
FIRST_POINTS = 4  # points with initial guess zero; then the number of points is doubled, by extrapolation


@suggest_keywords
def phase_error(
    system: System, x0: npt.ArrayLike, t: npt.ArrayLike, x: npt.ArrayLike, reference: Any = None
) -> npt.NDArray[np.float64]:
    """Return the signed phase error of computed states: the time by which they are ahead of the exact motion.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system; without a reference it needs a closed form.
    x0 : array_like, shape (n,)
        The state of the closed form at time zero.
    t : array_like, shape (k,)
        Times.
    x : array_like, shape (k, n)
        Computed states.
    reference : callable or Solution, optional
        The reference motion: a function of times (k,) that returns states (k, n), or a run by a more accurate scheme or
        with a smaller step, with saved points dense enough for interpolation. None is the closed form.

    Returns
    -------
    ndarray, shape (k,)
        The lead d for which right(t + d) is the point nearest to x, in units of time; positive is early, negative late.
        NaN if no nearest point is found, or the reference ends too early. For ordered times leads are continued from
        the first one and may exceed a period; otherwise they are less than half a period.

    Raises
    ------
    ValueError
        The states do not match the times, or the saved points of the reference are too far apart.
    TypeError
        No closed form is known.

    Notes
    -----
    Gauss-Newton on ``|x - right(t + d)|^2``: d changes by ``f . (x - y) / |f|^2`` at y = right(t + d), with f the
    vector field there. A motion of several angles has a phase error in each of them, and the lead is an average; see
    `line_drift`.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, t = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([1.0, 2.0])
    >>> early = body.exact((1.0, 2.0, 0.5), t + 0.01)
    >>> phase_error(body, (1.0, 2.0, 0.5), t, early).round(12)
    array([0.01, 0.01])
    """
    check_vector_states(system, "phase errors are available for states that are vectors")
    times, states = read_finite(t, "t"), read_finite(x, "x")
    if times.ndim != 1 or states.shape != (len(times), system.dim):
        raise ValueError(
            f"x has the shape {states.shape}; it must be ({times.size}, {system.dim}), a state for each time"
        )
    return leads(system, motion_of(system, reference, x0), times, states)


@ignore_overflow
def leads(system: System, motion_at: Motion, times: Floats, states: Floats) -> Floats:
    """Return the leads of states relative to a motion, continued if the times are in order; see `phase_error`."""
    ordered = len(times) > FIRST_POINTS and (np.all(np.diff(times) > 0.0) or np.all(np.diff(times) < 0.0))
    if not ordered:
        return _solve_leads(system, motion_at, times, states, np.zeros(len(times)))
    lead = np.full(len(times), np.nan)
    first, last = 0, FIRST_POINTS
    while first < len(times):
        lead[first:last] = _solve_leads(
            system, motion_at, times[first:last], states[first:last], _extrapolated(times, lead, first, last)
        )
        first, last = last, min(2 * last, len(times))
    return lead


def _extrapolated(times: Floats, lead: Floats, first: int, last: int) -> Floats:
    """Extrapolate the later half of the known leads to the next times, by a least-squares line."""
    known = np.flatnonzero(np.isfinite(lead[:first]))
    known = known[len(known) // 2 :]
    if len(known) < 2:
        return np.zeros(last - first)
    slope, at_zero = np.polyfit(times[known], lead[known], 1)
    return np.asarray(slope * times[first:last] + at_zero)


def _solve_leads(
    system: System,
    motion_at: Motion,
    times: Floats,
    states: Floats,
    lead: Floats,
) -> Floats:
    change = np.full(len(times), np.inf)
    for _ in range(MAX_ITERATIONS):
        # Points without a state or a lead are evaluated somewhere, and stay without one.
        moments = times + np.where(np.isfinite(lead), lead, 0.0)
        y = motion_at(moments)
        f = field_along(system, y, moments)
        # Off the orbit Gauss-Newton converges linearly, down to the round-off of the exact motion.
        change = np.einsum("ki,ki->k", f, states - y) / np.einsum("ki,ki->k", f, f)
        lead = lead + change
        if np.all(np.isnan(change)) or np.nanmax(np.abs(change)) <= 2.0**-40 * max(1.0, float(np.max(np.abs(times)))):
            break
    settled = np.isfinite(lead) & (np.abs(change) <= 2.0**-20 * np.maximum(1.0, np.abs(times)))
    return np.where(settled, lead, np.nan)


def motion_of(system: System, reference: Any, x0: npt.ArrayLike, member: int | None = None) -> Motion:
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


def _hermite(t: Floats, x: Floats, slopes: Floats, times: Floats, after: npt.NDArray[np.int64], count: int) -> Floats:
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


@suggest_keywords
def attitude_angle(A: npt.ArrayLike, B: npt.ArrayLike) -> Any:
    """Return the angle of the rotation from one attitude to another.

    Parameters
    ----------
    A, B : array_like, shape (..., 3, 3)
        Rotation matrices; their leading shapes broadcast.

    Returns
    -------
    float or ndarray, shape (...)
        Angle of A^T B in radians, from 0 to pi, to a few units of round-off everywhere.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3.

    Notes
    -----
    With R = A^T B, ``atan2(|axial vector of (R - R^T)/2|, (tr R - 1)/2)``; the arccosine alone would lose half of the
    digits near 0 and pi.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> attitude_angle(np.eye(3), quarter) == np.pi / 2
    True
    """
    first, second = _read_matrices(A, "A"), _read_matrices(B, "B")
    angle = _axis_and_angle(np.swapaxes(first, -1, -2) @ second)[1]
    return float(angle) if angle.ndim == 0 else angle


@suggest_keywords
def precession_error(A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike) -> Any:
    """Return the angle by which an attitude is ahead of another one in its rotation about an axis fixed in space.

    About the angular momentum A x, which is fixed in space, it is the signed phase error of a rigid body.

    Parameters
    ----------
    A, B : array_like, shape (..., 3, 3)
        Computed and exact attitude, from the body to space.
    axis : array_like, shape (3,)
        Non-zero vector in space.

    Returns
    -------
    float or ndarray, shape (...)
        Component along the axis of the rotation vector of A B^T, in radians; of either sign for half turns.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3, or the axis is not a non-zero vector of three numbers.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> precession_error(np.eye(3), quarter, [0.0, 0.0, 5.0]) == -np.pi / 2
    True
    """
    rotation_axis, angle, direction = _relative_rotation(A, B, axis)
    along = rotation_axis @ direction * angle
    return float(along) if along.ndim == 0 else along


@suggest_keywords
def twist(A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike) -> Any:
    """Return the twist about an axis fixed in space of the rotation from one attitude to another.

    Near zero it equals `precession_error`; over many turns, where a rotation vector jumps, it remains the angle modulo
    2 pi.

    Parameters
    ----------
    A, B, axis
        As for `precession_error`.

    Returns
    -------
    float or ndarray, shape (...)
        Angle from -pi to pi of the factor of A B^T that rotates about the axis; of either sign for half turns about it,
        and arbitrary for half turns across it.

    Raises
    ------
    ValueError
        The matrices are not 3 x 3, or the axis is not a non-zero vector of three numbers.

    Examples
    --------
    >>> quarter = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    >>> round(twist(np.eye(3), quarter, [0.0, 0.0, 5.0]) / np.pi, 12)
    -0.5
    """
    rotation_axis, angle, direction = _relative_rotation(A, B, axis)
    twisted = 2.0 * np.arctan2(rotation_axis @ direction * np.sin(0.5 * angle), np.cos(0.5 * angle))
    return float(twisted) if twisted.ndim == 0 else twisted


def acts_by_rotations(system: Any) -> bool:
    """Return whether the group elements of a system are rotations of space that carry its momentum."""
    rotations: Any = catalogue.so(3).representation
    return np.array_equal(system.representation, rotations)


def _relative_rotation(A: npt.ArrayLike, B: npt.ArrayLike, axis: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return axis and angle of A B^T, and the unit vector along `axis`."""
    direction = read_finite(axis, "axis")
    if direction.shape != (3,) or not np.any(direction):
        raise ValueError(f"axis is {short(axis)}; it must be three numbers, not all zero")
    direction /= np.max(np.abs(direction))  # so that its square does not overflow
    rotation_axis, angle = _axis_and_angle(_read_matrices(A, "A") @ np.swapaxes(_read_matrices(B, "B"), -1, -2))
    return rotation_axis, angle, direction / np.linalg.norm(direction)


def _read_matrices(value: npt.ArrayLike, name: str) -> Floats:
    matrices = read_finite(value, name)
    if matrices.shape[-2:] != (3, 3):
        raise ValueError(f"{name} has the shape {matrices.shape}; it must be (..., 3, 3)")
    return matrices


def _axis_and_angle(R: Floats) -> tuple[Floats, Floats]:
    """Return the axis (zero for the identity, of either sign for half turns) and the angle, 0 to pi, of rotations."""
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine, cosine = 0.5 * np.linalg.norm(axial, axis=-1), 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    axis = axial / np.where(sine > 0.0, 2.0 * sine, 1.0)[..., None]
    # The axial vector vanishes at half turns. The symmetric part, (1 - cos) n n^T + cos, determines n up to its sign.
    outer = 0.5 * (R + np.swapaxes(R, -1, -2)) - cosine[..., None, None] * np.eye(3)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    column = np.where(np.sum(column * axial, axis=-1, keepdims=True) < 0.0, -column, column)
    obtuse = cosine < 0.0
    length = np.where(obtuse, np.linalg.norm(column, axis=-1), 1.0)
    return np.where(obtuse[..., None], column / length[..., None], axis), np.arctan2(sine, cosine)
