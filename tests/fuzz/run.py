"""Fuzzing from the command line: `python -m fuzz.run configurations FIRST COUNT` (or `calls`), in the folder `tests`.

Prints unacceptable outcomes with their seeds; the exit status is then 1. Seeds run in separate processes, so that
crashes and hangs are reported as well.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import signal
import subprocess
import sys
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

TESTS = Path(__file__).parents[1]
SECONDS = 30.0  # of the processor, per call; most take milliseconds, compiled functions seconds
HUNG = 600.0  # seconds until a call counts as hung, however busy the machine
MEMORY = 4 * 2**30  # bytes of address space
BLOCK = 2000


def tried(kind, seeds):
    """Try seeds in this process; print a line of JSON before each, and one for each failure."""
    from .judging import TooLong

    if kind == "configurations":
        from .configured_runs import Runs

        trial = Runs().tried
    else:
        from .calls import tried as trial

    def over(*_):
        raise TooLong

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    signal.signal(signal.SIGPROF, over)
    out, sys.stdout = sys.stdout, open(os.devnull, "w")  # some arguments are functions that print
    for seed in seeds:
        print(json.dumps([seed]), file=out, flush=True)
        faulthandler.dump_traceback_later(HUNG, exit=True)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            found = trial(seed)
        except TooLong:
            found = [f"longer than {SECONDS:g} s of the processor"]
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
        for sentence in found:
            print(json.dumps([seed, sentence]), file=out, flush=True)


def in_processes(kind, seeds):
    """Try seeds in other processes, a new one after each crash; yield seeds and descriptions of failures."""
    first = seeds.start
    while first < seeds.stop:
        command = [sys.executable, "-m", "fuzz.run", kind, str(first), str(seeds.stop - first), "--here"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=TESTS) as process:
            last = None
            for line in process.stdout:
                last, *found = json.loads(line)
                yield from ((last, sentence) for sentence in found)
            message = process.stderr.read()
        if process.returncode == 0:
            return
        lines = [line.strip() for line in message.splitlines() if "coadjoint" in line and "File" in line]
        yield last, f"ended by {process.returncode}: {lines[0] if lines else message[-300:]}"
        if last is None:
            return
        first = last + 1


def fuzz(kind, first, count, jobs):
    """Try seeds in several processes; print failures and return their number for each seed."""
    wrong = Counter()

    def one(start):
        for seed, sentence in in_processes(kind, range(start, min(start + BLOCK, first + count))):
            wrong[seed] += 1
            print(f"{kind} {seed}: {sentence}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(one, range(first, first + count, BLOCK)))
    print(f"{count} {kind}, {len(wrong)} wrong", flush=True)
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", choices=("configurations", "calls"))
    parser.add_argument("first", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--here", action="store_true", help="in this process")
    arguments = parser.parse_args()
    if arguments.here:
        warnings.simplefilter("ignore")
        tried(arguments.kind, range(arguments.first, arguments.first + arguments.count))
        return 0
    return bool(fuzz(arguments.kind, arguments.first, arguments.count, arguments.jobs))


if __name__ == "__main__":
    sys.exit(main())
