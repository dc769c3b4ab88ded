"""Kill runs that write archives at random times: `python public/archives/killed_runs.py FIRST KILLS`, in `tests`.

Each seed is a run that is killed and resumed several times, and compared with an uninterrupted one.
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
from typing import Any

import numpy as np
import xarray

import coadjoint as co

STEP, STEPS = 0.05, 12000
KILLS, LONGEST = 4, 0.6
"""Kills per run, and the longest time (s) before one."""
TOP = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0]))
X = np.array([1.0, -0.5, 1.5, 0.625, 0.25, 0.75])
RUNS: tuple[tuple[Any, Any, Any, Any, Any], ...] = (
    (TOP, X, co.GaussLegendre(2), "coadjoint", None),
    (TOP, np.multiply.outer(1.0 - 0.05 * np.arange(5), X), co.Splitting(order=4), False,
     [co.Event(0, terminal=True, count=105), co.Event(4, direction=1)]),
    (co.systems.rigid_body(inertia=(1, 2, 3)), X[:3], co.Taylor(10, tolerance=1e-9), True, co.Event(2)),
)  # fmt: skip


def fork_worker(work: Callable[[], object]) -> int:
    """Fork a process that does some work; return its id."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        work()
        status = 0
    finally:
        os._exit(status)


def check_archive_prefix(path: Path, expected: co.Solution) -> int:
    """Compare an archive, read by xarray, with the beginning of a run; return its number of points."""
    with xarray.open_zarr(path, chunks=None) as found:
        count = found.sizes["time"]
        for name, values in (("time", expected.t), ("x", expected.x), ("energy", expected.energy)):
            assert np.array_equal(found[name].values, values[:count], equal_nan=True), f"{name} of {path}"
        return count


def killed(seed: int, folder: Path) -> int:
    """Kill a run several times and compare its final result; return the number of kills that interrupted it."""
    rng = np.random.default_rng(seed)
    system, x0, method, attitude, events = RUNS[seed % len(RUNS)]
    end, path, hits = STEPS * STEP, folder / f"run{seed}.zarr", 0
    expected = co.integrate(system, x0, (0.0, end), STEP, method, attitude=attitude, events=events)

    def work() -> object:
        """Write the archive of a short run, whose chunks are small, and resume it to the end of a long one."""
        if not path.exists():
            short = (0.0, 2 * STEP)
            co.integrate(system, x0, short, STEP, method, attitude=attitude, events=events, archive=path)
        return co.resume(path, end)

    for _ in range(KILLS):
        child = fork_worker(work)
        time.sleep(rng.uniform(0.0, LONGEST))
        os.kill(child, signal.SIGKILL)
        hits += os.WIFSIGNALED(os.waitpid(child, 0)[1])
        if path.exists() and co.open_archive(path).reached > 2:
            check_archive_prefix(path, expected)
    work()
    found = co.resume(path)
    assert check_archive_prefix(path, expected) == len(expected.t)
    assert found.finished and np.array_equal(found.x, expected.x, equal_nan=True)
    for name in ("t", "x", "which", "member") if events else ():
        assert np.array_equal(getattr(found.events, name), getattr(expected.events, name)), name
    assert not attitude or np.array_equal(found.attitude, expected.attitude)
    assert all(np.array_equal(own.tenths, expected.drift()[name].tenths) for name, own in found.drift().items())
    assert os.listdir(path.parent) == [path.name]
    return hits


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("kills", type=int, help="the least number of kills of a running process")
    options, hits, runs = parser.parse_args(), 0, 0
    while hits < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            hits += killed(options.first + runs, Path(folder))
        runs += 1
    print(f"{runs} runs were killed {hits} times; all have the bits of uninterrupted runs")
    return 0


if __name__ == "__main__":
    sys.exit(main())
