"""The C interface of the compiled library, called by ctypes in a copy, as programs without Python do."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from ctypes import POINTER, c_char_p, c_double, c_int, c_int64, c_size_t, c_void_p
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = POINTER(c_double)
SIGNATURES: dict[str, tuple[Any, ...]] = {
    "runs_version": (c_int,),
    "message": (c_char_p,),
    "create": (c_int, c_char_p, c_size_t, POINTER(c_void_p)),
    "destroy": (None, c_void_p),
    "size": (c_size_t, c_void_p),
    "step_length": (c_double, c_void_p),
    "steps": (c_int64, c_void_p),
    "set_state": (c_int, c_void_p, NUMBERS, c_size_t),
    "get_state": (c_int, c_void_p, NUMBERS, c_size_t),
    "step": (c_int, c_void_p),
    "advance": (c_int, c_void_p, c_int64),
    "save": (c_int, c_void_p, c_int64, c_int64, NUMBERS, c_size_t),
    "jvp": (c_int, c_void_p, c_int64, NUMBERS, NUMBERS, c_size_t),
    "vjp": (c_int, c_void_p, c_int64, NUMBERS, NUMBERS),
}


class Failed(Exception):
    """A code other than zero, and the message."""


def exported_library(folder: Path) -> Path:
    """Write the header and the library to a folder, and return the path of the library."""
    command = [sys.executable, "-m", "coadjoint", "export", "--library", "-o", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    (library,) = folder.glob("libcoadjoint.*")
    return library


class Interface:
    """The functions of a library."""

    def __init__(self, library: Path) -> None:
        self.library = ctypes.CDLL(str(library))
        for name, (result, *arguments) in SIGNATURES.items():
            function = getattr(self.library, f"coadjoint_{name}")
            function.restype, function.argtypes = result, arguments

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function; Failed if it returns the code of a failure."""
        found = getattr(self.library, f"coadjoint_{name}")(*map(_passed, arguments))
        if SIGNATURES[name][0] is c_int and name != "runs_version" and found != 0:
            raise Failed(found, self.library.coadjoint_message().decode())
        return found

    def run(self, table: str | bytes) -> Run:
        """Create a run from a table."""
        return Run(self, table.encode() if isinstance(table, str) else table)


class Run:
    """A run of the interface; arrays that are given are not changed."""

    def __init__(self, interface: Interface, table: bytes) -> None:
        self.interface, self.address = interface, c_void_p()
        interface.call("create", table, len(table), ctypes.byref(self.address))

    def __del__(self) -> None:
        self.interface.call("destroy", self.address)

    def call(self, name: str, *arguments: Any) -> Any:
        return self.interface.call(name, self.address, *arguments)

    @property
    def x(self) -> Any:
        x = np.full(self.call("size"), np.nan)
        self.call("get_state", x, len(x))
        return x

    @x.setter
    def x(self, value: Any) -> None:
        x = np.array(value, dtype=np.float64)
        self.call("set_state", x, len(x))

    def save(self, points: int, every: int = 1) -> Any:
        saved = np.full((points, self.call("size")), np.nan)
        self.call("save", points, every, saved, saved.size)
        return saved

    def jvp(self, x: Any, steps: int, vectors: Any) -> Any:
        x, moved = np.array(x, dtype=np.float64), np.array(vectors, dtype=np.float64)
        self.call("jvp", steps, x, moved, len(moved))
        return x, moved

    def vjp(self, x: Any, steps: int, covector: Any) -> Any:
        found = np.array(covector, dtype=np.float64)
        self.call("vjp", steps, np.array(x, dtype=np.float64), found)
        return found


def _passed(value: Any) -> Any:
    return value.ctypes.data_as(NUMBERS) if isinstance(value, np.ndarray) else value
