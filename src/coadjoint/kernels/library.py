"""The compiled kernels: found for this processor, and handed tables as C structures."""

from __future__ import annotations

import ctypes
import functools
import importlib.machinery
import platform
from pathlib import Path
from typing import Any

import numpy as np

# What a field is, by its type in `source/tables.hpp`: a number, or the elements of an array.
SCALARS: dict[str, Any] = {"integer": ctypes.c_int64, "number": ctypes.c_double, "flag": ctypes.c_int64}
ARRAYS: dict[str, Any] = {
    "bytes": np.dtype(np.uint8),
    "indices": np.dtype(np.uint32),
    "integers": np.dtype(np.int64),
    "numbers": np.dtype(np.float64),
}


def _path(name: str) -> Path | None:
    folder = Path(__file__).parent
    for suffix in importlib.machinery.EXTENSION_SUFFIXES:
        if (folder / f"{name}{suffix}").exists():
            return folder / f"{name}{suffix}"
    return None


def _load(name: str) -> ctypes.CDLL:
    found = _path(name)
    if found is None:
        raise ImportError(
            f"the compiled kernels ({name}) are missing from {Path(__file__).parent}: install the package "
            "with a C++ compiler at hand, for instance by `pip install --force-reinstall coadjoint`"
        )
    return ctypes.CDLL(str(found))


@functools.cache
def kernels() -> ctypes.CDLL:
    """Return the library of kernels for this processor.

    Raises
    ------
    ImportError
        It was not built, or the processor has no vector instructions that it was built for.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return _load("_kernels")
    level = _load("_processor").processor_level()
    if level == 0:
        raise ImportError("this processor has no AVX2 with fused multiply-add, which the kernels are built for")
    return _load(f"_kernels_v{level}")


@functools.cache
def structures() -> dict[str, Any]:
    """Return the C structures of the tables by name, as the library itself describes them."""
    describe = kernels().table_fields
    describe.restype = ctypes.c_char_p
    found: dict[str, Any] = {}
    for line in describe().decode().splitlines():
        name, _, fields = line.partition(":")
        pairs = [field.split(" ") for field in fields.split(";") if field]
        members = [
            (label, SCALARS.get(kind) or (ctypes.c_void_p if kind in ARRAYS else found[kind])) for kind, label in pairs
        ]
        found[name] = type(name, (ctypes.Structure,), {"_fields_": members, "kinds": [kind for kind, _ in pairs]})
    return found


def pointed(table: Any) -> Any:
    """Return a table as the C structure of its name; it keeps the arrays alive.

    Parameters
    ----------
    table : NamedTuple
        Its fields are read by name; arrays must be C-contiguous and of the type that the kernels read.

    Returns
    -------
    ctypes.Structure
        The same, if it is given one.

    Raises
    ------
    TypeError
        An array has another type or layout.
    """
    if isinstance(table, ctypes.Structure):
        return table
    kind = structures()[type(table).__name__]
    filled = kind()
    for name, token in zip((name for name, _ in kind._fields_), kind.kinds, strict=True):
        value = getattr(table, name)
        if token in SCALARS:
            setattr(filled, name, value)
        elif token in ARRAYS:
            if value.dtype != ARRAYS[token] or not value.flags.c_contiguous:
                raise TypeError(f"{type(table).__name__}.{name} is {value.dtype}, not a contiguous {ARRAYS[token]}")
            setattr(filled, name, value.ctypes.data)
        else:
            setattr(filled, name, pointed(value))
    filled.source = table
    return filled


def address(array: Any) -> ctypes.c_void_p:
    """Return where the elements of a contiguous array begin."""
    return ctypes.c_void_p(array.ctypes.data)
