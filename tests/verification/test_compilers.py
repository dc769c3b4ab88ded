"""The bits of a run do not depend on the compiler, nor on how much it optimises."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from building import Kernels
from coadjoint.kernels import compiling
from coadjoint.kernels.library import processor_level

from .test_levels import digests

ROOT = Path(__file__).parents[2]
# Fewer orders of series are written out: that is quicker to build, and must not be seen either.
FEW_WRITTEN_OUT = "-DCOADJOINT_UNROLLED=2"


def clang() -> list[str]:
    """Return the command of Clang, which the package ziglang brings too; nothing where there is none."""
    if found := shutil.which("clang++"):
        return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "c++", "-fno-sanitize=undefined"]
    return []


def digests_of_build(tree: Path, compiler: list[str], level: int, tuning: list[str]) -> dict[str, str]:
    """Return the digests of the runs that kernels make which are built in another way, in a copy of the sources."""
    for folder in ("src", "tests"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=shutil.ignore_patterns("__pycache__"))
    assert Kernels(tree, compiler, level=level, tuning=tuning).build() == ""
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "COADJOINT_LEVEL": f"v{level}"}
    command = [sys.executable, "-m", "verification.digests_of_runs"]
    done = subprocess.run(
        command, cwd=tree / "tests", env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


def builds() -> list[tuple[str, int]]:
    """Return the builds to try, by compiler and level: the one farthest from the package's own, or every one."""
    highest = processor_level()
    if highest is None:
        return []
    names = [name for name, there in (("clang", clang()), ("gcc", shutil.which("g++"))) if there]
    every = [(name, level) for level in (1, 3) if level <= highest for name in names]
    return every if os.environ.get("COADJOINT_COMPILERS") == "all" else every[:1]


@pytest.mark.long
@pytest.mark.skipif(not builds(), reason="there is no compiler here, or the processor has no levels")
@pytest.mark.parametrize(("name", "level"), builds())
def test_another_compiler_gives_the_same_bits(name, level, tmp_path):
    """At the least optimisation that puts small functions into each other: that is the quickest to build."""
    compiler = clang() if name == "clang" else ["g++"]
    tuning = ["-O1", *processor(level, "ziglang" in compiler), FEW_WRITTEN_OUT]
    tuning += ["-Wno-unknown-warning-option"] if name == "clang" else []
    assert digests_of_build(tmp_path, compiler, level, tuning) == digests(None)


def processor(level: int, zig: bool) -> list[str]:
    """Return the option for a level, as zig's Clang calls it or as all others do."""
    name = "x86_64" if level == 1 else f"x86_64_v{level}"
    return [f"-mcpu={name}"] if zig else [option for option in compiling.tuning(level) if option.startswith("-march")]
