"""Thousands of drawn runs: `python -m matrix.soak FIRST COUNT`, in the folder `tests`.

Each seed draws a case of the matrix and a wild one: random algebras and Hamiltonians, up to 40 members, some of them
at rest, far away or failing. With `--threads` only runs on several threads, and threads that share a prepared run.
Prints what differs, with lines that repeat it; the exit status is then 1. A seed that exceeds the time limit ends its
process with a traceback.
"""

from __future__ import annotations

import argparse
import faulthandler
import subprocess
import sys
import traceback
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np

import coadjoint as co

from .cases import IMPORTS, REFUSALS, drawn, execute
from .checks import same
from .results import difference
from .running import AGREE, Disagreement, check_drawn
from .schemes import schemes

SECONDS = 120.0  # for all runs of a seed
WILD = """\
from random_runs.cases import case_of
case, _ = case_of({seed})
systems = list(case.systems)
system = co.batch(systems) if case.batch else systems[0]
method, x0, span, h = case.method, case.x0, case.t_span, case.step
options = dict(attitude=case.attitude, save_every=case.save_every, watch=case.watch, threads=1)
options |= dict(events=list(case.events) or None)
def run(what=system, x=x0, **changes):
    return attempted(what, x, span, h, method, **(options | changes))
sol = run()
"""


def wild_checks(space: dict[str, Any], threads: bool) -> Iterator[str]:
    """Yield checks of bits, also of members that fail."""
    count, batch = len(space["x0"]), space["case"].batch
    yield same("numbers(run(threads=4))")
    if threads:
        return
    yield same("numbers(run())")
    rows = "slice(None)"
    plain = "numbers({}, followed=False)"
    yield same(
        f"rows({plain.format('other')}, {rows})",
        f"rows({plain.format('sol')}, {rows})",
        "other = run(watch=not case.watch)\n",
    )
    if space["case"].attitude is not False and not np.any(space["sol"].failed):
        lines = f"other = rows({plain.format('run(attitude=False)')}, {rows})\n"
        yield same("other", f"shared({plain.format('sol')}, other)", lines)
    order = "what = co.batch(systems[::-1])\n" if batch else "what = system\n"
    if count > 1:
        yield same("numbers(run(what, x0[::-1]), 0)", f"numbers(sol, {count - 1})", order)
    for m in sorted({0, count // 2, count - 1}):
        yield same(f"numbers(run({f'systems[{m}]' if batch else 'system'}, x0[{m}]))", f"numbers(sol, {m})")


def check_wild(seed: int, threads: bool = False) -> None:
    """Check the wild case of a seed, unless it is refused."""
    lines = IMPORTS + WILD.format(seed=seed)
    try:
        space = execute(lines)
    except REFUSALS:
        return
    for check in wild_checks(space, threads):
        try:
            execute(check + AGREE, space)
        except Exception as error:
            raise Disagreement(f"{type(error).__name__}: {error}\n\n{lines}{check}{AGREE}") from error
    if threads:
        shared_run(space)


def shared_run(space: dict[str, Any]) -> None:
    """Run in three Python threads that share a prepared run."""
    case = space["case"]
    ready = co.prepare(space["system"], case.method, case.step, attitude=case.attitude, watch=case.watch, threads=2)

    def final(_: int) -> np.ndarray:
        try:
            return ready.run(case.x0, case.t_span, case.save_every).x
        except co.IntegrationError as error:
            return error.partial.x

    with ThreadPoolExecutor(3) as pool:
        first, *others = pool.map(final, range(3))
    assert all(difference(other, first) is None for other in others)


def tried(seeds: range, limit: float, threads: bool) -> int:
    """Try seeds in sequence; return the number of failures."""
    warnings.simplefilter("error")
    warnings.simplefilter("default", co.LongWait)
    for kind in (co.LargeStepWarning, co.RoundingWarning):
        warnings.simplefilter("ignore", kind)
    wrong = 0
    for seed in seeds:
        print(f"seed {seed}", file=sys.stderr, flush=True)
        faulthandler.dump_traceback_later(limit, exit=True)
        try:
            check_wild(seed, threads)
            if not threads:
                check_drawn(drawn(schemes()[seed % len(schemes())], seed, each=1, workers=0.05))
        except Disagreement as found:
            wrong += 1
            print(f"seed {seed}: {found}", flush=True)
        except Exception:
            wrong += 1
            print(f"seed {seed}: {traceback.format_exc()}", flush=True)
        faulthandler.cancel_dump_traceback_later()
    print(f"{len(seeds)} seeds, {wrong} wrong", flush=True)
    return wrong


def main() -> int:
    """Return 0 if no seed failed in any process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int, help="how many seeds")
    parser.add_argument("--limit", type=float, default=SECONDS, help="seconds that a seed may take")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    parser.add_argument("--threads", action="store_true", help="only runs on several threads")
    given = parser.parse_args()
    if given.jobs == 1:
        return int(tried(range(given.first, given.first + given.count), given.limit, given.threads) > 0)
    edges = [given.first + given.count * job // given.jobs for job in range(given.jobs + 1)]
    command = [sys.executable, "-m", "matrix.soak", "--limit", str(given.limit), *["--threads"] * given.threads]
    processes = [subprocess.Popen([*command, str(first), str(last - first)]) for first, last in pairwise(edges)]
    return int(any([process.wait() for process in processes]))


if __name__ == "__main__":
    sys.exit(main())
