"""CPU time of calls in about 255 dimensions: certificates, Lyapunov exponents, modified fields, preparation.

python benchmarks/large_calls.py [--calls NAME ...] [--limit SECONDS]
"""

from __future__ import annotations

import argparse
import subprocess
import sys

ALGEBRAS = {"su(16)": "su(16)", "so(23)": "so(23)", "85 so(3)": "copies(so(3), 85)", "e(22)": "e(22)"}
ENERGIES = {
    "diagonal": "rng.uniform(0.5, 1.5, n)",
    "full": "np.eye(n) + 0.1 * (half + half.T) / np.sqrt(n)",
}
CALLS = {
    "prepare": "co.prepare(system, co.Splitting(), 0.05).run(x, (0.0, 0.05))",
    "certify, splitting": "co.certify(system, co.Splitting(), x, 0.05)",
    "certify, Gauss": "co.certify(system, co.GaussLegendre(1), x, 0.05)",
    "lyapunov, Gauss, 20 steps": "co.lyapunov(system, x, (0.0, 1.0), 0.05, co.GaussLegendre(1))",
    "lyapunov, Taylor, 5 steps": "co.lyapunov(system, x, (0.0, 0.25), 0.05, co.Taylor(8))",
    "modified_field": "co.modified_field(system, co.GaussLegendre(1), 3, way='numerical')(x, 0.05)",
    "suggest_step": "co.suggest_step(system, co.Splitting(), x, 1e-5)",
}
LIMIT = 100.0

# Each in a process of its own, since preparations are cached; imports and the first compiled calls are not counted.
SCRIPT = """
import time, warnings
import numpy as np
import coadjoint as co
from coadjoint.algebras import copies, e, so, su
warnings.simplefilter("ignore")
body = co.systems.rigid_body(inertia=(1, 2, 3))
co.certify(body, co.Splitting(), (1.0, 0.2, 0.5), 0.05, steps=10)
co.modified_field(body, co.GaussLegendre(1), 3, way="numerical")
rng, algebra = np.random.default_rng(1993), {algebra}
n = algebra.dim
half = rng.standard_normal((n, n))
system = co.LiePoissonSystem(algebra, co.Quadratic({energy}), sign=-1)
x = rng.standard_normal(n)
x /= np.linalg.norm(x)
begun = time.process_time()
try:
    {call}
except ValueError as error:
    print("refused after", end=" ")
print(f"{{time.process_time() - begun:.2f}}")
"""


def seconds(algebra: str, energy: str, call: str, limit: float) -> str:
    """Return the CPU time of a call in a fresh process, which is stopped after `limit` seconds."""
    script = SCRIPT.format(algebra=algebra, energy=energy, call=call)
    try:
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return f"above {limit:.0f}"
    return done.stdout.strip()


def main() -> None:
    parser = argparse.ArgumentParser(description="CPU time of calls on large algebras")
    parser.add_argument("--calls", nargs="+", choices=CALLS, default=list(CALLS), metavar="NAME")
    parser.add_argument("--limit", type=float, default=LIMIT, help="seconds after which a process is stopped")
    given = parser.parse_args()
    print(f"| CPU seconds | {' | '.join(given.calls)} |\n|---|{'---|' * len(given.calls)}")
    for name, algebra in ALGEBRAS.items():
        for kind, energy in ENERGIES.items():
            row = [seconds(algebra, energy, CALLS[call], given.limit) for call in given.calls]
            print(f"| {name}, {kind} M | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
