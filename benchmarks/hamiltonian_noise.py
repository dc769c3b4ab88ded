"""Steps of ensembles with Hamiltonian noise, beside the same steps without noise and with a force that does nothing.

python benchmarks/hamiltonian_noise.py [--members M ...] [--threads T] [--steps S] [--rounds R]

Energies are not watched. Without forces, members are lanes of a loop of flows alone; with any force each step calls
that loop for 64 members, and counts the work.
"""

from __future__ import annotations

import argparse

import numpy as np
from lyapunov import best

import coadjoint as co

STEP, STRENGTH = 0.05, 0.1
SYSTEMS = {"rigid body": co.systems.rigid_body((1, 2, 3)), "so(4)": co.systems.manakov_top()}


def measured(name: str, members: int, threads: int, steps: int, rounds: int) -> list[str]:
    """Return the rows of a system, timed in turns."""
    system = SYSTEMS[name]
    n = system.dim
    noise = {f"{count} noises": co.forces.HamiltonianNoise(np.eye(n)[:count], STRENGTH, seed=1) for count in (1, n)}
    forces = {"idle torque": co.forces.Torque(np.zeros(n)), **noise}
    cases = {"none": system} | {label: system.with_forces(force) for label, force in forces.items()}
    x0 = np.tile(np.cos(1.0 + np.arange(n)), (members, 1))
    ready = [co.prepare(case, co.Splitting(), STEP, threads=threads, watch=False) for case in cases.values()]
    calls = [lambda one=one: one.run(x0, (0.0, steps * STEP), save_every=steps) for one in ready]
    times = [1e9 * seconds / members / steps for seconds in best(rounds, *calls)]
    return [
        f"| {name} | {members} | {label} | {one:.0f} | {one / times[0]:.1f} | {one / times[1]:.2f} |"
        for label, one in zip(cases, times, strict=True)
    ]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--members", type=int, nargs="+", default=[100_000])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    print("| system | members | force | ns a step of a member | : without | : idle torque |")
    print("|---|---|---|---|---|---|")
    for name in SYSTEMS:
        for members in given.members:
            print(*measured(name, members, given.threads, given.steps, given.rounds), sep="\n", flush=True)


if __name__ == "__main__":
    main()
