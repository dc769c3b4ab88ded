"""Compilation of user functions by Numba; machine code is reused only if everything that they read is unchanged."""

from __future__ import annotations

import types
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
from numba import carray
from numba import types as numba_types

from coadjoint.interruption import deferred
from coadjoint.kernels.functions.contents import cell_value, compilation_key, contents_of, global_reads, is_own
from coadjoint.systems.user_functions import MultipleOf

POINTER = numba_types.CPointer(numba_types.float64)
SIGNATURE = numba_types.void(POINTER, numba_types.float64, POINTER)
# Number of compiled functions that are kept; the oldest one is dropped for the next.
MAX_CACHED = 4096
_COMPILED: dict[Any, Any] = {}
_FRESH: dict[str, Any] = {}
_warned: set[str] = set()


def compile_cached(value: Any, options: tuple[Any, ...], what: str, make: Callable[[], Any]) -> Any:
    """Return the cached result of `make`, valid while `value` and everything its functions read are unchanged. Values
    that cannot be compared are compiled again on each call, with a warning. An interrupt waits for `make`: if it ended
    a generator of Numba's registries, Numba would compile nothing more in this process.
    """
    contents = contents_of(value)
    if contents.unknown:
        with deferred():
            result = make()
        if what not in _warned:
            _warned.add(what)
            warnings.warn(
                f"{what} is compiled again whenever it is prepared, since some values it reads cannot be compared: "
                f"{', '.join(contents.unknown[:3])}",
                UserWarning,
                stacklevel=2,
            )
        return result
    key = contents.digest, options
    if key not in _COMPILED:
        with deferred():
            _cache(_COMPILED, key, make())
    return _COMPILED[key]


def compiled_digests() -> set[str]:
    """Return the digests of all compiled functions."""
    return {digest for digest, _ in _COMPILED}


def _cache(cache: dict[Any, Any], key: Any, value: Any) -> None:
    while len(cache) >= MAX_CACHED:
        del cache[next(iter(cache))]
    cache[key] = value


def _with_fresh_dispatchers(value: Any, fresh: dict[int, tuple[Any, Any]], compiles: bool) -> Any:
    """Return a value with fresh dispatchers; if `compiles`, plain functions are compiled too."""
    if id(value) in fresh:
        return fresh[id(value)][1]
    if isinstance(value, tuple) and type(value) is tuple:
        return tuple(_with_fresh_dispatchers(entry, fresh, compiles) for entry in value)
    if isinstance(value, types.FunctionType) and compiles:
        return _with_fresh_dispatchers(numba.njit(value, error_model="numpy"), fresh, compiles)
    if not isinstance(value, numba.core.dispatcher.Dispatcher):
        return value
    contents = contents_of(value)
    if contents.unknown or contents.digest not in _FRESH:
        new: Any = None

        def register_copy(copy: types.FunctionType) -> None:
            nonlocal new
            new = type(value)(copy, value.locals, value.targetoptions)
            fresh[id(value)] = value, new

        _copied(value.py_func, fresh, register_copy)
        if not value._can_compile:
            for signature in value.nopython_signatures:
                new.compile(signature)
            new.disable_compile()
        if contents.unknown:
            return new
        _cache(_FRESH, contents.digest, new)
    return _FRESH[contents.digest]


def _copied(
    function: types.FunctionType,
    fresh: dict[int, tuple[Any, Any]],
    register_copy: Callable[[types.FunctionType], None] | None = None,
) -> types.FunctionType:
    """Return a copy of a function that reads fresh dispatchers, or if recursive what `register_copy` registers."""
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    names = dict(function.__globals__)
    copy = types.FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells or None)
    copy.__kwdefaults__, copy.__qualname__ = function.__kwdefaults__, function.__qualname__
    copy.__module__ = function.__module__
    vars(copy).update(vars(function))
    if register_copy is not None:
        register_copy(copy)
    compiles = is_own(function.__module__ or "")
    for new, old in zip(cells, function.__closure__ or (), strict=True):
        for value in cell_value(old):
            new.cell_contents = _with_fresh_dispatchers(value, fresh, compiles)
    _, attributes, _ = global_reads(function.__code__)
    for name in attributes & names.keys():
        names[name] = _with_fresh_dispatchers(_module(names[name], attributes, fresh), fresh, False)
    return copy


def _module(value: Any, attributes: frozenset[str], fresh: dict[int, tuple[Any, Any]]) -> Any:
    """Return a copy of a module with fresh dispatchers if it has any that are read; return other values unchanged."""
    if not isinstance(value, types.ModuleType):
        return value
    replaced = {
        name: _with_fresh_dispatchers(vars(value)[name], fresh, False) for name in attributes & vars(value).keys()
    }
    if all(vars(value)[name] is value_of_name for name, value_of_name in replaced.items()):
        return value
    copy = types.ModuleType(value.__name__)
    vars(copy).update({**vars(value), **replaced})
    return copy


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
    # The result is NaN until the function returns: if it raises, the NaN remains and stops the run.
    inner = called_in_machine_code(function)
    body = _array(inner, size, results, timed) if flat and not scalar else _value(inner, size, scalar, timed)
    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(body)


def called_in_machine_code(function: Any) -> Any:
    """Return a function in the form that compiled code calls, in which no dispatcher has machine code yet."""
    if isinstance(function, MultipleOf):
        return _multiple(called_in_machine_code(function.function), function.factor, function.scalar)
    if isinstance(function, types.FunctionType):
        return numba.njit(boundscheck=True, **_INTERNAL_OPTIONS)(_copied(function, {}))
    return _with_fresh_dispatchers(function, {}, False)


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


def _value(inner: Any, size: int, scalar: bool, timed: bool) -> Callable[..., None]:
    """Return a callback for one number; Numba compiles only the branches of these arguments."""

    def call(y: Any, t: float, out: Any) -> None:
        out[0] = np.nan
        x = y[0] if scalar else carray(y, (size,))
        out[0] = inner(x, t) if timed else inner(x)

    return call


def _array(inner: Any, size: int, results: int, timed: bool) -> Callable[..., None]:
    def call(y: Any, t: float, out: Any) -> None:
        for k in range(results):
            out[k] = np.nan
        x = carray(y, (size,))
        values = np.asarray(inner(x, t) if timed else inner(x)).ravel()
        for k in range(results):
            out[k] = values[k]

    return call
