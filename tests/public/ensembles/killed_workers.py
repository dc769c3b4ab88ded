"""Kill workers in the middle of their blocks: `python public/ensembles/killed_workers.py FIRST KILLS`, in `tests`.

Each seed is an ensemble on a cluster of its own, whose workers are killed repeatedly during the computation.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from distributed import Client, LocalCluster

import coadjoint as co

STEP, STEPS, EVERY, MEMBERS = 0.125, 3 * 10**6, 10, 8
KILLS, SHORTEST, LONGEST = 3, 0.75, 2.0
"""Kills per run, and the times (s) before each."""


def workers_of(client: Client) -> list[int]:
    """Return the processes of workers, but not of one that is starting."""
    return sorted(pid for pid in client.run(os.getpid, on_error="ignore").values() if isinstance(pid, int))


def kill_some(client: Client, seed: int, stop: threading.Event, killed: list[int]) -> None:
    """Kill workers at random times until the ensemble is finished."""
    rng = np.random.default_rng(seed)
    while len(killed) < KILLS and not stop.wait(rng.uniform(SHORTEST, LONGEST)):
        found = workers_of(client)
        if found:
            pid = int(rng.choice(found))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)


def killed(seed: int, folder: Path) -> int:
    """Kill workers of an ensemble; return the number of kills."""
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    x0 = np.random.default_rng(seed).standard_normal((MEMBERS, 3))
    run = body, x0, (0.0, STEPS * STEP), STEP, co.Splitting(order=2)
    stop, pids = threading.Event(), list[int]()
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        with Client(cluster) as client:
            killer = threading.Thread(target=kill_some, args=(client, seed, stop, pids))
            killer.start()
            try:
                found = co.integrate_ensemble(
                    *run, archive=folder / "many.zarr", client=client, save_every=EVERY, members_per_block=1
                )
            finally:
                stop.set()
                killer.join()
    expected = co.integrate(*run, save_every=EVERY)
    assert found.finished and np.array_equal(found.x, expected.x) and np.array_equal(found.energy, expected.energy)
    assert all(np.array_equal(own.tenths, expected.drift()[name].tenths) for name, own in found.drift().items())
    return len(pids)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("kills", type=int, help="the least number of kills")
    options, hits, runs, began = parser.parse_args(), 0, 0, time.monotonic()
    while hits < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            hits += killed(options.first + runs, Path(folder))
        runs += 1
    seconds = time.monotonic() - began
    print(f"{runs} ensembles lost {hits} workers in {seconds:.0f} s; all have the bits of one machine")
    return 0


if __name__ == "__main__":
    sys.exit(main())
