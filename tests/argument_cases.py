"""Calls with several arguments: systems of several algebras, arguments, and recorded outcomes."""

from dataclasses import dataclass, field
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import distributed
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co

MEMBERS, LENGTH, STEP = 5, 3.0, 0.125
# The largest error of a splitting of order two at this step, less than the distances of members.
NEAR = 0.1
ACCURACY = 1e-6
RNG = np.random.default_rng(12)


class World(NamedTuple):
    """A system or a batch, with states, initial group elements, and a coordinate with zeros."""

    systems: tuple[co.LiePoissonSystem, ...]
    x0: np.ndarray
    attitude: Any
    crossing: int

    @property
    def system(self):
        return self.systems[0] if len(self.systems) == 1 else co.batch(self.systems)


def states(n):
    return RNG.uniform(0.4, 0.9, (MEMBERS, n)) * RNG.choice([-1.0, 1.0], (MEMBERS, n))


def elements(system):
    return np.stack([expm(0.3 * (m + 1) * system.representation[m % 3]) for m in range(MEMBERS)])


BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
FOUR = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.linspace(0.5, 2.0, 6)))
TOPS = tuple(
    co.LiePoissonSystem(co.algebras.e(3), co.Quadratic((1.0, 0.8, 0.5 + 0.1 * m, 0.2, 0.0, 0.3)), -1)
    for m in range(MEMBERS)
)
WORLDS = {
    "so(3)": World((BODY,), states(3), elements(BODY), 1),
    "so(4)": World((FOUR,), states(6), "coadjoint", 2),
    "e(3)": World(TOPS, states(6), "coadjoint", 4),
}
LINEAR = {name: RNG.uniform(0.3, 0.9, (MEMBERS, world.x0.shape[1])) for name, world in WORLDS.items()}


@cache
def exact(name, way, moved):
    """Return the motions of the members from SciPy, as functions of the time since the start."""
    world, found = WORLDS[name], []
    for m, x0 in enumerate(world.x0):
        system = world.systems[m % len(world.systems)]
        extra = LINEAR[name][m] if moved else np.zeros(len(x0))

        def slope(t, x, system=system, extra=extra):
            return system.vector_field(x) + system.sign * system.algebra.structure_matrix(x) @ extra

        arguments = {"method": "DOP853", "rtol": 1e-2 * ACCURACY, "atol": 1e-3 * ACCURACY, "dense_output": True}
        found.append(solve_ivp(slope, (0.0, way * LENGTH), x0, **arguments).sol)
    return found


class Task:
    status = "finished"

    def __init__(self, found):
        self.result = lambda: found


class Inline(distributed.Client):
    """A client that runs tasks when they are submitted."""

    status, scheduler = "running", SimpleNamespace(address="inproc://")

    def __init__(self):
        self.threads = []

    def __del__(self):
        pass

    def scheduler_info(self, n_workers):
        return {"workers": {"first": None}}

    def scatter(self, ready, broadcast, hash):
        return ready

    def submit(self, work, *args, key, pure):
        self.threads.append(args[-1])
        return Task(work(*args))


@dataclass
class Case:
    """Arguments of a call, and records beside its result."""

    name: str
    way: float
    folder: Any
    arguments: dict[str, Any] = field(default_factory=dict)
    threads: list[int] = field(default_factory=list)
    processes: list[int] = field(default_factory=list)
    client: Inline = field(default_factory=Inline)
    cluster: Inline = field(default_factory=Inline)
    printed: str = ""

    @property
    def world(self):
        return WORLDS[self.name]

    @property
    def span(self):
        return (1.0, 1.0 + self.way * LENGTH)

    @property
    def times(self):
        return 1.0 + self.way * np.array([0.0, 0.3, 1.125, 1.13, 1.9])

    @property
    def start(self):
        """The initial group elements."""
        attitude = self.given.get("run attitude", self.world.attitude)
        return np.tile(np.eye(self.world.x0.shape[1]), (MEMBERS, 1, 1)) if isinstance(attitude, str) else attitude

    def motion(self, t, moved=False):
        """Return the states (k, members, n) at some times."""
        return np.stack([one(t - 1.0).T for one in exact(self.name, self.way, moved)], axis=1)
