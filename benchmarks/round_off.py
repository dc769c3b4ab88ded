"""Round-off over 64 members: what wanders like the square root of time, and what drifts.

python benchmarks/round_off.py [--time T]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import coadjoint as co
from coadjoint.analysis.structure_defects import RandomWalk, orthogonality, round_off, spatial_momentum

MEMBERS = 64
DETAILS = "<!-- details -->"
HEADER = "| system | scheme | conserved | rms at t/100 | rms at t | growth | bias, standard errors | worst |"


def systems() -> dict[str, tuple[Any, float]]:
    """Return the systems, and the fraction of the time that they are followed for."""
    top = co.Quadratic([1.0, 0.8, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.2, 0.1, 1.0])
    B = np.random.default_rng(4).uniform(-0.5, 0.5, (6, 6))
    full = np.round(np.diag(np.linspace(0.6, 1.6, 6)) + 0.25 * (B + B.T), 3)
    so4 = co.algebras.so(4)
    return {
        "rigid body": (co.systems.rigid_body(inertia=(1, 2, 3)), 1.0),
        "heavy top": (co.LiePoissonSystem(co.algebras.get("e(3)"), top), 1.0),
        "so(4), diagonal M": (co.LiePoissonSystem(so4, co.Quadratic(np.diag(full))), 1.0),
        "so(4), full M": (co.LiePoissonSystem(so4, co.Quadratic(full)), 0.05),
    }


def run(system: Any, method: Any, step: float, time: float, attitude: Any = False) -> Any:
    x0 = np.random.default_rng(5).normal(size=(MEMBERS, system.dim))
    steps = 100 * round(time / step / 100)
    span = (0.0, steps * step)
    return co.integrate(system, x0, span, step, method, save_every=steps // 100, watch=False, attitude=attitude)


def row(system: str, scheme: str, what: str, walk: RandomWalk) -> str:
    numbers = f"{walk.early:.1e} | {walk.late:.1e} | {walk.growth:.1f} | {walk.bias:+.1f} | {walk.worst:.1e}"
    return f"| {system} | {scheme} | {what} | {numbers} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="growth of round-off over an ensemble")
    parser.add_argument("--time", type=float, default=1e6)
    given = parser.parse_args()
    splitting, gauss = co.Splitting(order=2, compensated=True), co.GaussLegendre(8)
    rows: dict[tuple[str, str], dict[str, RandomWalk]] = {}
    for name, (system, share) in systems().items():
        time = share * given.time
        title = name if share == 1.0 else f"{name}, t = {time:g}"
        solution = run(system, splitting, 0.1, time)
        walks = {what: walk for what, walk in round_off(solution).items() if what != "energy"}
        walks["g orthogonal"] = orthogonality(
            run(system, splitting, 0.1, time / 5, True), 3 if name == "heavy top" else None
        )
        walks["spatial momentum"] = spatial_momentum(run(system, splitting, 0.1, time / 5, attitude="coadjoint"))
        rows[title, "splitting 2, compensated, h = 0.1"] = walks
        rows[title, "Gauss-Legendre 8, h = 0.5"] = round_off(run(system, gauss, 0.5, time))
    print(f"{MEMBERS} members, t = {given.time:g}; a random walk grows by 10, a bias by 100.", end=" ")
    print(f"The invariant that moves most:\n\n{HEADER}\n|{'---|' * 8}")
    for key, walks in rows.items():
        most = max(walks, key=lambda what: walks[what].late)
        print(row(*key, most, walks[most]))
    print(f"\n{DETAILS}\n\n{HEADER}\n|{'---|' * 8}")
    for key, walks in rows.items():
        for what, walk in walks.items():
            print(row(*key, what, walk))


if __name__ == "__main__":
    main()
