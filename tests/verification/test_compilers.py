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

from .test_levels import digests, usable_levels

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


@pytest.mark.skipif(not clang(), reason="there is no Clang on this machine")
@pytest.mark.skipif((processor_level() or 0) < 3, reason="the processor has no AVX2")
def test_clang_gives_the_same_bits(tmp_path):
    """At the least optimisation that puts small functions into each other: that is the quickest to build."""
    zig = "ziglang" in clang()
    tuning = ["-O1", "-mcpu=x86_64_v3" if zig else "-march=x86-64-v3", "-Wno-unknown-warning-option", FEW_WRITTEN_OUT]
    assert digests_of_build(tmp_path, clang(), 3, tuning) == digests(None)


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no GCC on this machine")
@pytest.mark.skipif(processor_level() is None, reason="only x86-64 has levels")
@pytest.mark.skipif("v1" in usable_levels(), reason="the lowest level is built with the package")
def test_without_fused_products_in_hardware_the_same_bits(tmp_path):
    tuning = [*compiling.tuning(1), FEW_WRITTEN_OUT]
    assert digests_of_build(tmp_path, ["g++"], 1, tuning) == digests(None)
