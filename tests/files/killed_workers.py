"""Kills workers in the middle of their blocks: `python files/killed_workers.py FIRST KILLS`, in the tests' folder.

Each seed is an ensemble on a cluster of its own, of which some worker is killed again and again while it computes.
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
from typing import Any

import numpy as np
from distributed import Client, WorkerPlugin

import coadjoint as co
from coadjoint.files.archives import archived_run, block_run, stored_arrays
from coadjoint.files.archives.local_cluster import local_cluster

STEP, STEPS, EVERY, MEMBERS = 0.125, 3 * 10**6, 2000, 8
ROWS = 64
KILLS, SHORTEST, LONGEST = 3, 0.75, 2.0
"""Kills of workers in a run, and the times in seconds before each."""


class Often(WorkerPlugin):
    """Let a worker commit each of its chunks, also one that is started later, and note from where blocks go on."""

    def __init__(self, notes: Path) -> None:
        self.notes = notes

    def setup(self, worker: Any) -> None:
        archived_run.ADVANCE_SECONDS = 0.01
        original, notes = block_run.BlockRun.__init__, self.notes

        def noted(run: Any, store: Any, ready: Any, times: Any, block: Any) -> None:
            original(run, store, ready, times, block)
            with open(notes, "a") as file:
                file.write(f"{block.number} {run.run.number}\n")

        block_run.BlockRun.__init__ = noted


def kill_some(client: Client, seed: int, stop: threading.Event, killed: list[int]) -> None:
    """Kill workers at random times, until nobody needs them any more."""
    rng = np.random.default_rng(seed)
    while len(killed) < KILLS and not stop.wait(rng.uniform(SHORTEST, LONGEST)):
        found = sorted(client.run(os.getpid, on_error="ignore").values())
        if found:
            pid = int(rng.choice(found))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)


def killed(seed: int, folder: Path) -> tuple[int, int]:
    """Kill workers of an ensemble; return how many, and how many blocks have gone on from the middle."""
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    x0 = np.random.default_rng(seed).standard_normal((MEMBERS, 3))
    run = body, x0, (0.0, STEPS * STEP), STEP, co.Splitting(order=2)
    notes, stop, pids = folder / "notes.txt", threading.Event(), list[int]()
    rows = stored_arrays.MIN_CHUNK_ROWS, stored_arrays.MAX_CHUNK_ROWS
    stored_arrays.MIN_CHUNK_ROWS = stored_arrays.MAX_CHUNK_ROWS = ROWS
    try:
        with local_cluster(2) as client:
            client.register_plugin(Often(notes))
            killer = threading.Thread(target=kill_some, args=(client, seed, stop, pids))
            killer.start()
            try:
                found = co.ensemble(
                    *run, archive=folder / "many.zarr", client=client, save_every=EVERY, members_per_block=1
                )
            finally:
                stop.set()
                killer.join()
    finally:
        stored_arrays.MIN_CHUNK_ROWS, stored_arrays.MAX_CHUNK_ROWS = rows
    whole = co.integrate(*run, save_every=EVERY)
    assert found.finished and np.array_equal(found.x, whole.x) and np.array_equal(found.energy, whole.energy)
    assert all(np.array_equal(own.tenths, whole.drift()[name].tenths) for name, own in found.drift().items())
    from_the_middle = [line for line in notes.read_text().splitlines() if line.split()[1] != "0"]
    return len(pids), len(from_the_middle)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("kills", type=int, help="how many kills, at least")
    options, hits, blocks, runs, began = parser.parse_args(), 0, 0, 0, time.monotonic()
    while hits < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            kills, resumed = killed(options.first + runs, Path(folder))
        hits, blocks, runs = hits + kills, blocks + resumed, runs + 1
    print(
        f"{runs} ensembles lost {hits} workers in {time.monotonic() - began:.0f} s; {blocks} blocks went on from the "
        "middle, and each ensemble came to the bits of one machine"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
