"""Time and memory of large algebras: building them, their generic rank, and the Casimirs of small ones and of many.

python benchmarks/large_algebras.py [--limit SECONDS]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from typing import NamedTuple

ALGEBRAS = {
    "so(60)": "so(60)",
    "10^5 copies of so(3)": "copies(so(3), 100_000)",
    "su(12)": "su(12)",
    "sp(20)": "sp(20)",
    "so(20)": "so(20)",
    "100 copies of so(3)": "copies(so(3), 100)",
}
BUILT = ("so(60)", "10^5 copies of so(3)", "su(12)", "sp(20)")
RANKED = ("so(20)", "so(60)", "10^5 copies of so(3)")
WITH_CASIMIRS = ("so(4)", "e(3)", "su(3)", "sl(3)", "so(5)", "sp(4)", "so(6)", "su(4)", "100 copies of so(3)")

LIMIT = 120.0

# Each in a process of its own: the peak of a process never falls again.
SCRIPT = """
import resource, time
from coadjoint.algebra.catalogue import copies, e, sl, so, sp, su
{before}
begun = time.perf_counter()
result = {timed}
print(time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, {shown})
"""


class Row(NamedTuple):
    """Seconds of the call, peak of the whole process in MB, and what came out."""

    what: str
    algebra: str
    seconds: float
    memory: float
    result: str


def alone(what: str, algebra: str, before: str, timed: str, shown: str, limit: float) -> Row:
    """Run one call in a fresh process, which is stopped after `limit` seconds."""
    script = SCRIPT.format(before=before, timed=timed, shown=shown)
    try:
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return Row(what, algebra, float("nan"), float("nan"), f"stopped after {limit:.0f} s")
    seconds, memory, result = done.stdout.strip().split(" ", 2)
    return Row(what, algebra, float(seconds), float(memory), result)


def measure(limit: float = LIMIT) -> list[Row]:
    rows = [alone("nothing, the imports alone", "", "", "None", "'-'", limit)]
    for name in BUILT:
        shown = "f'dimension {result.dim}, {result.triples.c.size} constants'"
        rows.append(alone("building", name, "", ALGEBRAS[name], shown, limit))
    for name in RANKED:
        rows.append(
            alone("generic_rank()", name, f"g = {ALGEBRAS[name]}", "g.generic_rank()", "f'{result} of {g.dim}'", limit)
        )
    for name in WITH_CASIMIRS:
        degrees = "len(result), 'of degree', *sorted({c.degree for c in result.values()})"
        before = f"g = {ALGEBRAS.get(name, name)}"
        rows.append(alone("casimirs(max_degree=4)", name, before, "g.casimirs(max_degree=4)", degrees, limit))
    return rows


def table(rows: list[Row]) -> str:
    lines = ["| fresh process | algebra | seconds | peak, MB | result |", "|---|---|---|---|---|"]
    lines += [f"| {row.what} | {row.algebra} | {row.seconds:.3f} | {row.memory:.0f} | {row.result} |" for row in rows]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="seconds and memory of large algebras")
    parser.add_argument("--limit", type=float, default=LIMIT, help="seconds after which a process is stopped")
    print(table(measure(parser.parse_args().limit)))


if __name__ == "__main__":
    main()
