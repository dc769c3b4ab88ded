"""Satellites with dispersed inertia, magnets, gains and orbits: preparation and a run, beside one satellite.

python benchmarks/dispersions.py [--members M] [--rounds R]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

MEMBERS = """
import json, sys, time
import numpy as np
import coadjoint as co

members, rounds = map(int, sys.argv[1:])
rng = np.random.default_rng(1)
RADIUS = 7.0e6
RATE = np.sqrt(co.orbits.EARTH.mu / RADIUS**3)
PLATES = {
    "areas": (1.0, 1.0),
    "normals": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "centres": ((0.1, 0.0, 0.02), (0.0, 0.1, 0.0)),
}
WHEELS = [(0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01)]

def satellite():
    F, options = co.forces, {"epoch": "2026-03-20T12:00:00", "frame": "J2000"}
    orbit = co.orbits.circular(RADIUS, argument=rng.uniform(0.0, 6.28), **options)
    law = F.Pointing(0.05 * rng.uniform(0.8, 1.2), 2.0 * rng.uniform(0.8, 1.2), error="quaternion")
    return co.systems.body(np.array([20.0, 25.0, 30.0]) * rng.uniform(0.9, 1.1, 3), wheels=WHEELS).with_forces(
        F.GravityGradient(orbit.planet.mu, orbit.position),
        F.MagneticDipole(rng.normal(0.0, 0.1, 3), co.orbits.tilted_dipole(orbit)),
        F.SolarPressure(4.5e-6, (1.0, 0.0, 0.0), **PLATES),
        F.Drag(1e-12, orbit.velocity, **PLATES),
        F.ReactionWheels(law, 1.0),
    )

def best(run):
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return min(times)

began = time.perf_counter()
systems = [satellite() for _ in range(members)]
x0 = np.array([one.state(angular_velocity=(0.01, -0.02, 0.005)) for one in systems])
ready = co.prepare(co.batch(systems), co.Splitting(), 0.25, threads=1)
prepared = time.perf_counter() - began
orbit = 2.0 * np.pi / RATE
span, options = (0.0, 0.25 * round(orbit / 0.25)), {"save_every": 240}
began = time.perf_counter()
ready.run(x0, span, **options)
first = time.perf_counter() - began
alone = co.prepare(systems[0], co.Splitting(), 0.25, threads=1)
alone.run(x0[0], span, **options)
whole, one = [], []
for _ in range(rounds):  # in turns
    began = time.perf_counter()
    ready.run(x0, span, **options)
    whole.append(time.perf_counter() - began)
    one.append(best(lambda: alone.run(x0[0], span, **options)))
print(json.dumps([prepared, first, min(whole) / members / min(one)]))
"""


def measure(members: int, rounds: int, cache: str) -> list[float]:
    environment = {**os.environ, "XDG_CACHE_HOME": cache}
    command = [sys.executable, "-W", "ignore", "-c", MEMBERS, str(members), str(rounds)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return [float(number) for number in json.loads(done.stdout)]


def main() -> None:
    parser = argparse.ArgumentParser(description="satellites with dispersed numbers beside one")
    parser.add_argument("--members", type=int, default=500)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        compiled, stored = (measure(given.members, given.rounds, cache) for _ in range(2))
    print(f"| {given.members} satellites with four torques of the environment, quaternion feedback and wheels | |")
    print("|---|---|")
    print(f"| made and prepared by a process that compiles | {compiled[0]:.1f} s |")
    print(f"| made and prepared by the next process | {stored[0]:.1f} s |")
    print(f"| first run of one orbit with a check of the step | {stored[1]:.1f} s |")
    print(f"| a run of one orbit for each member, beside a run of one satellite, in one thread | {stored[2]:.2f} |")


if __name__ == "__main__":
    main()
