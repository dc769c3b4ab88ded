"""Invariants given as Python functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import function_name, short
from coadjoint.validation import read_number


@suggest_keywords
@dataclass(frozen=True, repr=False)
class Invariant:
    """A function of the state that the motion preserves, given as a Python function.

    Choose it for Casimirs and integrals that are not polynomials; `Polynomial` is faster for polynomials.

    Parameters
    ----------
    value : callable
        Pure function of the state x, an array of shape (n,), that returns a number. Written with `math` functions of
        the coordinates it can be compiled.
    gradient : callable, optional
        Function of x that returns the gradient, shape (n,).
    period : float, optional
        Positive for a multivalued function (a logarithm with an angle): `value` is known up to multiples of `period`
        and is unwrapped along a run. Zero (the default) for a single-valued one.

    Raises
    ------
    TypeError
        `value` or `gradient` cannot be called, or `period` is not a number.
    ValueError
        `period` is negative or not finite.

    Examples
    --------
    >>> ratio = Invariant(lambda x: x[1] / x[0])
    >>> ratio([2.0, 3.0, 1.0])
    1.5
    """

    value: Callable[[Any], Any]
    gradient: Callable[[Any], Any] | None = None
    period: float = 0.0

    def __post_init__(self) -> None:
        if not callable(self.value):
            raise TypeError(f"value of an Invariant must be a function of x, not {short(self.value)}")
        if self.gradient is not None and not callable(self.gradient):
            raise TypeError(f"gradient of an Invariant must be a function of x or None, not {short(self.gradient)}")
        period = read_number(self.period, "period of an Invariant")
        if period < 0.0:
            raise ValueError(f"period of an Invariant is {period!r}; it must not be negative")
        object.__setattr__(self, "period", period)

    def __call__(self, x: Any) -> Any:
        """Return the value at the state x, shape (n,), or the values at states of the shape (..., n)."""
        if np.ndim(x) < 2:
            return self.value(x)
        states = np.asarray(x)
        values = np.array([self.value(row) for row in states.reshape(-1, states.shape[-1])])
        return values.reshape(states.shape[:-1])

    def __repr__(self) -> str:
        period = f", period={self.period:g}" if self.period else ""
        return f"{type(self).__name__}({function_name(self.value)}{period})"
