"""The compiled kernels, found for this processor."""

from __future__ import annotations

import ctypes
import functools
import importlib.machinery
import os
import platform
from pathlib import Path

from coadjoint.wording import short

# Levels of the x86-64 instructions that the kernels are built for: AVX-512, AVX2, and what every processor has.
LEVELS = (4, 3, 1)
FOLDER = Path(__file__).parent


def _load(name: str) -> ctypes.CDLL:
    found = [path for suffix in importlib.machinery.EXTENSION_SUFFIXES if (path := FOLDER / f"{name}{suffix}").exists()]
    if not found:
        raise ImportError(
            f"the compiled kernels ({name}) are missing from {FOLDER}: install the package "
            "with a C++ compiler at hand, for instance by `pip install --force-reinstall coadjoint`"
        )
    try:
        return ctypes.CDLL(str(found[0]))
    except OSError as error:
        raise ImportError(
            f"the compiled kernels {found[0]} cannot be loaded ({error}): build them again on this machine, for "
            "instance by `pip install --force-reinstall --no-binary coadjoint coadjoint`"
        ) from error


def processor_level() -> int | None:
    """Return the highest of `LEVELS` that this processor has, or None where it is no x86-64."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    return int(_load("_processor").processor_level())


@functools.cache
def kernels() -> ctypes.CDLL:
    """Return the library of kernels for this processor, on x86-64 the one of the highest level that it has.

    All levels give the same bits; the environment variable ``COADJOINT_LEVEL`` (v1, v3 or v4), read when the library is
    first used, asks for a lower one, so that they can be compared.

    Raises
    ------
    ImportError
        It was not built or cannot be loaded, or ``COADJOINT_LEVEL`` is none that the processor has.
    """
    highest = processor_level()
    if highest is None:
        return _load("_kernels")
    level = os.environ.get("COADJOINT_LEVEL", f"v{highest}")
    usable = [f"v{known}" for known in LEVELS if known <= highest]
    if level not in usable:
        raise ImportError(f"COADJOINT_LEVEL is {short(level)}, but this processor can use {', '.join(usable)}")
    return _load(f"_kernels_{level}")


@functools.cache
def listening_kernels() -> ctypes.PyDLL:
    """Return the same library for its loops, which are called with Python's lock.

    They give it back while they work, and take it now and then to hear signals; what a handler raises is raised by the
    call of the loop.
    """
    library = kernels()
    python = ctypes.pythonapi
    heard = python.PyEval_SaveThread, python.PyEval_RestoreThread, python.PyErr_CheckSignals
    library.listen(*(ctypes.cast(function, ctypes.c_void_p) for function in heard))
    return ctypes.PyDLL(library._name, handle=library._handle)
