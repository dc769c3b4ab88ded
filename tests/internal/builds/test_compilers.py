"""The bits of runs do not depend on vector instructions, fused products, the compiler or its optimisation."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import coadjoint
from building import Kernels
from coadjoint.kernels.library import built_levels, level_options, processor_level

ROOT = Path(__file__).parents[3]
# Unrolling fewer orders of series is quicker to build, and must not change bits either.
FEW_UNROLLED = "-DCOADJOINT_UNROLLED=2"


def usable_levels() -> list[str]:
    """Return the levels that are built and supported by this processor, highest first."""
    highest = processor_level()
    return [f"v{level}" for level in built_levels() if highest is not None and level <= highest]


@cache
def digests(level: str | None) -> dict[str, str]:
    """Return the digests of the runs of a process with this level."""
    environment = {name: value for name, value in os.environ.items() if name != "COADJOINT_LEVEL"}
    environment["PYTHONPATH"] = str(Path(coadjoint.__file__).parents[1])
    if level is not None:
        environment["COADJOINT_LEVEL"] = level
    command = [sys.executable, "-m", "digests.digests_of_runs"]
    folder = ROOT / "tests"
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.mark.long  # `make variants` compares levels too
@pytest.mark.parametrize("level", [None, *usable_levels()[1:]])
def test_levels_give_the_same_bits(level):
    """Also twice the same level, in two processes: the bits contain nothing of a process, such as an address."""
    expected = digests(next(iter(usable_levels()), None)) if level else digests.__wrapped__(None)
    found = digests(level)
    assert len(found) > 90
    assert {name for name in expected if expected[name] != found[name]} == set()
    assert len(set(found.values())) == len(found)


def clang() -> list[str]:
    """Return the command of Clang, also of the package ziglang; empty if there is none."""
    if found := shutil.which("clang++"):
        return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "c++", "-fno-sanitize=undefined"]
    return []


def digests_of_build(tree: Path, compiler: list[str], level: int, tuning: list[str]) -> dict[str, str]:
    """Return the digests of runs of kernels built in a copy of the sources."""
    for folder in ("src", "tests"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=shutil.ignore_patterns("__pycache__"))
    assert Kernels(tree, compiler, level=level, tuning=tuning).build() == ""
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "COADJOINT_LEVEL": f"v{level}"}
    command = [sys.executable, "-m", "digests.digests_of_runs"]
    done = subprocess.run(
        command, cwd=tree / "tests", env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


def builds() -> list[tuple[str, int]]:
    """Return the builds to test, by compiler and level: the one farthest from the package's own, or all."""
    highest = processor_level()
    if highest is None:
        return []
    names = [name for name, there in (("clang", clang()), ("gcc", shutil.which("g++"))) if there]
    every = [(name, level) for level in (1, 3) if level <= highest for name in names]
    return every if os.environ.get("COADJOINT_COMPILERS") == "all" else every[:1]


@pytest.mark.long
@pytest.mark.skipif(not builds(), reason="there is no compiler here, or the processor has no levels")
@pytest.mark.parametrize(("name", "level"), builds())
def test_compilers_give_the_same_bits(name, level, tmp_path):
    """With the least optimisation that inlines, which is the quickest to build."""
    compiler = clang() if name == "clang" else ["g++"]
    tuning = ["-O1", *processor(level, "ziglang" in compiler), FEW_UNROLLED]
    tuning += ["-Wno-unknown-warning-option"] if name == "clang" else []
    assert digests_of_build(tmp_path, compiler, level, tuning) == digests(None)


def processor(level: int, zig: bool) -> list[str]:
    """Return the option for a level, for zig's Clang or for other compilers."""
    name = "x86_64" if level == 1 else f"x86_64_v{level}"
    return [f"-mcpu={name}"] if zig else [option for option in level_options(level) if option.startswith("-march")]
