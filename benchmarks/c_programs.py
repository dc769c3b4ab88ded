"""The C programs: compiled once with gcc, run with their parameters as arguments."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
FLAGS = ("-std=c99", "-O3", "-march=native")


def compiler() -> str:
    """Return the path of gcc; without it say so and exit with status 2."""
    found = shutil.which("gcc")
    if found is None:
        print("gcc was not found; install it to compare with C", file=sys.stderr)
        raise SystemExit(2)
    return found


def build(name: str, *flags: str, target: str | None = None) -> Path:
    """Compile c/NAME.c into build/NAME, or build/TARGET, with further flags."""
    program = HERE / "build" / (target or name)
    program.parent.mkdir(exist_ok=True)
    source = str(HERE / "c" / f"{name}.c")
    subprocess.run([compiler(), *FLAGS, "-o", str(program), source, *flags, "-lm"], check=True)
    return program


def run(program: Path, arguments: list[str], threads: int = 1) -> tuple[float, np.ndarray]:
    """Return the nanoseconds a step and the final state that a program prints; `threads` if it uses OpenMP."""
    environment = os.environ | {"OMP_NUM_THREADS": str(threads), "OMP_PROC_BIND": "true"}
    done = subprocess.run([str(program), *arguments], check=True, capture_output=True, text=True, env=environment)
    nanoseconds, *state = (float(word) for word in done.stdout.split())
    return nanoseconds, np.array(state)
