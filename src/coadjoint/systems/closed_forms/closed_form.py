"""Closed-form solutions: functions of (x0, t, attitude) made of motions, which take a valid state and times (k,)."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.representation import expected_elements, group_elements
from coadjoint.short_repr import short
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]


def require_closed_form(exact: Callable[..., Any] | None, name: str) -> Callable[..., Any]:
    """Return the closed form of a system; raise TypeError if there is none."""
    if exact is None:
        raise TypeError(f"no closed form is known for {name}; integrate it")
    return exact


def start_and_times(x0: Any, t: Any, n: int) -> tuple[Floats, Floats]:
    """Validate the arguments of a closed form: the state at time zero, shape (n,), and the times, shape () or (k,)."""
    start, times = read_finite(x0, "x0"), read_finite(t, "t")
    if start.shape != (n,):
        raise ValueError(f"x0 has shape {start.shape}; give {n} finite numbers")
    if times.ndim > 1:
        raise ValueError(f"t has shape {times.shape}; give one finite time or several, (k,)")
    return start, times


def move_state(name: str, n: int, motion: Callable[..., Any], x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Return ``motion(start, times)``, (k, n), at one time or several: a closed form of the state alone."""
    if _flag(attitude) is not False:
        raise TypeError(f"{name} has a closed form of the state alone; leave attitude out, or integrate")
    start, times = start_and_times(x0, t, n)
    with np.errstate(all="ignore"):
        x = motion(start, np.atleast_1d(times))
    return _checked(x, start, times)


def move_state_and_element(
    n: int, size: int, motion: Callable[..., Any], x0: Any, t: Any, attitude: Any = False
) -> Any:
    """Return the states of ``motion(start, times)``, (k, n), and if asked for the group elements, from the first."""
    # The motion returns both, the elements, (k, size, size), from the identity.
    start, times = start_and_times(x0, t, n)
    first = initial_group_element(attitude, size)
    with np.errstate(all="ignore"):
        x, g = motion(start, np.atleast_1d(times))
        g = first @ g
    states, elements = _checked(x, start, times), _checked(g, start, times)
    return states if _flag(attitude) is False else (states, elements)


def _flag(attitude: Any) -> bool | None:
    """Return whether group elements are asked for; None for the one at time zero."""
    return bool(attitude) if isinstance(attitude, bool | np.bool_) else None


def initial_group_element(attitude: Any, size: int) -> Floats:
    """Return the group element at time zero: the identity, or the one given as `attitude`."""
    if _flag(attitude) is not None:
        return np.eye(size)
    block = 0 if size == 3 else None
    first = read_finite(group_elements(attitude, size, block), "attitude")
    if first.shape != (size, size):
        shape = np.shape(attitude) or first.shape  # a Rotation has none
        raise ValueError(f"attitude has shape {shape}; give True or a finite {expected_elements(size, block)}")
    return first


def _checked(x: Any, start: Floats, times: Floats) -> Floats:
    """Return results of a motion, (k, ...), in the shape of the times; raise ValueError if they overflow."""
    results = np.asarray(x, dtype=np.float64)
    if not np.isfinite(results).all():
        raise ValueError(
            f"the closed form overflows from x0 = {short(start.tolist())} to t = {short(times.tolist())}; "
            "take smaller ones"
        )
    return results if times.ndim else results[0]


def rotate_about(spins: Floats, axis: Floats, t: Floats) -> Floats:
    """Rotate spins about an axis: the solution of ``S' = S cross axis`` at time t."""
    rate = np.sqrt(np.sum(axis**2, axis=-1))
    direction = axis / np.where(rate > 0.0, rate, 1.0)[..., None]
    angle = (rate * t)[..., None]
    across = spins - direction * np.sum(direction * spins, axis=-1, keepdims=True)
    return spins + np.sin(angle) * np.cross(spins, direction) - 2.0 * np.sin(angle / 2) ** 2 * across


def oscillator_solutions(stiffness: float, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the solutions of y'' = -stiffness y from (1, 0) and (0, 1), and of y'' = 1 - stiffness y from (0, 0)."""
    rate = sqrt(abs(stiffness))
    if not rate:
        return np.ones_like(t), t, t * t / 2
    cosine, sine = (np.cos, np.sin) if stiffness > 0 else (np.cosh, np.sinh)
    return cosine(rate * t), sine(rate * t) / rate, 2 * (sine(rate * t / 2) / rate) ** 2
