"""Kills runs that write archives at random moments: `python files/killed_runs.py FIRST KILLS`, in the tests' folder.

Each seed is a run that is killed several times, resumed after each, and compared with one that nobody has touched.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray

import coadjoint as co
from coadjoint.files.archives import archived_run, stored_arrays

STEP, STEPS, EVERY = 0.05, 6000, 5
KILLS, LONGEST = 5, 0.6
"""Kills of a run, and the longest time in seconds before one."""
TOP = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0]))
X = np.array([1.0, -0.5, 1.5, 0.625, 0.25, 0.75])
RUNS = (
    (TOP, X, co.GaussLegendre(2), "coadjoint"),
    (TOP, np.multiply.outer(1.0 - 0.05 * np.arange(5), X), co.Splitting(order=4), False),
    (co.systems.rigid_body(inertia=(1, 2, 3)), X[:3], co.Taylor(10, tolerance=1e-9), True),
)


def in_a_child(work: Callable[[], object]) -> int:
    """Start a process that does some work, and return its number."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        # Many small pieces and chunks, so that most kills come while something is written.
        archived_run.COMMIT_INTERVAL = archived_run.COMMIT_RATIO = 0
        archived_run.ADVANCE_SECONDS, archived_run.FIRST_ADVANCE = 1e-4, 16
        stored_arrays.MIN_CHUNK_ROWS = stored_arrays.MAX_CHUNK_ROWS = 64
        work()
        status = 0
    finally:
        os._exit(status)


def check_what_is_there(path: Path, whole: co.Solution) -> int:
    """Read an archive as a peer does: what it has must be the beginning of the whole run; return how much."""
    with xarray.open_zarr(path, chunks=None) as found:
        count = found.sizes["time"]
        for name, values in (("time", whole.t), ("x", whole.x), ("energy", whole.energy)):
            assert np.array_equal(found[name].values, values[:count]), f"{name} of {path}"
        return count


def killed(seed: int, folder: Path) -> int:
    """Kill a run several times, and compare what comes of it; return how often it was at work when it was killed."""
    rng = np.random.default_rng(seed)
    system, x0, method, attitude = RUNS[seed % len(RUNS)]
    run = system, x0, (0.0, STEPS * STEP), STEP, method
    whole = co.integrate(*run, save_every=EVERY, attitude=attitude)
    path, hits = folder / f"run{seed}.zarr", 0
    for _ in range(KILLS):
        if path.exists():
            child = in_a_child(lambda: co.resume(path))
        else:
            child = in_a_child(lambda: co.integrate(*run, save_every=EVERY, attitude=attitude, archive=path))
        time.sleep(rng.uniform(0.0, LONGEST))
        os.kill(child, signal.SIGKILL)
        hits += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        if path.exists():
            check_what_is_there(path, whole)
    if not path.exists():
        co.integrate(*run, save_every=EVERY, attitude=attitude, archive=path)
    found = co.resume(path)
    assert check_what_is_there(path, whole) == len(whole.t)
    assert found.finished and np.array_equal(found.x, whole.x)
    assert not attitude or np.array_equal(found.attitude, whole.attitude)
    assert all(np.array_equal(own.tenths, whole.drift()[name].tenths) for name, own in found.drift().items())
    assert os.listdir(path.parent) == [path.name]
    return hits


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("kills", type=int, help="how many kills of a process that is at work, at least")
    options, hits, runs = parser.parse_args(), 0, 0
    while hits < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            hits += killed(options.first + runs, Path(folder))
        runs += 1
    print(f"{runs} runs were killed {hits} times, and each came to the bits of one that was left alone")
    return 0


if __name__ == "__main__":
    sys.exit(main())
