"""Functions behind an address: those of a user, compiled to one fixed signature, and formulas that the kernels know."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from coadjoint.algebra.logarithmic import Forms
from coadjoint.extras import need
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
        self.address: int = self._callback.address


class TabledFunction:
    """A formula as the kernels read it, known by the negative of its address; it is kept alive while it is in use."""

    def __init__(self, forms: Forms) -> None:
        self._table = pointed(forms)
        self.address: int = -ctypes.addressof(self._table)


Kept = tuple[CompiledFunction | TabledFunction, ...]
"""The owners of what stands at addresses: they must live as long as the addresses are in use."""
