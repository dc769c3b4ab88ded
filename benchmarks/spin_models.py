"""Processor time of a step of a spin: simple cubic lattices by name, on a crystal, of SU(3), and with dipoles by FFT.

python benchmarks/spin_models.py [--rounds R] [--only lattice crystal su3 neighbours dipoles ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import coadjoint as co

SIDE, LONG = 16, (40, 30, 20)  # cells of a cube, and of 24 000 sites
STEP = 0.02


def lattice() -> tuple[Any, Any, Any, int]:
    """Return nearest neighbours by name, the reference of all."""
    system = co.systems.spin_lattice("cubic", (SIDE,) * 3, True)
    return system, directions(SIDE**3), co.Splitting(order=2), SIDE**3


def model(size: tuple[int, ...], **options: Any) -> Any:
    cell = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    system = co.systems.spins(cell, size, **options)
    for bond in cell.bonds(1):
        system = system.exchange(bond, -1.0)
    return system


def crystal() -> tuple[Any, Any, Any, int]:
    return model((SIDE,) * 3), directions(SIDE**3), co.Splitting(order=2), SIDE**3


def su3() -> tuple[Any, Any, Any, int]:
    Sz = co.spins.operators(1)[2]
    system = model((SIDE,) * 3, spin=1, mode="SU(N)").single_ion("Fe", -0.5 * Sz @ Sz)
    return system, system.random(1), co.Splitting(order=2), SIDE**3


def neighbours() -> tuple[Any, Any, Any, int]:
    """Return the lattice of `dipoles` without them, by the same scheme."""
    return model(LONG), directions(24_000), co.GaussLegendre(1), 24_000


def dipoles() -> tuple[Any, Any, Any, int]:
    """Return moments with Ewald's sums, a tenth of a unit each."""
    return model(LONG, g=0.1).dipolar(), directions(24_000), co.GaussLegendre(1), 24_000


def open_neighbours() -> tuple[Any, Any, Any, int]:
    """Return the same lattice with open boundaries."""
    return model(LONG, periodic=False), directions(24_000), co.GaussLegendre(1), 24_000


def open_dipoles() -> tuple[Any, Any, Any, int]:
    return model(LONG, g=0.1, periodic=False).dipolar(), directions(24_000), co.GaussLegendre(1), 24_000


def strong_dipoles() -> tuple[Any, Any, Any, int]:
    """Return open boundaries and dipoles of the size of the exchange."""
    return model(LONG, g=1.0, periodic=False).dipolar(), directions(24_000), co.GaussLegendre(1), 24_000


def directions(count: int) -> Any:
    x = np.random.default_rng(1).standard_normal((count, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


KINDS = (lattice, crystal, su3, neighbours, dipoles, open_neighbours, open_dipoles, strong_dipoles)
RATIOS = {"dipoles": "neighbours", "open_dipoles": "open_neighbours", "strong_dipoles": "open_neighbours"}


def main() -> None:
    kinds: dict[str, Callable[[], Any]] = {f.__name__: f for f in KINDS}
    parser = argparse.ArgumentParser(description="processor time of a step of a spin, least of several rounds")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="+", choices=list(kinds), default=list(kinds))
    given = parser.parse_args()
    runs = {}
    for name in given.only:
        system, x0, scheme, sites = kinds[name]()
        steps = max(4, 400_000 // sites)
        prepared = co.prepare(system, scheme, STEP, watch=False, threads=1)
        prepared.run(x0, (0.0, STEP))
        runs[name] = prepared, x0, sites, steps
    least = dict.fromkeys(runs, np.inf)
    for _ in range(given.rounds):  # in turn, so that a busy machine slows all of them
        for name, (prepared, x0, sites, steps) in runs.items():
            begun = time.process_time()
            prepared.run(x0, (0.0, steps * STEP), save_every=steps)
            least[name] = min(least[name], 1e9 * (time.process_time() - begun) / steps / sites)
    first = least[given.only[0]]
    print("| model | ns a site step | of the first |\n|---|---|---|")
    for name, value in least.items():
        print(f"| {name} | {value:.1f} | {value / first:.2f} |")
    for name, other in RATIOS.items():
        if {name, other} <= least.keys():
            print(f"{name}: {least[name] / least[other]:.2f} times the run of {other}")


if __name__ == "__main__":
    main()
