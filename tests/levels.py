"""Compare the bits of runs on emulated x86-64 processors with those of this machine: `python levels.py`.

On each processor the package must choose the highest level that it has. qemu emulates none with AVX-512: the highest
level is that of this machine, if it has it.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coadjoint.kernels.library import FOLDER, SUFFIX, built_levels, level_in_use, levels

TESTS = Path(__file__).parent
QEMU = shutil.which("qemu-x86_64") or shutil.which("qemu-x86_64-static")
PROCESSORS = {"qemu64": 1, "Conroe": 1, "Nehalem": 1, "SandyBridge": 1, "Haswell": 3, "EPYC": 3, "max": 3}
"""The level of each processor of qemu; SandyBridge has AVX, and not AVX2."""
COMPARED = ("Nehalem", "Haswell")
"""Processors on which runs are repeated; NumPy needs more instructions than older ones have."""
BLAS = {1: "Prescott", 3: "Haswell"}
"""Kernels of OpenBLAS for each level: for some emulated processors it chooses instructions that they do not have."""
# Under qemu 7.2, `numpy.unique` by AVX2 ends with a segmentation fault.
NUMPY = " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))
ASKED = f"import ctypes; print(ctypes.CDLL({str(FOLDER / f'_processor{SUFFIX}')!r}).processor_level())"
CHOSEN = "from coadjoint.kernels.library import kernels, level_in_use; kernels(); print(level_in_use())"


def missing() -> str:
    """Return the missing requirement in one sentence, or an empty string."""
    if platform.machine() != "x86_64":
        return "only x86-64 has levels"
    if QEMU is None:
        return "qemu-x86_64 is missing: on Debian, `apt-get install qemu-user-static`"
    if set(built_levels()) != set(levels()):
        return "not all levels are built: `make kernels COADJOINT_LEVELS=all`"
    return ""


def output(arguments: Sequence[str], processor: str = "") -> str:
    """Return the output of Python on an emulated processor, or on this one."""
    emulated = [QEMU, "-cpu", processor] if QEMU and processor else []
    environment = {name: value for name, value in os.environ.items() if name != "COADJOINT_LEVEL"}
    if processor:
        environment |= {"OPENBLAS_CORETYPE": BLAS[PROCESSORS[processor]], "NPY_DISABLE_CPU_FEATURES": NUMPY}
    command = [*emulated, sys.executable, *arguments]
    done = subprocess.run(command, cwd=TESTS, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{done.stderr[-2000:]}\n{' '.join(command[:5])} ... ended with exit status {done.returncode}")
    return done.stdout


def main() -> int:
    if message := missing():
        print(f"levels skipped: {message}")
        return 0
    wrong = []
    for processor, level in PROCESSORS.items():
        found = [output(["-c", code], processor).strip() for code in (ASKED, *[CHOSEN] * (processor in COMPARED))]
        print(f"{processor}: v{found[0]}{', chosen' if found[1:] == found[:1] else ''}", flush=True)
        if set(found) != {str(level)}:
            wrong.append(f"{processor} has the level v{level}, and the package found {found}")
    digests = ["-m", "digests.digests_of_runs"]
    expected = json.loads(output(digests))
    print(f"{len(expected)} runs by v{level_in_use()} on this machine", flush=True)
    for processor in COMPARED:
        began = time.monotonic()
        found = json.loads(output(digests, processor))
        different = sorted(name for name in expected.keys() | found if expected.get(name) != found.get(name))
        took = time.monotonic() - began
        print(f"{len(different)} of them with other bits on {processor}, {took:.0f} s", flush=True)
        wrong += [f"other bits on {processor}: {name}" for name in different]
    print("\n".join(wrong) if wrong else "every level is chosen where it is the highest, with the same bits")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
