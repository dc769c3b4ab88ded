"""Evaluation points of functions in any number type, and sparse sums of products of such numbers."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.numbers import exact_number, exact_numbers
from coadjoint.labels import labelled
from coadjoint.rounding import in_standard_mode
from coadjoint.validation import REAL_KINDS, read_numbers, to_array

MethodT = TypeVar("MethodT", bound=Callable[..., Any])


def ignore_overflow(method: MethodT) -> MethodT:
    """Decorate a method: in the standard floating-point mode overflow gives infinity or NaN, without a warning."""
    quiet = in_standard_mode(np.errstate(over="ignore", invalid="ignore", divide="ignore")(method))

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
        if labelled(x) is not None and hasattr(self, "states_by_label"):
            x = self.states_by_label(x)
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
    """Return `coefficients` in a type whose products with `x` are lossless: exact numbers for objects, or float64."""
    return exact_numbers(coefficients.tolist()) if x.dtype == object else coefficients.astype(np.float64)


def scatter(rows: npt.NDArray[np.int64], entries: npt.NDArray[Any], n: int) -> npt.NDArray[Any]:
    """Return the sums of `entries` over equal `rows`, shape (n,), each added in index order."""
    if entries.dtype == np.float64:
        return np.bincount(rows, weights=entries, minlength=n)
    sums = np.zeros(n, dtype=entries.dtype)
    np.add.at(sums, rows, entries)
    return sums


MAX_BITS = 4096
"""Largest spread of exponents, or size of a common denominator, for which sums are exact."""


class ProductSums:
    """The sums over equal rows of c_k x_(i_k) u_(j_k) ..., shape (n,), in the number type of the factors."""

    # Sums of mpmath numbers are rounded once, to their precision.

    def __init__(self, rows: npt.NDArray[Any], coefficients: npt.NDArray[Any], n: int) -> None:
        self._rows, self._coefficients, self._n = rows, coefficients, n
        # By rows: the order of the coefficients, the start of each row with some, and these rows.
        self._order = np.argsort(rows, kind="stable")
        by_rows = rows[self._order]
        self._starts = np.flatnonzero(np.diff(by_rows, prepend=-1))
        self._summed: list[int] = by_rows[self._starts].tolist()

    @property
    def size(self) -> int:
        return len(self._rows)

    def __call__(self, *factors: tuple[npt.NDArray[Any], npt.NDArray[Any]]) -> npt.NDArray[Any]:
        """Return the sums, with each factor given as an array of numbers and its indices."""
        exact = self.by_integers(*factors)
        if exact is not None:
            return exact
        products = lossless_coefficients(self._coefficients, factors[0][0])
        for values, index in factors:
            products = products * values[index]
        return scatter(self._rows, products, self._n)

    def by_integers(self, *factors: tuple[npt.NDArray[Any], npt.NDArray[Any]]) -> npt.NDArray[Any] | None:
        """Return the sums of mpmath numbers; None if not all are finite, of one context and with similar exponents."""
        numerators, denominator = self._integers
        if numerators is None:
            return None
        products, exponent, kind = numerators, 0, None
        for values, index in factors:
            found = _integers(values, kind)
            if found is None:
                return None
            integers, shift, kind = found
            products, exponent = products * integers[index[self._order]], exponent + shift
        assert kind is not None
        sums = np.add.reduceat(products, self._starts) if len(self._starts) else products
        return self._rounded(sums, denominator, exponent, kind.context)

    @cached_property
    def _integers(self) -> tuple[npt.NDArray[Any] | None, int]:
        """The coefficients by rows as integers over a common denominator; None if they are not rational, or long."""
        return _over_common_denominator(self._coefficients[self._order].tolist())

    def _rounded(self, sums: Iterable[int], denominator: int, exponent: int, context: Any) -> npt.NDArray[Any]:
        from mpmath.libmp import from_int, from_man_exp, mpf_div

        precision, rounding = context._prec_rounding
        result = np.full(self._n, context.zero, dtype=object)
        divisor = from_int(denominator)
        for row, total in zip(self._summed, sums, strict=True):
            if denominator & (denominator - 1):
                value = mpf_div(from_man_exp(total, exponent), divisor, precision, rounding)
            else:
                value = from_man_exp(total, exponent - denominator.bit_length() + 1, precision, rounding)
            result[row] = context.make_mpf(value)
        return result


def _over_common_denominator(values: list[Any]) -> tuple[npt.NDArray[Any] | None, int]:
    """Return rational numbers as integers over a common denominator; None if that is too large, or for others."""
    exact = [exact_number(value) for value in values]
    if not all(isinstance(value, int | Fraction) for value in exact):
        return None, 1
    denominator = 1
    for each in {value.denominator for value in exact}:
        denominator = math.lcm(denominator, each)
        if denominator.bit_length() > MAX_BITS:
            return None, 1
    return exact_numbers([value.numerator * (denominator // value.denominator) for value in exact]), denominator


def _integers(values: npt.NDArray[Any], kind: Any) -> tuple[npt.NDArray[Any], int, Any] | None:
    """Return mpmath numbers as integers times a power of two, with their type; None if that is not possible."""
    if values.dtype != object or not len(values):
        return None
    kind = type(values[0]) if kind is None else kind
    # Intervals and complex numbers have no `_mpf_`; nor do the numbers of other packages.
    if not hasattr(kind, "_mpf_") or not all(type(value) is kind for value in values):
        return None
    parts = [value._mpf_ for value in values]
    exponents = [exponent for _, mantissa, exponent, _ in parts if mantissa]
    if any(not mantissa and exponent for _, mantissa, exponent, _ in parts):  # infinite or undefined
        return None
    least = min(exponents, default=0)
    if max(exponents, default=0) - least > MAX_BITS:
        return None
    return (
        exact_numbers(
            [
                int(-mantissa if sign else mantissa) << (exponent - least) if mantissa else 0
                for sign, mantissa, exponent, _ in parts
            ]
        ),
        least,
        kind,
    )
