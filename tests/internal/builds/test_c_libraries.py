"""The bits of runs do not depend on the C library."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import coadjoint
from long import long_beyond

HERE = Path(__file__).parent
# Paths of glibc and of NumPy for other processors; names that a version does not know are ignored or warned of.
OTHER_PATHS = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
}


def digests(every: int, **environment: str) -> dict[str, str]:
    """Return the digests of a process with these variables."""
    own = {"PYTHONPATH": str(Path(coadjoint.__file__).parents[1]), **environment}
    command = [sys.executable, "-W", "ignore", "-m", "digests.digests_of_systems", str(every)]
    done = subprocess.run(
        command, cwd=HERE.parents[1], env=os.environ | own, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def other_library(tmp_path_factory):
    """Return a library that replaces the elementary functions of the C library."""
    if platform.libc_ver()[0] != "glibc":
        pytest.skip("the C library is not glibc, so that it cannot be replaced")
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler")
    library = tmp_path_factory.mktemp("other") / "other.so"
    command = ["cc", "-O1", "-fno-builtin", "-shared", "-fPIC", str(HERE / "other_c_library.c"), "-o", str(library)]
    subprocess.run([*command, "-ldl", "-lm"], check=True)
    return str(library)


@pytest.mark.long
@pytest.mark.parametrize("every", long_beyond(1, [6, 1]))
def test_runs_do_not_use_functions_of_the_c_library(other_library, every):
    """In the child these have other last bits. Random runs are compared if their inputs are equal."""
    here, there = digests(every), digests(every, **OTHER_PATHS, LD_PRELOAD=other_library)
    assert here.keys() == there.keys()
    others = {name.split()[1] for name in here if name.startswith("given ") and here[name] != there[name]}
    compared = {name for name in here if not name.startswith("given ") and name.removeprefix("seed ") not in others}
    assert len(others) <= 15 and len(compared) > (500 if every == 1 else 30)
    assert {name for name in compared if here[name] != there[name]} == set()


def test_replaced_library_has_other_last_bits(other_library):
    code = "import math; print(math.sin(1.0).hex(), math.exp(2.0).hex(), math.log2(8.0))"
    found = []
    for own in ({}, {"LD_PRELOAD": other_library}):
        command, environment = [sys.executable, "-c", code], os.environ | own
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        found.append(done.stdout.split())
    (sine, growth, three), (other_sine, other_growth, other_three) = found
    assert sine != other_sine and growth != other_growth and three == other_three
