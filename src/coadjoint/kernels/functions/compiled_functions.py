"""Functions that the kernels call by address: user functions compiled to a fixed signature, and tabulated formulas."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from coadjoint.algebra.invariants.invariant import Forms
from coadjoint.kernels.tables.structures import as_structure, filled
from coadjoint.optional_packages import installed, require_packages
from coadjoint.systems.hamiltonians.traced_function import picklable_function, restored_function


class CompiledFunction:
    """A user function compiled to a C address, of `size` numbers y, or of one if `scalar`, and the time if `timed`; it
    returns a number, or if `flat` an array of `results` numbers. The object keeps the machine code alive.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        size: int,
        results: int,
        *,
        scalar: bool,
        flat: bool,
        timed: bool,
        what: str,
    ) -> None:
        require_packages(f"{what}, a Python function,", "numba")
        from coadjoint.kernels.functions.compilation import callback_of

        self._callback = callback_of(function, size, results, scalar, flat, timed, what)
        self._arguments = function, size, results, scalar, flat, timed, what
        self.address: int = self._callback.address

    def __reduce__(self) -> tuple[Any, ...]:
        """Return arguments that compile the function again in another process."""
        function, *others = self._arguments
        return _recompiled, (picklable_function(function), *others)


def warn_slow_compilation(functions: Iterable[Callable[..., Any]]) -> None:
    """Warn before compiling so many Python functions that it takes seconds; do nothing without Numba."""
    if installed("numba"):
        from coadjoint.kernels.functions.compilation import warn_many_functions

        warn_many_functions(list(functions))


def _recompiled(function: Any, size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str) -> Any:
    restored = restored_function(function)
    return CompiledFunction(restored, size, results, scalar=scalar, flat=flat, timed=timed, what=what)


class FormulaFunction:
    """A formula table for the kernels, identified by the negative of its address; the object keeps the table alive."""

    def __init__(self, forms: Forms) -> None:
        self._table = as_structure(forms)
        self.address: int = -ctypes.addressof(self._table)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return arguments that build the formula again in another process."""
        return FormulaFunction, (self._table.source,)


class CompiledShares:
    """A compiled `SumOfShares`, identified by the negative and odd address of its table."""

    def __init__(self, share: CompiledFunction, shares: int, results: int) -> None:
        self._arguments = share, shares, results
        self._table = filled("SharedFunction", address=share.address, shares=shares, results=results)
        self.address: int = -ctypes.addressof(self._table) - 1

    def __reduce__(self) -> tuple[Any, ...]:
        """Return arguments that build the table again in another process."""
        return CompiledShares, self._arguments


CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)
"""A function of (y, t), whose values are written to the last address; matrices are in C order."""


class CalledInPython:
    """A function called in Python by its C address, of a ctypes `prototype`: `call` with its arguments, whose exception
    is raised again in the thread of the run. If the prototype has a result, it is 1 after an exception and else 0.
    """

    def __init__(self, prototype: Any, call: Callable[..., None]) -> None:
        self._raised: BaseException | None = None

        def guarded(*arguments: Any) -> int:
            try:
                call(*arguments)
            except BaseException as error:
                self._raised = error
                return 1
            return 0

        self._callback = prototype(guarded)
        self.address: int = ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def check(self) -> None:
        """Raise the exception of an earlier call, if there was one."""
        if self._raised is not None:
            raise self._raised

    def raised(self) -> BaseException | None:
        """Return and clear the exception that the function raised, if any."""
        error, self._raised = self._raised, None
        return error


MAX_WARNED = 256
_WARNED: dict[Any, Any] = {}


def warn_once(function: Any, message: str) -> None:
    """Warn that a function, or the step of a class, is called in Python, once for each value that can be hashed."""
    try:
        hash(function)
        key = function
    except TypeError:
        key = id(function)
    if key in _WARNED:
        return
    if len(_WARNED) == MAX_WARNED:
        _WARNED.clear()
    _WARNED[key] = function  # which keeps its id from being used again
    warnings.warn(message, RuntimeWarning, stacklevel=2)


class PythonCallback(CalledInPython):
    """A function of (y, t), y an array of `size` numbers, called in Python; it returns `results` numbers."""

    def __init__(self, function: Callable[..., Any], size: int, results: int = 1) -> None:
        self._arguments = function, size, results
        block, result_block = ctypes.c_double * size, ctypes.c_double * results

        def call(y: int, t: float, out: int) -> None:
            values = result_block.from_address(out)
            values[0] = float("nan")  # stops the loop
            self.check()
            result = function(np.frombuffer(memoryview(block.from_address(y))).copy(), t)
            values[:] = np.ravel(result).tolist()

        super().__init__(CALLBACK, call)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return arguments that make the function callable in another process."""
        return PythonCallback, self._arguments


def raised_by(owners: Iterable[Any]) -> BaseException | None:
    """Return and clear the exception that a function called in Python raised, if any."""
    return next((error for owner in owners if (error := getattr(owner, "raised", lambda: None)())), None)


Owner = CompiledFunction | CompiledShares | FormulaFunction | PythonCallback
Owners = tuple[Owner, ...]
"""Owners of the objects that addresses point to: they must live as long as the addresses are in use."""
