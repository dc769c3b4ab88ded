"""From the start of a process to its first result, and what a short call costs.

python benchmarks/first_result.py [--rounds R]
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
OWN_FUNCTIONS = """
import math
import coadjoint as co
def well(y): return 0.5 * y * y + 0.1 * math.cos(y)
def slope(y): return y - 0.1 * math.sin(y)
own = co.LiePoissonSystem(co.algebras.so(3), co.Separable({i: (well, slope) for i in range(3)}))
print(co.integrate(own, (1.0, 0.1, 0.5), t_span=(0, 100), step=0.1).x[-1])
"""
SHORT_CALLS = """
import time
import coadjoint as co
ready = co.prepare(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=2), 0.1)
best = 1.0
for _ in range(300):
    begun = time.perf_counter()
    ready.run((1.0, 0.1, 0.5), (0.0, 0.1))
    best = min(best, time.perf_counter() - begun)
print(best)
"""
HEAVY = ("scipy", "numba", "llvmlite", "xarray", "pandas", "matplotlib", "pydantic", "zarr", "h5netcdf", "dask", "tqdm")
IMPORT = f"import sys, coadjoint; print(*[name for name in {HEAVY!r} if name in sys.modules])"


def seconds(script: str, processes: int = 1) -> tuple[float, str]:
    """Run a script in fresh processes, the first without any cache of compiled code; return the wall time of the last
    one and what it prints.
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "XDG_CACHE_HOME": cache}
        for _ in range(processes):
            begun = time.perf_counter()
            done = subprocess.run(
                [sys.executable, "-c", script], check=True, capture_output=True, text=True, env=environment
            )
            passed = time.perf_counter() - begun
        return passed, done.stdout


def measure(rounds: int) -> list[tuple[str, str]]:
    """Return what was timed: the least of the rounds."""
    loaded = seconds(IMPORT)[1].split()
    if loaded:
        raise SystemExit(f"import coadjoint loads {', '.join(loaded)}; it should load NumPy and nothing heavy")
    scripts = {
        "bare Python and NumPy": "import numpy",
        "import coadjoint": IMPORT,
        "first result, splitting": FIRST_RESULT,
        "first result, Gauss-Legendre": FIRST_RESULT.replace("Splitting(order=2)", "GaussLegendre(stages=4)"),
        "first result, energy from Python functions": OWN_FUNCTIONS,
    }
    found = [(title, f"{min(seconds(one)[0] for _ in range(rounds)):.2f} s") for title, one in scripts.items()]
    again = min(seconds(OWN_FUNCTIONS, processes=2)[0] for _ in range(rounds))
    found.append(("the same in a second process, which finds the machine code", f"{again:.2f} s"))
    short = min(float(seconds(SHORT_CALLS)[1]) for _ in range(rounds))
    return [*found, ("a step of a run made ready by `prepare`, with all of the call", f"{1e6 * short:.0f} us")]


def table(rows: list[tuple[str, str]]) -> str:
    lines = ["| fresh process, no cache: rigid body, 1000 steps, printed | time |", "|---|---|"]
    return "\n".join(lines + [f"| {title} | {value} |" for title, value in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description="seconds from the start of a process to its first result")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    print(table(measure(given.rounds)))


if __name__ == "__main__":
    main()
