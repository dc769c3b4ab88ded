"""The C programs: compiled once with gcc, run with their parameters as arguments."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
FLAGS = ("-std=c99", "-O3", "-march=native")


def build(name: str) -> Path:
    """Compile c/NAME.c into build/; without gcc say so and exit with status 2."""
    compiler = shutil.which("gcc")
    if compiler is None:
        print("gcc was not found; install it to compare with C", file=sys.stderr)
        raise SystemExit(2)
    target = HERE / "build" / name
    target.parent.mkdir(exist_ok=True)
    subprocess.run([compiler, *FLAGS, "-o", str(target), str(HERE / "c" / f"{name}.c"), "-lm"], check=True)
    return target


def run(program: Path, arguments: list[str]) -> tuple[float, np.ndarray]:
    """Return the nanoseconds a step and the final state that a program prints."""
    done = subprocess.run([str(program), *arguments], check=True, capture_output=True, text=True)
    nanoseconds, *state = (float(word) for word in done.stdout.split())
    return nanoseconds, np.array(state)
