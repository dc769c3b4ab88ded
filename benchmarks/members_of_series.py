"""Members of an ensemble by Taylor series: eight as lanes beside pairs, which go one after the other; the same bits.

python benchmarks/members_of_series.py [--rounds R]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import coadjoint as co

H = 0.05
STEPS = 400
TOGETHER, ALONE = 8, 2  # with fewer than six, members go one after the other
ORDERS = (8, 16, 24)


def full(n: int) -> np.ndarray:
    B = np.random.default_rng(n).uniform(-0.1, 0.1, (n, n))
    return np.asarray(np.diag(np.linspace(0.6, 1.4, n)) + B + B.T)


def quartic(n: int) -> co.Polynomial:
    """Return the square of each coordinate, and some monomials of degree four."""
    rng = np.random.default_rng(n)
    monomials = {tuple(2 * (k == i) for k in range(n)): 0.5 + 0.125 * i for i in range(n)}
    for _ in range(4):
        exponents = np.bincount(rng.integers(0, n, 4), minlength=n)
        monomials[tuple(exponents.tolist())] = float(np.round(rng.uniform(-0.25, 0.25), 3))
    return co.Polynomial(monomials)


def systems() -> dict[str, co.LiePoissonSystem]:
    """Return systems of 3 to 15 dimensions; with full M, with a diagonal one, and with an energy of degree four."""
    algebras = co.algebras
    found = {"rigid body": co.systems.rigid_body(inertia=(1, 2, 3)), "heavy top": co.systems.lagrange_top()}
    for name, algebra in {
        "A5,3": algebras.get("A5,3"),
        "so(4)": algebras.so(4),
        "su(3)": algebras.su(3),
        "so(5)": algebras.so(5),
        "4 spins": algebras.copies(algebras.so(3), 4),
        "su(4)": algebras.su(4),
    }.items():
        n = algebra.dim
        found[f"{name}, diagonal"] = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(0.5, 1.5, n)))
        found[f"{name}, full"] = co.LiePoissonSystem(algebra, co.Quadratic(full(n)))
    for name in ("so(3)", "e(3)"):
        algebra = algebras.get(name)
        found[f"{name}, degree 4"] = co.LiePoissonSystem(algebra, quartic(algebra.dim))
    return found


def seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def compared(system: co.LiePoissonSystem, order: int, rounds: int) -> tuple[float, float]:
    """Return the seconds of a step of one member as a lane, and one after the other; the least of rounds in turns."""
    x = np.random.default_rng(1).normal(size=(TOGETHER, system.dim))
    x *= 0.7 / np.linalg.norm(x, axis=1, keepdims=True)
    ready, span = co.prepare(system, co.Taylor(order), H, watch=False, threads=1), (0.0, STEPS * H)
    best = [np.inf, np.inf]
    for _ in range(rounds):
        for i, members in enumerate((TOGETHER, ALONE)):
            best[i] = min(best[i], seconds(lambda: ready.run(x[:members], span, save_every=STEPS)) / members / STEPS)  # noqa: B023
    return best[0], best[1]


def main() -> None:
    parser = argparse.ArgumentParser(description="members of Taylor series as lanes, and one after the other")
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    print("ns a step of a member as a lane; in brackets, how many times longer one after the other\n")
    print("| |" + "".join(f" order {p} |" for p in ORDERS) + "\n|---|" + "---|" * len(ORDERS))
    for name, system in systems().items():
        pairs = [compared(system, order, rounds) for order in ORDERS]
        print(f"| {name} |" + "".join(f" {1e9 * lane:.0f} ({one / lane:.2f}) |" for lane, one in pairs))


if __name__ == "__main__":
    main()
