"""Functions of the user whose new arrays are converted, so that they can be filled with objects of a tracer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import CellType, CodeType, FunctionType
from typing import Any

import numpy as np

CREATORS: tuple[Callable[..., Any], ...] = (
    *(np.zeros, np.empty, np.ones, np.full, np.eye, np.identity, np.array, np.diag),
    *(np.zeros_like, np.empty_like, np.ones_like, np.full_like, np.copy),
)
"""Functions of NumPy whose new arrays of floats a function may fill with coordinates."""


class _NumPy:
    """NumPy, of which `CREATORS` return converted arrays, and in which some functions are replaced."""

    def __init__(self, convert: Callable[[Any], Any], replaced: Sequence[tuple[Any, Any]]) -> None:
        self._convert, self._replaced = convert, replaced

    def __getattr__(self, name: str) -> Any:
        return self.of(getattr(np, name))

    def of(self, function: Any) -> Any:
        """Return a function, replaced, or of NumPy that converts what it returns; anything else unchanged."""
        for known, other in self._replaced:
            if function is known:
                return other
        if not any(function is creator for creator in CREATORS):
            return function

        def create(*arguments: Any, **options: Any) -> Any:
            found = function(*arguments, **options)
            return self._convert(found) if getattr(found, "dtype", None) == np.float64 else found

        return create


def with_new_arrays(function: Any, convert: Callable[[Any], Any], replaced: Sequence[tuple[Any, Any]] = ()) -> Any:
    """Return a copy of a function of the user; it and those that it calls, unless `replaced`, convert new arrays."""
    numpy, copies = _NumPy(convert, replaced), dict[int, Any]()

    def names_in(code: CodeType) -> set[str]:
        return {*code.co_names}.union(*(names_in(one) for one in code.co_consts if isinstance(one, CodeType)))

    def of(value: Any) -> Any:
        value = getattr(value, "py_func", value)
        if value is np:
            return numpy
        found = numpy.of(value)
        if found is not value or not isinstance(value, FunctionType):
            return found
        if value.__module__.partition(".")[0] in ("numpy", "jax"):
            return value
        if id(value) not in copies:
            given, cells = value.__closure__ or (), tuple(CellType() for _ in value.__closure__ or ())
            names = value.__globals__.copy()
            copies[id(value)] = FunctionType(value.__code__, names, value.__name__, value.__defaults__, cells)
            copies[id(value)].__kwdefaults__ = value.__kwdefaults__
            names.update({name: of(names[name]) for name in names_in(value.__code__) & {*names}})
            for cell, one in zip(cells, given, strict=True):
                cell.cell_contents = of(one.cell_contents)
        return copies[id(value)]

    return of(function)
