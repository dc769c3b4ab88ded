"""A step in C++ that stands in a file of the user: compiled against the headers of the kernels."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from coadjoint.kernels.compiling import SOURCE, options, tuning
from coadjoint.kernels.library import kernels, level_in_use
from coadjoint.wording import short

COMPILERS = ("c++", "g++", "clang++")
SECONDS = 600.0


@dataclass(frozen=True)
class CompiledStep:
    """A step from a file of the user.

    Parameters
    ----------
    name : str
        The name that its ``STEP_SCHEME`` says.
    path : str
        The file.
    """

    name: str
    path: str

    @property
    def address(self) -> int:
        """Where the step stands in memory."""
        return _address(self.name, self.path)


def compile_step(path: str | Path, name: str | None = None) -> CompiledStep:
    """Compile a step in C++ for this processor, in some seconds, and load it.

    The file includes ``steps/step_scheme.hpp``, derives from ``StepScheme``, and ends with ``STEP_SCHEME(name, Type)``.
    What was compiled is kept for the next process, in the folder ``coadjoint`` of the user's cache, until the file, the
    headers or the compiler change.

    Parameters
    ----------
    path : str or Path
        The file.
    name : str, optional
        The name of the step, where the file has several.

    Returns
    -------
    CompiledStep
        To be returned as `compiled_step` by a scheme that derives from `CompiledStepMethod`.

    Raises
    ------
    ValueError
        There is no such file, it has no such step, or the compiler refuses it; with what it said.
    RuntimeError
        No compiler is installed; ``CXX`` names one.
    """
    source = Path(path)
    try:
        text = source.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{source}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    names = re.findall(r"^\s*STEP_SCHEME\(\s*(\w+)\s*,", text, re.MULTILINE)
    if not names:
        raise ValueError(f"{source}: has no STEP_SCHEME(name, Type), by which a step is found")
    if name is None and len(names) > 1:
        raise ValueError(f"{source}: has the steps {', '.join(names)}; say which, by name=")
    if name is not None and name not in names:
        raise ValueError(f"{source}: has no step {short(name)}; it has {', '.join(names)}")
    step = CompiledStep(name or names[0], str(source.resolve()))
    _address(step.name, step.path)
    return step


@cache
def _address(name: str, path: str) -> int:
    library = _library(Path(path))
    return ctypes.cast(getattr(library, f"{name}_step"), ctypes.c_void_p).value or 0


@cache
def _library(source: Path) -> ctypes.CDLL:
    kernels()  # refuses first, by name, where kernels are missing
    compiler = _compiler()
    # compiled for the level in use, so that the bits are the same
    how = [*options(tuning(level_in_use())), "-DCOADJOINT_APART", "-shared"]
    said = subprocess.run([*compiler, "--version"], capture_output=True, text=True, timeout=SECONDS, check=False).stdout
    key = hashlib.sha256(json.dumps([compiler, how, said]).encode())
    for part in [source, *sorted(SOURCE.rglob("*.hpp"))]:
        key.update(part.read_bytes())
    target = _cache() / f"{source.stem}-{key.hexdigest()[:24]}.so"
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        _build([*compiler, *how, str(source)], source, target)
    library = ctypes.CDLL(str(target))
    lending = kernels().lent_to_others
    lending.restype = ctypes.c_void_p
    library.borrow(ctypes.c_void_p(lending()))
    return library


def _build(command: list[str], source: Path, target: Path) -> None:
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        done = subprocess.run([*command, "-o", str(made)], capture_output=True, text=True, timeout=SECONDS, check=False)
        if done.returncode != 0:
            lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
            raise ValueError(f"{source}: the compiler {command[0]} refuses it: {' | '.join(lines[:3])[:600]}")
        os.replace(made, target)


def _compiler() -> list[str]:
    given = os.environ.get("CXX")
    if given:
        return shlex.split(given)
    found = next((name for name in COMPILERS if shutil.which(name)), None)
    if found is None:
        raise RuntimeError("no C++ compiler is installed (c++, g++ or clang++); install one, or name it by CXX=")
    return [found]


def _cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "coadjoint"
