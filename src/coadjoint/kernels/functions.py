"""Functions behind an address: those of a user, compiled to one fixed signature, and formulas that the kernels know."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from coadjoint.algebra.logarithmic import Forms
from coadjoint.extras import installed, need
from coadjoint.kernels.structures import pointed


class CompiledFunction:
    """A user function behind a C address; keeps the machine code alive as long as the address is in use.

    Parameters
    ----------
    function : callable
        Pure Python function of ``y`` (array of ``size`` numbers, or one number when `scalar`), or of ``(y, t)``.
    size : int
        Number of coordinates that it reads.
    results : int
        Number of values that it returns.
    scalar : bool
        Whether it takes and returns plain numbers.
    flat : bool
        Whether it returns an array (flattened in C order) rather than a number.
    timed : bool
        Whether it takes the time as a second argument.
    what : str
        What the function is, for the error message.

    Raises
    ------
    MissingPackageError
        Numba is not installed.
    TypeError
        If Numba cannot compile the function; the message carries its reason.
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
        need(f"{what}, a Python function,", "numba")
        from coadjoint.kernels.callbacks import callback_of

        self._callback = callback_of(function, size, results, scalar, flat, timed, what)
        self._given = function, size, results, scalar, flat, timed, what
        self.address: int = self._callback.address

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what compiles the function again, in another process."""
        return _compiled_again, self._given


def tell_of_compiling(functions: Iterable[Callable[..., Any]]) -> None:
    """Warn beforehand where functions of Python are so many that compiling them takes seconds; without Numba say
    nothing here.
    """
    if installed("numba"):
        from coadjoint.kernels.callbacks import tell_of_many

        tell_of_many(list(functions))


def _compiled_again(function: Any, size: int, results: int, scalar: bool, flat: bool, timed: bool, what: str) -> Any:
    return CompiledFunction(function, size, results, scalar=scalar, flat=flat, timed=timed, what=what)


class TabledFunction:
    """A formula as the kernels read it, known by the negative of its address; it is kept alive while it is in use."""

    def __init__(self, forms: Forms) -> None:
        self._table = pointed(forms)
        self.address: int = -ctypes.addressof(self._table)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the same of the formula in another process."""
        return TabledFunction, (self._table.source,)


CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.POINTER(ctypes.c_double))


class CalledFunction:
    """A function of (y, t) that is called in Python, some microseconds at a time.

    Parameters
    ----------
    function : callable
        Takes an array of `size` numbers and a time, and returns a number.
    size : int
        Number of coordinates that it reads.
    """

    def __init__(self, function: Callable[..., Any], size: int) -> None:
        self._raised: BaseException | None = None
        self._given = function, size
        block = ctypes.c_double * size

        def call(y: int, t: float, out: Any) -> None:
            out[0] = float("nan")
            try:
                if self._raised is None:
                    out[0] = function(np.frombuffer(memoryview(block.from_address(y))).copy(), t)
            except BaseException as error:
                # NaN says that something is wrong, and what was raised is raised again where the run is.
                self._raised = error

        self._callback = CALLBACK(call)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value or 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes the function callable in another process."""
        return CalledFunction, self._given

    def raised(self) -> BaseException | None:
        """Return what the function raised, once, if it did."""
        found, self._raised = self._raised, None
        return found


Kept = tuple[CompiledFunction | TabledFunction | CalledFunction, ...]
"""The owners of what stands at addresses: they must live as long as the addresses are in use."""
