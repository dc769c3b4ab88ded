"""Memory of a run with an archive, measured: the same, however many steps it takes and points it keeps."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import coadjoint

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
RUN = """
import resource, sys
import coadjoint as co
steps, path = int(sys.argv[1]), sys.argv[2]
body = co.systems.rigid_body(inertia=(1, 2, 2.5))
co.integrate(body, (1.0, 0.2, 0.1), (0, steps / 64), 1 / 64, co.Splitting(order=2), save_every=8, archive=path)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
CHUNK = 65536 * 8 * 6
"""The bytes of a chunk of all arrays: time, three components, energy and Casimir."""


def peak(steps, path):
    """Return the largest resident memory of a run in a process of its own, in bytes."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(steps), str(path)], capture_output=True, text=True, env=ENVIRONMENT, check=True
    )
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="the largest memory of a process is asked for by getrusage")
def test_memory_is_flat(tmp_path):
    """Ten times the steps, from where a first chunk is full, take less than one chunk more; the points take ten."""
    short, long = (peak(steps, tmp_path / f"{steps}.zarr") for steps in (10**6, 10**7))
    assert long - short < CHUNK < 10**7 // 8 * 8 * 6 / 10
