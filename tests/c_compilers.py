"""Compilers of C and C++ of this machine, and libraries that they build."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

STRICT = {
    "c": ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion"),
    "c++": ("-std=c++11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wshadow"),
}


def compilers() -> dict[str, list[str]]:
    """Return the commands of GCC and Clang (also of the package ziglang) that are installed, for C."""
    found = {name: [path] for name in ("gcc", "clang") if (path := shutil.which(name))}
    if "clang" not in found and importlib.util.find_spec("ziglang") is not None:
        found["clang"] = [sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined"]
    return found


def compiled(
    compiler: str, source: Path, target: Path, *flags: str, language: str = "c", libraries: Sequence[str] = ("-lm",)
) -> Path:
    """Compile a file with all warnings as errors; it may include headers of its folder."""
    command = [*compilers()[compiler], "-x", language, *STRICT[language], *flags, f"-I{source.parent}", str(source)]
    done = subprocess.run([*command, "-o", str(target), *libraries], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return target


def library(compiler: str, source: Path, target: Path, *flags: str, language: str = "c") -> ctypes.CDLL:
    """Compile a file as a shared library and load it."""
    return ctypes.CDLL(str(compiled(compiler, source, target, "-shared", "-fPIC", *flags, language=language)))
