"""Random runs by the thousand: `python -m random_runs.soak FIRST COUNT`, in the folder of the tests.

Prints what changes bits, and exits with status 1 where anything does. A seed that takes longer than the limit ends the
process, with the place where it was.
"""

from __future__ import annotations

import argparse
import faulthandler
import sys
import traceback
import warnings

from .cases import case_of
from .comparisons import differences

SECONDS = 120.0  # for all runs of a seed: some take a splitting of forty members to pieces


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int, help="how many seeds")
    parser.add_argument("--limit", type=float, default=SECONDS, help="seconds that a seed may take")
    given = parser.parse_args()
    warnings.simplefilter("error")
    wrong = 0
    for seed in range(given.first, given.first + given.count):
        print(f"seed {seed}", file=sys.stderr, flush=True)
        faulthandler.dump_traceback_later(given.limit, exit=True)
        try:
            found = list(differences(seed))
        except Exception:
            found = [traceback.format_exc()]
        faulthandler.cancel_dump_traceback_later()
        wrong += bool(found)
        for sentence in found:
            print(f"seed {seed}: {sentence}\n    {case_of(seed)[0]}", flush=True)
    print(f"{given.count} seeds, {wrong} wrong", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
