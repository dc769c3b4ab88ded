"""Unit round-off of float64, and the floating-point mode of a thread.

A program sets the mode of its threads, rounding and treatment of subnormal numbers, by ``fesetround``, or by loading a
library that was linked with ``-ffast-math``. What the package computes, it computes in the standard mode.
"""

from __future__ import annotations

import functools
import struct

TYPE_CHECKING = False

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any, TypeVar

    Function = TypeVar("Function", bound=Callable[..., Any])

UNIT_ROUNDOFF = 2.0**-53
"""Half the spacing of floats above 1: the largest relative error of one rounding."""
COMPLEX_STEP = 2.0**-300
"""Imaginary step of a derivative: second-order terms vanish, and products do not underflow."""
# Not constants, which Python would compute with when it compiles this; and a bit, which no mode flushes to zero.
ONE, BELOW_ROUNDOFF, SUBNORMAL = 1.0, 2.0**-60, struct.unpack("<d", bytes((1, 0, 0, 0, 0, 0, 0, 0)))[0]


def is_standard_mode() -> bool:
    """Return whether this thread rounds to nearest and keeps subnormal numbers; takes 0.1 us."""
    return ONE + BELOW_ROUNDOFF == ONE - BELOW_ROUNDOFF and SUBNORMAL * ONE > 0.0


def in_standard_mode(function: Function) -> Function:
    """Decorate a function to compute in the standard floating-point mode; afterwards the thread has its own again."""

    @functools.wraps(function)
    def computed(*args: Any, **keywords: Any) -> Any:
        if is_standard_mode():
            return function(*args, **keywords)
        from coadjoint.kernels.library import kernels

        library = kernels()
        mode = library.set_standard_mode()
        try:
            return function(*args, **keywords)
        finally:
            library.restore_mode(mode)

    return computed  # type: ignore[return-value]
