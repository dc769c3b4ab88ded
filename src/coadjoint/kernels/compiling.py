"""Compiler options of the kernels, read from `source/options.json`, which the build of the package also uses."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).parent / "source"


def _read_options(source: Path) -> Any:
    return json.loads((source / "options.json").read_text(encoding="utf-8"))


def levels(source: Path = SOURCE) -> tuple[int, ...]:
    """Return the x86-64 levels that the kernels can be built for, highest first; `source` is the folder of the C++."""
    return tuple(sorted((int(name.removeprefix("v")) for name in _read_options(source)["levels"]), reverse=True))


def tuning(level: int | None, source: Path = SOURCE) -> list[str]:
    """Return the compiler options of one of `levels`; None is a processor that is not x86-64."""
    option_lists = _read_options(source)
    return list(option_lists["elsewhere"] if level is None else option_lists["levels"][f"v{level}"])


def options(tuned: Sequence[str], source: Path = SOURCE) -> list[str]:
    """Return all compiler options for a source file; `tuned` are the options of `tuning`, or a replacement for them."""
    # All code of Windows can be moved; Clang refuses the option there.
    movable = [] if sys.platform == "win32" else ["-fPIC"]
    return [*_read_options(source)["always"], *tuned, "-DNDEBUG", *movable, f"-I{source}"]
