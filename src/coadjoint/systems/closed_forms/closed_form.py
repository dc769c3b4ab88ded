"""Helpers for closed-form solutions: arguments, group elements, checks of results."""

from __future__ import annotations

from collections.abc import Callable
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


def reject_attitude(attitude: Any, name: str) -> None:
    """Raise TypeError if an attitude is requested from a closed form that has none."""
    if not isinstance(attitude, bool | np.bool_) or attitude:
        raise TypeError(f"{name} has a closed form of the state alone; leave attitude out, or integrate")


def initial_group_element(attitude: Any, size: int) -> Floats:
    """Return the group element at time zero: the identity, or the one given as `attitude`."""
    if isinstance(attitude, bool | np.bool_):
        return np.eye(size)
    block = 0 if size == 3 else None
    first = read_finite(group_elements(attitude, size, block), "attitude")
    if first.shape != (size, size):
        shape = np.shape(attitude) or first.shape  # a Rotation has none
        raise ValueError(f"attitude has shape {shape}; give True or a finite {expected_elements(size, block)}")
    return first


def with_group_element(x: Floats, g: Floats, attitude: Any) -> Any:
    """Return the states, or the pair (states, group elements) if `attitude` requests it."""
    return x if isinstance(attitude, bool | np.bool_) and not attitude else (x, g)


def check_finite_states(x: Floats, start: Floats, times: Floats) -> Floats:
    """Return the states of a closed form; raise ValueError if they overflow."""
    if not np.isfinite(x).all():
        raise ValueError(
            f"the closed form overflows from x0 = {short(start.tolist())} to t = {short(times.tolist())}; "
            "take smaller ones"
        )
    return x
