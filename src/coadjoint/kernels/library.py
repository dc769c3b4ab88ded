"""The compiled kernels, found for this processor."""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path

from coadjoint.kernels import compiling
from coadjoint.wording import short

FOLDER = Path(__file__).parent
# They are no Python modules, so that their names do not hold the version of Python.
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def _missing(name: str) -> ImportError:
    return ImportError(
        f"the compiled kernels ({name}) are missing from {FOLDER}: install the package "
        "with a C++ compiler at hand, for instance by `pip install --force-reinstall coadjoint`"
    )


def _load(name: str) -> ctypes.CDLL:
    place = FOLDER / f"{name}{SUFFIX}"
    if not place.exists():
        raise _missing(name)
    try:
        return ctypes.CDLL(str(place))
    except OSError as error:
        raise ImportError(
            f"the compiled kernels {place} cannot be loaded ({error}): build them again on this machine, for "
            "instance by `pip install --force-reinstall --no-binary coadjoint coadjoint`"
        ) from error


def processor_level() -> int | None:
    """Return the highest level of `coadjoint.kernels.compiling` that this processor has; None where it is no x86-64."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    return int(_load("_processor").processor_level())


def built_levels() -> list[int]:
    """Return the levels of the libraries that are there, the highest first; none where the processor is no x86-64."""
    return [level for level in compiling.levels() if (FOLDER / f"_kernels_v{level}{SUFFIX}").exists()]


def level_in_use() -> int | None:
    """Return the level of `kernels`: the highest that is built and that this processor has; None on other processors.

    Returns
    -------
    int or None

    Raises
    ------
    ImportError
        There is none, or not the one that the environment variable ``COADJOINT_LEVEL`` asks for.
    """
    highest = processor_level()
    asked = os.environ.get("COADJOINT_LEVEL")
    if highest is None:
        if asked is not None:
            raise ImportError(f"COADJOINT_LEVEL is {short(asked)}, but only x86-64 processors have levels: unset it")
        return None
    known, built = [level for level in compiling.levels() if level <= highest], built_levels()
    usable = [level for level in built if level <= highest]
    can_use = f"this processor can use {_listed(known)}"
    if asked is not None:
        for level in usable:
            if asked == f"v{level}":
                return level
        raise ImportError(
            f"COADJOINT_LEVEL is {short(asked)}, but {can_use}, and of the kernels {_listed(built)} "
            f"{'is' if len(built) == 1 else 'are'} built{_how_to_build(asked) if asked in _names(known) else ''}"
        )
    if not built:
        raise _missing(f"_kernels_v{highest}")
    if not usable:
        raise ImportError(
            f"the compiled kernels in {FOLDER} are built for {_listed(built)}, but {can_use}"
            f"{_how_to_build(f'v{known[0]}')}"
        )
    return usable[0]


def _names(some: Sequence[int]) -> list[str]:
    return [f"v{level}" for level in some]


def _listed(some: Sequence[int]) -> str:
    return ", ".join(_names(some)) or "none"


def _how_to_build(level: str) -> str:
    return f": build it by `COADJOINT_LEVELS={level} pip install --force-reinstall --no-binary coadjoint coadjoint`"


@functools.cache
def kernels() -> ctypes.CDLL:
    """Return the library of kernels for this processor, on x86-64 the one of the highest level that it can use.

    All levels give the same bits; the environment variable ``COADJOINT_LEVEL`` (v1, v3 or v4), read when the library is
    first used, asks for another one that is built, so that they can be compared.

    Raises
    ------
    ImportError
        It was not built or cannot be loaded, or ``COADJOINT_LEVEL`` is none that is built and that the processor has.
    """
    level = level_in_use()
    return _load("_kernels" if level is None else f"_kernels_v{level}")


@functools.cache
def listening_kernels() -> ctypes.PyDLL:
    """Return the same library for its loops, which are called with Python's lock.

    The loops release the lock while they work, and take it now and then to check for signals. What a handler raises is
    raised by the call of the loop. In a daemon thread they suspend the thread once the interpreter is finalizing.
    """
    library = kernels()
    python = ctypes.pythonapi
    finalizing = python.Py_IsFinalizing if hasattr(python, "Py_IsFinalizing") else python._Py_IsFinalizing
    heard = python.PyEval_SaveThread, python.PyEval_RestoreThread, python.PyErr_CheckSignals, finalizing
    library.listen(*(ctypes.cast(function, ctypes.c_void_p) for function in heard))
    return ctypes.PyDLL(library._name, handle=library._handle)
