"""Repeat the tests marked `sensitive` and digests of runs under settings of other machines: `python variants.py`.

Variants set the BLAS kernels, vector instructions of NumPy and the C library, the level of the kernels, or the share of
the processor. Those that do not apply are named and skipped. Independent variants run together, and one by one after a
failure.
"""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_info

from coadjoint.kernels.library import built_levels, processor_level

ROOT = Path(__file__).parents[1]
# The least level of the processor that each kernel of OpenBLAS needs.
CORES = {"Haswell": 3, "SkylakeX": 4, "Prescott": 1}
LEVELS = (1, 3)
HWCAPS = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"
# Kernels of v1 call `fma` of the C library, which takes twenty times as long without the instruction.
APART = {"GLIBC_TUNABLES", "COADJOINT_LEVEL"}
PERIOD, SHARE = 0.1, 0.2
"""Period (s) and share of it in which the processes run."""
# Tests that wait for other processes run under a quota, and only there: other tests do not depend on the quota, and
# these do not depend on instructions.
WAITING = {"test_interrupted_imports.py", "test_interrupted_preparation.py", "test_interrupted_commands.py"}


class Variant(NamedTuple):
    """A setting of the environment; `lacks` names a missing requirement."""

    name: str
    setting: dict[str, str]
    lacks: str = ""
    quota: bool = False


def variants() -> Iterator[Variant]:
    level = processor_level() or 0
    openblas = any(found["internal_api"] == "openblas" for found in threadpool_info())
    for core, least in CORES.items():
        lacks = "" if openblas and level >= least else f"OpenBLAS on an x86-64 processor of level v{least}"
        yield Variant(f"OPENBLAS_CORETYPE={core}", {"OPENBLAS_CORETYPE": core}, lacks)
    # Names depend on the version of NumPy, which refuses unknown ones.
    features = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    setting = {"NPY_DISABLE_CPU_FEATURES": " ".join(features)}
    yield Variant("NumPy without SIMD", setting, "" if features else "a NumPy with runtime dispatch")
    glibc = platform.libc_ver()[0] == "glibc" and platform.machine() == "x86_64"
    yield Variant("glibc without AVX and FMA", {"GLIBC_TUNABLES": HWCAPS}, "" if glibc else "glibc on x86-64")
    for one in LEVELS:
        lacks = "" if one in built_levels() and level >= one else f"kernels built for v{one} (COADJOINT_LEVELS)"
        yield Variant(f"COADJOINT_LEVEL=v{one}", {"COADJOINT_LEVEL": f"v{one}"}, lacks)
    lacks = "" if hasattr(signal, "SIGSTOP") else "signals that stop a process"
    yield Variant(f"{SHARE:.0%} of the processor", {}, lacks, quota=True)


def may_join(one: Variant, other: Variant) -> bool:
    """Return whether two variants set different things, which do not slow each other down."""
    slow = APART <= one.setting.keys() | other.setting.keys()
    return not (slow or one.quota or other.quota or one.setting.keys() & other.setting)


def together(ones: list[Variant]) -> list[list[Variant]]:
    """Group independent variants; one with a quota stays alone."""
    groups: list[list[Variant]] = []
    for one in ones:
        fitting = (group for group in groups if all(may_join(one, other) for other in group))
        if group := next(fitting, None):
            group.append(one)
        else:
            groups.append([one])
    return groups


def joined(group: list[Variant]) -> Variant:
    """Return the combined variant of a group."""
    setting = {name: value for one in group for name, value in one.setting.items()}
    return Variant(", ".join(one.name for one in group), setting, quota=group[0].quota)


def passed(variant: Variant) -> bool:
    """Run the sensitive tests under a setting."""
    # Only these files: collecting all tests takes longer than running these.
    paths = [path for path in (ROOT / "tests").rglob("test_*.py") if "mark.sensitive" in path.read_text("utf-8")]
    chosen = sorted(str(path) for path in paths if (path.name in WAITING) == variant.quota)
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-m", "sensitive and not long", *chosen]
    # A process group can be stopped at once; Linux gives a session a share of its own.
    with subprocess.Popen(command, cwd=ROOT, env=os.environ | variant.setting, process_group=0) as tests:
        try:
            while variant.quota and tests.poll() is None:
                time.sleep(PERIOD * SHARE)
                os.killpg(tests.pid, signal.SIGSTOP)
                time.sleep(PERIOD * (1 - SHARE))
                os.killpg(tests.pid, signal.SIGCONT)
            tests.wait()
        except BaseException:
            os.killpg(tests.pid, signal.SIGKILL)
            raise
    return tests.returncode == 0


def digests(setting: dict[str, str]) -> dict[str, str]:
    command = [sys.executable, "-m", "digests.digests_of_runs"]
    done = subprocess.run(command, cwd=ROOT / "tests", env=os.environ | setting, stdout=subprocess.PIPE, check=True)
    found: dict[str, str] = json.loads(done.stdout)
    return found


def wrong_under(variant: Variant, expected: dict[str, str]) -> str:
    """Return the differences under a setting, or an empty string."""
    print(f"{variant.name}:", flush=True)
    began = time.monotonic()
    wrong = "" if passed(variant) else "tests"
    if variant.setting:
        found = digests(variant.setting)
        differing = [name for name, digest in expected.items() if found[name] != digest]
        wrong += f" bits of {', '.join(differing)}" if differing else ""
    print(f"{variant.name}: {time.monotonic() - began:.0f} s", flush=True)
    return wrong


def main() -> int:
    expected, failed, applying = digests({}), [], []
    for variant in variants():
        if variant.lacks:
            print(f"{variant.name}: left out, it needs {variant.lacks}", flush=True)
        else:
            applying.append(variant)
    for group in together(applying):
        reference = joined(group)
        if wrong := wrong_under(reference, expected):
            alone = {one.name: wrong_under(one, expected) for one in group} if len(group) > 1 else {}
            failed += [f"{name}: {wrong}" for name, wrong in {reference.name: wrong, **alone}.items() if wrong]
    print("\n".join(["failed under:", *failed]) if failed else "the same under all of them", flush=True)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
