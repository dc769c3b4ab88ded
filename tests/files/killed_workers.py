"""Kill workers in the middle of their blocks: `python files/killed_workers.py FIRST KILLS`, in the folder `tests`.

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
from typing import Any

import numpy as np
from distributed import Client, WorkerPlugin

import coadjoint as co
from coadjoint.files.archives import archived_run, block_run, stored_arrays
from coadjoint.files.archives.dask_blocks import local_cluster

STEP, STEPS, EVERY, MEMBERS = 0.125, 3 * 10**6, 2000, 8
ROWS = 64
KILLS, SHORTEST, LONGEST = 3, 0.75, 2.0
"""Kills per run, and the times (s) before each."""


class FrequentCommits(WorkerPlugin):
    """Let workers, also restarted ones, commit each chunk, and record the step from which blocks resume."""

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
    """Kill workers at random times until the ensemble is finished."""
    rng = np.random.default_rng(seed)
    while len(killed) < KILLS and not stop.wait(rng.uniform(SHORTEST, LONGEST)):
        found = sorted(client.run(os.getpid, on_error="ignore").values())
        if found:
            pid = int(rng.choice(found))
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)


def killed(seed: int, folder: Path) -> tuple[int, int]:
    """Kill workers of an ensemble; return the number of kills and of blocks resumed from the middle."""
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    x0 = np.random.default_rng(seed).standard_normal((MEMBERS, 3))
    run = body, x0, (0.0, STEPS * STEP), STEP, co.Splitting(order=2)
    notes, stop, pids = folder / "notes.txt", threading.Event(), list[int]()
    rows = stored_arrays.MIN_CHUNK_ROWS, stored_arrays.MAX_CHUNK_ROWS
    stored_arrays.MIN_CHUNK_ROWS = stored_arrays.MAX_CHUNK_ROWS = ROWS
    try:
        with local_cluster(2) as client:
            client.register_plugin(FrequentCommits(notes))
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
    expected = co.integrate(*run, save_every=EVERY)
    assert found.finished and np.array_equal(found.x, expected.x) and np.array_equal(found.energy, expected.energy)
    assert all(np.array_equal(own.tenths, expected.drift()[name].tenths) for name, own in found.drift().items())
    from_the_middle = [line for line in notes.read_text().splitlines() if line.split()[1] != "0"]
    return len(pids), len(from_the_middle)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("kills", type=int, help="the least number of kills")
    options, hits, blocks, runs, began = parser.parse_args(), 0, 0, 0, time.monotonic()
    while hits < options.kills:
        with tempfile.TemporaryDirectory() as folder:
            kills, resumed = killed(options.first + runs, Path(folder))
        hits, blocks, runs = hits + kills, blocks + resumed, runs + 1
    print(
        f"{runs} ensembles lost {hits} workers in {time.monotonic() - began:.0f} s; {blocks} blocks resumed from the "
        "middle; all ensembles have the bits of one machine"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
