"""Compiler options of the kernels, and selection and loading of the compiled kernels for this processor."""

from __future__ import annotations

import ctypes
import functools
import json
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from coadjoint.short_repr import short

FOLDER = Path(__file__).parent
# The libraries are not Python extension modules: their names do not contain the Python version.
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
SOURCE = FOLDER / "source"


def _read_options(source: Path) -> Any:
    return json.loads((source / "options.json").read_text(encoding="utf-8"))


def levels(source: Path = SOURCE) -> tuple[int, ...]:
    """Return the x86-64 levels that the kernels can be built for, highest first; `source` is the folder of the C++."""
    return tuple(sorted((int(name.removeprefix("v")) for name in _read_options(source)["levels"]), reverse=True))


def level_options(level: int | None, source: Path = SOURCE) -> list[str]:
    """Return the compiler options of one of `levels`; None is a processor that is not x86-64."""
    option_lists = _read_options(source)
    return list(option_lists["elsewhere"] if level is None else option_lists["levels"][f"v{level}"])


def compiler_options(tuned: Sequence[str], source: Path = SOURCE) -> list[str]:
    """Return all compiler options for a source file; `tuned` are those of `level_options`, or a replacement."""
    # All code of Windows can be moved; Clang refuses the option there.
    movable = [] if sys.platform == "win32" else ["-fPIC"]
    return [*_read_options(source)["always"], *tuned, "-DNDEBUG", *movable, f"-I{source}"]


def _missing(name: str) -> ImportError:
    return ImportError(
        f"the compiled kernels ({name}) are missing from {FOLDER}: install the package "
        "with a C++ compiler at hand, for instance by `pip install --force-reinstall coadjoint`"
    )


def _load(name: str) -> ctypes.CDLL:
    path = FOLDER / f"{name}{SUFFIX}"
    if not path.exists():
        raise _missing(name)
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        raise ImportError(
            f"the compiled kernels {path} cannot be loaded ({error}): build them again on this machine, for "
            "instance by `pip install --force-reinstall --no-binary coadjoint coadjoint`"
        ) from error


def processor_level() -> int | None:
    """Return the highest level of `levels` that this processor has; None if it is not x86-64."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return None
    return int(_load("_processor").processor_level())


def built_levels() -> list[int]:
    """Return the levels of the libraries that are built, highest first; empty if the processor is not x86-64."""
    return [level for level in levels() if (FOLDER / f"_kernels_v{level}{SUFFIX}").exists()]


def level_in_use() -> int | None:
    """Return the highest level that is built and supported by the processor; None if it is not x86-64."""
    highest = processor_level()
    requested = os.environ.get("COADJOINT_LEVEL")
    if highest is None:
        if requested is not None:
            raise ImportError(
                f"COADJOINT_LEVEL is {short(requested)}, but only x86-64 processors have levels: unset it"
            )
        return None
    supported, built = [level for level in levels() if level <= highest], built_levels()
    usable = [level for level in built if level <= highest]
    can_use = f"this processor can use {_listed(supported)}"
    if requested is not None:
        for level in usable:
            if requested == f"v{level}":
                return level
        advice = _build_advice(requested) if requested in _names(supported) else ""
        raise ImportError(
            f"COADJOINT_LEVEL is {short(requested)}, but {can_use}, and of the kernels {_listed(built)} "
            f"{'is' if len(built) == 1 else 'are'} built{advice}"
        )
    if not built:
        raise _missing(f"_kernels_v{highest}")
    if not usable:
        raise ImportError(
            f"the compiled kernels in {FOLDER} are built for {_listed(built)}, but {can_use}"
            f"{_build_advice(f'v{supported[0]}')}"
        )
    return usable[0]


def _names(levels: Sequence[int]) -> list[str]:
    return [f"v{level}" for level in levels]


def _listed(levels: Sequence[int]) -> str:
    return ", ".join(_names(levels)) or "none"


def _build_advice(level: str) -> str:
    return f": build it by `COADJOINT_LEVELS={level} pip install --force-reinstall --no-binary coadjoint coadjoint`"


@functools.cache
def kernels() -> ctypes.CDLL:
    """Return the library for the highest level of this processor that is built, or that of ``COADJOINT_LEVEL``."""
    level = level_in_use()
    library = _load("_kernels" if level is None else f"_kernels_v{level}")
    library.set_standard_mode.restype, library.restore_mode.argtypes = ctypes.c_int64, [ctypes.c_int64]
    return library


@functools.cache
def interruptible_kernels() -> ctypes.PyDLL:
    """Return the library with loops called under Python's global lock, which they release and take to check signals.

    Exceptions of handlers are raised by the call. Once the interpreter is finalizing, they suspend a daemon thread.
    """
    library = kernels()
    python = ctypes.pythonapi
    finalizing = python.Py_IsFinalizing if hasattr(python, "Py_IsFinalizing") else python._Py_IsFinalizing
    callbacks = python.PyEval_SaveThread, python.PyEval_RestoreThread, python.PyErr_CheckSignals, finalizing
    library.set_python_callbacks(*(ctypes.cast(function, ctypes.c_void_p) for function in callbacks))
    return ctypes.PyDLL(library._name, handle=library._handle)
