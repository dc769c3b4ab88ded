"""How the kernels are compiled, as `source/options.json` says it to the build of the package and to everyone else."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).parent / "source"


def _said(source: Path) -> Any:
    return json.loads((source / "options.json").read_text(encoding="utf-8"))


def levels(source: Path = SOURCE) -> tuple[int, ...]:
    """Return the levels of the x86-64 instructions that the kernels can be built for, the highest first.

    Parameters
    ----------
    source : Path
        The folder of the C++ sources; those of this package by default.

    Returns
    -------
    tuple of int
    """
    return tuple(sorted((int(name.removeprefix("v")) for name in _said(source)["levels"]), reverse=True))


def tuning(level: int | None, source: Path = SOURCE) -> list[str]:
    """Return what the compiler is told for one of the levels alone.

    Parameters
    ----------
    level : int or None
        Of `levels`; None where the processor is no x86-64.
    source : Path
        The folder of the C++ sources; those of this package by default.

    Returns
    -------
    list of str
    """
    said = _said(source)
    return list(said["elsewhere"] if level is None else said["levels"][f"v{level}"])


def options(own: Sequence[str], source: Path = SOURCE) -> list[str]:
    """Return how a source is compiled for a library.

    Parameters
    ----------
    own : sequence of str
        The `tuning` of a level, or what takes its place.
    source : Path
        The folder of the C++ sources; those of this package by default.

    Returns
    -------
    list of str
    """
    return [*_said(source)["always"], *own, "-DNDEBUG", "-fPIC", f"-I{source}"]
