"""Which functions of a user are compiled to the same code? Those of one text whose numbers are equal."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

import numpy as np

from coadjoint.systems.user_functions import MultipleOf

PLAIN = (bool, int, float, complex, str, bytes, type(None))
# Larger arrays are not read: a function that has one is like itself alone.
LARGEST_READ = 1 << 16


class _Unlike(Exception):
    """A function reads something that may be another thing in every function, or change."""


def key_of(function: Callable[..., Any]) -> Any:
    """Return what is equal for functions that compile to the same code.

    A function is its text, its defaults, what it has closed over and what it reads of its module, where these are
    numbers, text, small arrays, modules and other such functions. Any other function is like itself alone.

    Parameters
    ----------
    function : callable
        Of the user.

    Returns
    -------
    hashable

    Examples
    --------
    >>> def times(a):
    ...     return lambda x: a * x
    >>> key_of(times(2.0)) == key_of(times(2.0)), key_of(times(2.0)) == key_of(times(3.0))
    (True, False)
    """
    try:
        return _key(function, [])
    except _Unlike:
        return function


def _key(value: Any, inside: list[Any]) -> Any:
    if isinstance(value, PLAIN):
        return type(value), repr(value)
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype == object or array.nbytes > LARGEST_READ:
            raise _Unlike
        return type(value), array.dtype.str, array.shape, array.tobytes(), array.flags.c_contiguous
    if isinstance(value, tuple):
        return tuple, tuple(_key(entry, inside) for entry in value)
    if isinstance(value, types.ModuleType | types.BuiltinFunctionType | np.ufunc | type):
        return value
    if isinstance(value, MultipleOf):
        return MultipleOf, _key(value.function, inside), _key(value.factor, inside), value.scalar
    if not isinstance(value, types.FunctionType):
        raise _Unlike
    if any(value is one for one in inside):
        return "again", [value is one for one in inside].index(True)
    inside = [*inside, value]
    names = sorted(name for name in _names(value.__code__) if name in value.__globals__)
    try:
        closed = [cell.cell_contents for cell in value.__closure__ or ()]
    except ValueError:  # a name that has no value yet
        raise _Unlike from None
    read = [value.__defaults__, *closed, *(value.__globals__[name] for name in names)]
    keywords = tuple(sorted((name, _key(one, inside)) for name, one in (value.__kwdefaults__ or {}).items()))
    return value.__code__, tuple(names), tuple(_key(one, inside) for one in read), keywords


def _names(code: types.CodeType) -> set[str]:
    """Return the names that a function and those inside of it read."""
    inside = [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return set(code.co_names).union(*map(_names, inside))
