"""Thousands of random runs: `python -m random_runs.soak FIRST COUNT`, in the folder `tests`.

Prints differences of bits; the exit status is then 1. A seed that exceeds the time limit ends its process with a
traceback.
"""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import traceback
import warnings
from itertools import pairwise

from coadjoint import LargeStepWarning, LongWait

from .cases import case_of
from .comparisons import differences

SECONDS = 120.0  # for all runs of a seed


def tried(seeds: range, limit: float) -> int:
    """Try seeds in sequence; return the number of failures."""
    warnings.simplefilter("error")
    warnings.simplefilter("default", LongWait)
    warnings.simplefilter("ignore", LargeStepWarning)
    wrong = 0
    for seed in seeds:
        print(f"seed {seed}", file=sys.stderr, flush=True)
        faulthandler.dump_traceback_later(limit, exit=True)
        try:
            found = list(differences(seed))
        except Exception:
            found = [traceback.format_exc()]
        faulthandler.cancel_dump_traceback_later()
        wrong += bool(found)
        for sentence in found:
            print(f"seed {seed}: {sentence}\n    {shown(seed)}", flush=True)
    print(f"{len(seeds)} seeds, {wrong} wrong", flush=True)
    return wrong


def shown(seed: int) -> str:
    """Return the case of a seed as text, also if drawing it fails."""
    try:
        return str(case_of(seed)[0])
    except Exception as error:
        return f"its case cannot be drawn: {error}"


def main() -> int:
    """Return 0 if no seed failed in any process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int, help="how many seeds")
    parser.add_argument("--limit", type=float, default=SECONDS, help="seconds that a seed may take")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.count)
    if arguments.jobs == 1:
        return int(tried(seeds, arguments.limit) > 0)
    edges = [arguments.first + arguments.count * job // arguments.jobs for job in range(arguments.jobs + 1)]
    command = [sys.executable, "-m", "random_runs.soak", "--limit", str(arguments.limit)]
    processes = [subprocess.Popen([*command, str(first), str(last - first)]) for first, last in pairwise(edges)]
    return int(any([process.wait() for process in processes]))


if __name__ == "__main__":
    sys.exit(main())
