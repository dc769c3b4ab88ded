"""Evaluation points of functions: floats, complex numbers and arrays of Python objects are treated alike."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.numbers import exact_numbers
from coadjoint.validation import REAL_KINDS, read_numbers, to_array

MethodT = TypeVar("MethodT", bound=Callable[..., Any])


def ignore_overflow(method: MethodT) -> MethodT:
    """Decorate a method to return infinity or NaN without a warning on overflow of float64."""
    quiet = np.errstate(over="ignore", invalid="ignore", divide="ignore")(method)

    @functools.wraps(method)
    def evaluated(*args: Any, **kwargs: Any) -> Any:
        try:
            return quiet(*args, **kwargs)
        except OverflowError as reason:
            raise OverflowError(f"a number is too large for float64 ({reason})") from None

    return cast(MethodT, evaluated)


def read_point(x: npt.ArrayLike, n: int | None) -> npt.NDArray[Any]:
    """Return `x` as a float64, complex128 or object array of shape (n,)."""
    array = x if type(x) is np.ndarray and x.dtype == np.float64 else to_array(x, "x", "iufc")
    if array.ndim != 1 or (n is not None and array.size != n):
        expected = "(n,)" if n is None else f"({n},)"
        raise ValueError(f"x has shape {array.shape}; a point of this system has shape {expected}")
    return array.astype(np.float64) if array.dtype.kind in REAL_KINDS else array


def vectorized_over_states(method: MethodT) -> MethodT:
    """Extend a method of a state (n,) and a time to several states (..., n), bit-identical to separate calls."""

    @functools.wraps(method)
    def vectorized(self: Any, x: npt.ArrayLike, t: Any = 0.0) -> Any:
        array: npt.NDArray[Any] = x if type(x) is np.ndarray else to_array(x, "x", "iufc")
        if array.ndim < 2 or len(getattr(self, "shape", ())) > 1:  # one state, or matrices
            return method(self, x, t)
        if array.shape[-1] != self.dim:
            n = self.dim
            raise ValueError(f"x has shape {array.shape}; a point of this system has shape ({n},), many have (k, {n})")
        lead = array.shape[:-1]
        times = read_numbers(t, "t")
        if times.ndim > 1 or (times.ndim == 1 and len(times) != lead[0]):
            raise ValueError(f"t has shape {times.shape}; give one time, or one for each of {lead[0]} states")
        state_times = np.broadcast_to(
            times if times.ndim == 0 else times.reshape(-1, *[1] * (len(lead) - 1)), lead
        ).ravel()
        rows = array.reshape(-1, array.shape[-1])
        results = [method(self, row, float(time)) for row, time in zip(rows, state_times, strict=True)]
        if not results:  # without states, return an empty array of the right shape
            example = np.asarray(method(self, np.zeros(array.shape[-1])))
            return np.empty((*lead, *example.shape))
        values = np.asarray(results)
        return values.reshape(*lead, *values.shape[1:])

    return cast(MethodT, vectorized)


def lossless_coefficients(coefficients: npt.NDArray[Any], x: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return `coefficients` in a number type whose products with `x` are lossless: exact ones for objects."""
    if x.dtype != object:
        return coefficients
    return exact_numbers(coefficients.tolist())


def scatter(rows: npt.NDArray[np.int64], entries: npt.NDArray[Any], n: int) -> npt.NDArray[Any]:
    """Return the sums of `entries` over equal `rows`, shape (n,), each added in index order."""
    if entries.dtype == np.float64:
        return np.bincount(rows, weights=entries, minlength=n)
    sums = np.zeros(n, dtype=entries.dtype)
    np.add.at(sums, rows, entries)
    return sums
