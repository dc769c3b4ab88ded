"""Compilation of user functions; machine code is reused only if everything the function reads is unchanged."""

from __future__ import annotations

import types
import warnings
from collections.abc import Callable
from typing import Any

import numba

from coadjoint.interruption import deferred
from coadjoint.kernels.functions.code_reads import cell_value, is_own
from coadjoint.kernels.functions.contents import contents_of

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


def fresh_dispatchers(function: Any) -> Any:
    """Return a function in which each dispatcher is replaced by one without machine code."""
    if isinstance(function, types.FunctionType):
        return _copied(function, {})
    return _with_fresh_dispatchers(function, {}, False)


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
    attributes = _attributes(function.__code__)
    for name in attributes & names.keys():
        names[name] = _with_fresh_dispatchers(_module(names[name], attributes, fresh), fresh, False)
    return copy


def _module(value: Any, attributes: set[str], fresh: dict[int, tuple[Any, Any]]) -> Any:
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


def _attributes(code: types.CodeType) -> set[str]:
    inside = [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*map(_attributes, inside))
