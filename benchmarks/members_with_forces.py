"""Steps of ensembles with forces and noise, beside the same steps without forces.

python benchmarks/members_with_forces.py [--members M] [--threads T] [--steps S] [--rounds R] [--only NAME ...]

Energies are not watched. All runs of a system are timed in turns, and only the state at their end is saved. Times are
those of the processor, of all threads.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import coadjoint as co

F = co.forces
STEP = 0.02
SYSTEMS = {
    "rigid body": lambda: co.systems.rigid_body((1, 2, 3)),
    "so(4)": co.systems.manakov_top,
    "4 spins": lambda: co.systems.spin_lattice("ring", 4, exchange=1.0),
    "64 spins": lambda: co.systems.spin_lattice("square", (8, 8), exchange=1.0),
}


def forces_on(name: str, n: int) -> dict[str, Any]:
    """Return the forces that are timed on a system, by name."""
    found = {
        "constant torque": F.Torque(np.full(n, 0.01)),
        "linear damping": F.LinearDamping(0.1),
        "heat bath": F.HeatBath(0.1, temperature=0.2, seed=1),
    }
    if "spins" in name:
        return {"random field": F.RandomField(0.1, seed=1), "Gilbert": F.Gilbert(0.1, 0.2, seed=1), **found}
    return {
        "1 noise": F.HamiltonianNoise(np.eye(n)[0], 0.1, seed=1),
        f"{n} noises": F.HamiltonianNoise(np.eye(n), 0.1, seed=1),
        **found,
    }


def best(rounds: int, *runs: Any) -> list[float]:
    """Return the best processor time of each of some runs, which go in turns."""
    found = [np.inf] * len(runs)
    for _ in range(rounds):
        for place, run in enumerate(runs):
            began = time.process_time()
            run()
            found[place] = min(found[place], time.process_time() - began)
    return found


def measured(name: str, members: int, threads: int, steps: int, rounds: int) -> list[str]:
    """Return the rows of a system, timed in turns; large systems have fewer members."""
    system = SYSTEMS[name]()
    n = system.dim
    members = max(64, members * 3 // n)
    cases = {"none": system} | {label: system.with_forces(force) for label, force in forces_on(name, n).items()}
    x0 = np.random.default_rng(1).normal(size=(members, n)) / np.sqrt(n)
    ready = [co.prepare(case, co.Splitting(), STEP, threads=threads, watch=False) for case in cases.values()]
    calls = [lambda one=one: one.run(x0, (0.0, steps * STEP), save_every=steps) for one in ready]
    times = [1e9 * seconds / members / steps for seconds in best(rounds, *calls)]
    return [
        f"| {name} | {members} | {label} | {one:.0f} | {one / times[0]:.1f} |"
        for label, one in zip(cases, times, strict=True)
    ]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--members", type=int, default=100_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=SYSTEMS, default=list(SYSTEMS))
    given = parser.parse_args()
    print("| system | members | force | ns a step of a member | : without |")
    print("|---|---|---|---|---|")
    for name in given.only:
        print(*measured(name, given.members, given.threads, given.steps, given.rounds), sep="\n", flush=True)


if __name__ == "__main__":
    main()
