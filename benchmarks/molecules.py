"""Rigid molecules of water: the time of a step beside C, and the drift of the energy beside Fincham's leapfrog.

python benchmarks/molecules.py [--molecules N ...] [--steps S] [--rounds R] [--time PS]
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path
from typing import Any

import numpy as np
from c_programs import HERE, build, run
from scipy.spatial.transform import Rotation

import coadjoint as co

STEP, CHECKED_STEPS = 0.001, 5
SPLITTING, LEAPFROG = "0", "1"
BOLTZMANN = 0.00831446  # kJ/mol/K
SPACING, QUENCHES, HOT = 0.31, 60, 600.0  # nm, runs that end at rest, K: half of this is left when the droplet melts
STEPS = (0.0005, 0.001, 0.002, 0.003)


def droplet(count: int, turned: bool) -> tuple[Any, np.ndarray]:
    """Return molecules of TIP3P water near a cubic grid, at rest."""
    system = co.systems.rigid_molecules(count=count)
    side = int(np.ceil(np.cbrt(count)))
    places = SPACING * np.array(list(np.ndindex(side, side, side)))[:count]
    rng = np.random.default_rng(1)
    attitudes = Rotation.random(count, random_state=rng) if turned else None
    return system, system.state(places + 0.01 * rng.standard_normal(places.shape), attitudes=attitudes)


def melted(count: int) -> tuple[Any, np.ndarray]:
    """Return a droplet that was cooled, heated, and left alone for 5 ps."""
    system, x = droplet(count, turned=True)
    prepared = co.prepare(system, co.Splitting(order=2), STEP, watch=False)
    for _ in range(QUENCHES):
        x = prepared.run(x, (0.0, 0.02), save_every=20).x[-1]
        x = system.state(system.positions(x), attitudes=system.attitudes(x))
    rng, moments = np.random.default_rng(2), np.diag(system.inertias[0].tensor)
    v = rng.standard_normal((count, 3)) * np.sqrt(BOLTZMANN * HOT / system.masses[:, None])
    omega = rng.standard_normal((count, 3)) * np.sqrt(BOLTZMANN * HOT / moments)
    x = system.state(system.positions(x), v - v.mean(axis=0), system.attitudes(x), omega)
    return system, prepared.run(x, (0.0, 5.0), save_every=5000).x[-1]


def temperature(system: Any, x: np.ndarray) -> float:
    L, v = system.angular_momentum(x), system.velocities(x)
    kinetic = (L * system.angular_velocity(x)).sum() + (system.masses[:, None] * v * v).sum()
    return float(kinetic / (6 * len(system.masses) * BOLTZMANN))


def rows_of(system: Any, x: np.ndarray) -> np.ndarray:
    """Return attitude, angular momentum, momentum and position of each molecule, as C has them."""
    count = len(system.masses)
    parts = (system.attitudes(x), system.angular_momentum(x), system.masses[:, None] * system.velocities(x))
    return np.concatenate([part.reshape(count, -1) for part in (*parts, system.positions(x))], axis=1)


def written(system: Any, x: np.ndarray) -> Path:
    """Write the file that the C program reads."""
    tables, given = system.tables, system.parameters
    charges = np.sqrt(given["coulomb"]) * np.array(given["charges"])
    numbers = (system.inertias[0].inverse, system.masses[:1], tables.places.ravel(), charges)
    file = HERE / "build" / f"molecules_{len(system.masses)}.state"
    file.parent.mkdir(exist_ok=True)
    constants = (*numbers, tables.a[0, :1], tables.b[0, :1], rows_of(system, x).ravel())
    file.write_bytes(np.concatenate(constants).tobytes())
    return file


def compare(count: int, steps: int, rounds: int) -> str:
    """Time both programs in turn, after a comparison of the states after few steps."""
    program, (system, x) = build("molecules"), droplet(count, turned=False)
    file, prepared = written(system, x), co.prepare(system, co.Splitting(order=2), STEP, watch=False)
    _, found = run(program, [str(CHECKED_STEPS), repr(-STEP), str(count), str(file), SPLITTING])
    end = rows_of(system, prepared.run(x, (0.0, CHECKED_STEPS * STEP)).x[-1])
    apart = float(np.abs(np.concatenate([end[0], end[-1]]) - found[:36]).max())
    if not apart <= 2.0**-53 * 16 * CHECKED_STEPS * 9 * count * np.abs(end).max():
        raise SystemExit(f"{count} molecules: coadjoint and C differ by {apart:.2g}")
    theirs, ours = [], []
    for _ in range(rounds):
        ours.append(1e9 * prepared.run(x, (0.0, steps * STEP), save_every=steps).stats.seconds / steps)
        theirs.append(run(program, [str(steps), repr(-STEP), str(count), str(file), SPLITTING])[0])
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    best = min(theirs), min(ours)
    return f"| {count} | {best[0] / 1e6:.3f} | {best[1] / 1e6:.3f} | {best[1] / best[0]:.2f} | {ratio:.2f} |"


def drifts(count: int, time: float) -> list[str]:
    """Compare energies of a droplet: their change from the first to the last tenth, and their deviation."""
    program, (system, x) = build("molecules"), melted(count)
    file, unit = written(system, x), count * BOLTZMANN * temperature(system, x)
    lines = []
    for step in STEPS:
        steps = round(time / step)
        arguments = [str(steps), repr(step), str(count), str(file), LEAPFROG]
        first, last, deviation = run(program, arguments)[1][36:]
        energy = co.integrate(system, x, (0.0, steps * step), step, co.Splitting(order=2)).energy
        tenth = steps // 10
        ours = energy[-tenth:].mean() - energy[:tenth].mean(), energy.std()
        shown = " | ".join(f"{v / unit:.1e}" for v in (last - first, deviation, *ours))
        lines.append(f"| {1000 * step:g} | {shown} |")
    head = (
        f"{count} molecules at {temperature(system, x):.0f} K for {time:g} ps, energies over the kT of all molecules:"
    )
    columns = "| fs | leapfrog, drift | leapfrog, deviation | coadjoint, drift | coadjoint, deviation |"
    return [head, "", columns, "|---|---|---|---|---|", *lines]


def main() -> None:
    parser = argparse.ArgumentParser(description="rigid molecules: coadjoint, and C with the same loop over pairs")
    parser.add_argument("--molecules", type=int, nargs="+", default=[64, 1000])
    parser.add_argument("--steps", type=int, help="by default 10^7 pairs", default=None)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--time", type=float, default=50.0)
    given = parser.parse_args()
    print("| molecules | C, ms a step | coadjoint, ms a step | ratio | median of the rounds |\n|---|---|---|---|---|")
    for count in given.molecules:
        print(compare(count, given.steps or max(3, 2 * 10**7 // count**2), given.rounds), flush=True)
    print()
    print("\n".join(drifts(64, given.time)))


if __name__ == "__main__":
    main()
