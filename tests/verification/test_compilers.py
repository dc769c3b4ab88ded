"""The bits of a run do not depend on the compiler, nor on how much it optimises."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mutants.building import Kernels

from .test_levels import digests, usable_levels

ROOT = Path(__file__).parents[2]


def clang() -> list[str]:
    """Return the command of Clang, which the package ziglang brings too; nothing where there is none."""
    if found := shutil.which("clang++"):
        return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "c++", "-fno-sanitize=undefined"]
    return []


@pytest.mark.skipif(not clang(), reason="there is no Clang on this machine")
@pytest.mark.skipif("v3" not in usable_levels(), reason="the processor has no AVX2")
def test_clang_gives_the_same_bits(tmp_path):
    """At the least optimisation that puts small functions into each other: that is the quickest to build."""
    for folder in ("src", "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "setup.py", tmp_path)
    zig = "ziglang" in clang()
    tuning = ["-O1", "-mcpu=x86_64_v3" if zig else "-march=x86-64-v3", "-Wno-unknown-warning-option"]
    assert Kernels(tmp_path, clang(), level=3, tuning=tuning).build() == ""
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "src"), "COADJOINT_LEVEL": "v3"}
    command = [sys.executable, "-m", "verification.digests_of_runs"]
    done = subprocess.run(
        command, cwd=tmp_path / "tests", env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == digests(next(iter(usable_levels())))
