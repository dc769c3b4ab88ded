"""From the start of a process to its first result, with a warm and (--cold) with an empty cache of compiled loops.

python benchmarks/first_result.py [--rounds R] [--cold]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time

FIRST_RESULT = """
import coadjoint as co
body = co.systems.rigid_body(inertia=(1, 2, 3))
sol = co.integrate(body, (1.0, 0.1, 0.5), t_span=(0, 100), step=0.1, method=co.Splitting(order=2))
print(sol.x[-1])
"""
HEAVY = ("scipy", "numba", "llvmlite", "xarray", "pandas", "matplotlib", "pydantic", "zarr", "h5netcdf", "dask", "tqdm")
IMPORT = f"import sys, coadjoint; print(*[name for name in {HEAVY!r} if name in sys.modules])"


def seconds(script: str, cache: str | None = None) -> tuple[float, str]:
    """Run a script in a fresh process; return its wall time and what it prints."""
    environment = dict(os.environ) if cache is None else {**os.environ, "NUMBA_CACHE_DIR": cache}
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment)
    return time.perf_counter() - begun, done.stdout


def measure(rounds: int, cold: bool) -> list[tuple[str, float]]:
    """Return what was timed with its seconds: the least of the rounds, a cold start once."""
    loaded = seconds(IMPORT)[1].split()
    if loaded:
        raise SystemExit(f"import coadjoint loads {', '.join(loaded)}; it should load NumPy and nothing heavy")
    found = [("bare Python and NumPy", min(seconds("import numpy")[0] for _ in range(rounds)))]
    found.append(("import coadjoint", min(seconds(IMPORT)[0] for _ in range(rounds))))
    with tempfile.TemporaryDirectory() as cache:
        first = seconds(FIRST_RESULT, cache)[0]
        found.append(("first result, warm cache", min(seconds(FIRST_RESULT, cache)[0] for _ in range(rounds))))
    if cold:
        found.append(("first result, empty cache", first))
    return found


def table(rows: list[tuple[str, float]]) -> str:
    lines = ["| fresh process: rigid body, 1000 steps, printed | seconds |", "|---|---|"]
    return "\n".join(lines + [f"| {title} | {value:.2f} |" for title, value in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description="seconds from the start of a process to its first result")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cold", action="store_true", help="report the start with an empty cache as well")
    given = parser.parse_args()
    print(table(measure(given.rounds, given.cold)))


if __name__ == "__main__":
    main()
