"""Random ensembles on several threads, for a thread sanitizer: `python -m random_runs.on_threads FIRST COUNT`.

Each runs on four threads of its own, and in three Python threads that share a prepared run unless it is slow.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time

import coadjoint as co

from .cases import REFUSALS, case_of
from .comparisons import SLOW, differing, prepared_by, run


def differences(seed: int) -> list[str]:
    """Return the names of arrays that differ between threads."""
    case, _ = case_of(seed)
    begun = time.monotonic()
    try:
        alone = run(case)
    except REFUSALS:
        return []
    slow = time.monotonic() - begun > SLOW
    found = differing(alone, run(case, threads=4))
    if slow:
        return found
    ready = co.prepare(
        co.batch(list(case.systems)) if case.batch else case.systems[0],
        case.method,
        case.step,
        attitude=case.attitude,
        watch=case.watch,
        threads=2,
    )

    def follow() -> None:
        found.extend(differing(alone, prepared_by(ready, case)))

    workers = [threading.Thread(target=follow) for _ in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int, help="how many seeds")
    arguments = parser.parse_args()
    wrong = 0
    for seed in range(arguments.first, arguments.first + arguments.count):
        names = differences(seed)
        wrong += bool(names)
        if names:
            print(f"seed {seed}: {', '.join(sorted(set(names)))} differ\n    {case_of(seed)[0]}", flush=True)
    print(f"{arguments.count} seeds on threads, {wrong} wrong", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
