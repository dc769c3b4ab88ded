"""Compilation of user functions by Numba; imported only if Numba is installed."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
from numba import carray, types

from coadjoint.kernels.functions.contents import compilation_key
from coadjoint.kernels.functions.fresh_code import compile_cached, compiled_digests, fresh_dispatchers
from coadjoint.systems.user_functions import MultipleOf

SIGNATURE = types.void(types.CPointer(types.float64), types.float64, types.CPointer(types.float64))


def callback_of(
    function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str
) -> Any:
    """Return a function as a C callback; TypeError with the reason of Numba if it cannot be compiled."""

    def make() -> Any:
        try:
            return _compiled(function, size, results, scalar, flat, timed)
        except Exception as error:  # Numba raises exceptions of many types
            raise TypeError(f"{what} cannot be compiled by Numba: {numba_error_text(error)}") from error

    return compile_cached(function, (size, results, scalar, flat, timed), what, make)


# Functions from which on a warning is given, after some seconds of compilation, and the time (s) that one takes.
WARNING_COUNT = 48
SECONDS_PER_FUNCTION = 0.05


def warn_many_functions(functions: Sequence[Callable[..., Any]]) -> None:
    """Warn before compiling so many functions of a Hamiltonian that it takes seconds."""
    if len(functions) < WARNING_COUNT:
        return
    count = len({compilation_key(function) for function in functions} - compiled_digests())
    if count >= WARNING_COUNT:
        warnings.warn(
            f"{count} different Python functions are compiled one by one, about {SECONDS_PER_FUNCTION * count:.0f} s "
            "in all; it is faster to write one function of many commuting coordinates, with an array of constants: "
            "SplitHamiltonian([((0, 3, 6), Hamiltonian(value, gradient))])",
            UserWarning,
            stacklevel=2,
        )


def _compiled(function: Callable[..., Any], size: int, results: int, scalar: bool, flat: bool, timed: bool) -> Any:
    body = _WRAPPERS[(scalar, flat and not scalar, timed)](_inner(function), size, results)
    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(body)


def _inner(function: Any) -> Any:
    """Return a function in the form that compiled code calls."""
    if isinstance(function, MultipleOf):
        return _multiple(_inner(function.function), function.factor, function.scalar)
    return (
        numba.njit(boundscheck=True, **_INTERNAL_OPTIONS)(fresh_dispatchers(function))
        if inspect.isfunction(function)
        else fresh_dispatchers(function)
    )


# Called by compiled code only, so that no Python wrappers are compiled.
_INTERNAL_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _multiple(inner: Any, factor: float, scalar: bool) -> Any:
    if scalar:
        return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * inner(*arguments))
    return numba.njit(**_INTERNAL_OPTIONS)(lambda *arguments: factor * np.asarray(inner(*arguments)))


def numba_error_text(error: Exception) -> str:
    """Return the informative lines of a Numba error, joined to one line."""
    lines = [line.strip(" -\x1b[0123456789;m") for line in str(error).splitlines()]
    informative = [
        line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "For more", "<"))
    ]
    return " ".join(informative[:3])[:400]


def _numbers(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        out[0] = inner(y[0])

    return call


def _timed_numbers(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        out[0] = inner(y[0], t)

    return call


def _value(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        out[0] = inner(carray(y, (size,)))

    return call


def _timed_value(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        out[0] = inner(carray(y, (size,)), t)

    return call


def _array(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        for k in range(results):
            out[k] = np.nan
        values = np.asarray(inner(carray(y, (size,)))).ravel()
        for k in range(results):
            out[k] = values[k]

    return call


def _timed_array(inner: Any, size: int, results: int) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        for k in range(results):
            out[k] = np.nan
        values = np.asarray(inner(carray(y, (size,)), t)).ravel()
        for k in range(results):
            out[k] = values[k]

    return call


# The result is NaN until the function returns: if it raises, the NaN remains and stops the run.
_WRAPPERS: dict[tuple[bool, bool, bool], Callable[[Any, int, int], Callable[..., None]]] = {
    (True, False, False): _numbers,
    (True, False, True): _timed_numbers,
    (False, False, False): _value,
    (False, False, True): _timed_value,
    (False, True, False): _array,
    (False, True, True): _timed_array,
}
