"""Floating-point modes of a thread, set as a program or a library would: by the C library."""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# The control word of a processor in `fenv_t`: its offset in bytes, rounding up, down and to zero, and flush to zero.
X86, ARM = (0x4000, 0x2000, 0x6000, 0x8040), (1 << 22, 2 << 22, 3 << 22, 1 << 24)
LAYOUTS = {
    ("linux", "x86_64"): (28, *X86),
    ("darwin", "x86_64"): (4, *X86),
    ("linux", "aarch64"): (0, *ARM),
    ("darwin", "arm64"): (8, *ARM),
}
NAMES = ("upward", "downward", "toward zero", "flush to zero")
_LAYOUT = LAYOUTS.get((sys.platform, platform.machine()))
MODES = {} if _LAYOUT is None else dict(zip(NAMES, _LAYOUT[1:], strict=True))
"""Names of the modes that this machine is known to have, and their bits."""


def _environment() -> ctypes.Array[ctypes.c_char]:
    environment = ctypes.create_string_buffer(64)
    ctypes.CDLL(None).fegetenv(environment)
    return environment


def control() -> int:
    """Return the bits of `MODES` of this thread."""
    assert _LAYOUT is not None
    word = ctypes.c_uint32.from_buffer(_environment(), _LAYOUT[0]).value
    return word & (_LAYOUT[3] | _LAYOUT[4])


@contextmanager
def float_mode(name: str) -> Iterator[None]:
    """Let this thread compute in a mode, and check that it still does at the end."""
    assert _LAYOUT is not None
    library, before, changed = ctypes.CDLL(None), _environment(), _environment()
    ctypes.c_uint32.from_buffer(changed, _LAYOUT[0]).value |= MODES[name]
    try:
        assert library.fesetenv(changed) == 0 and control() == MODES[name]
        yield
        assert control() == MODES[name]
    finally:
        library.fesetenv(before)
