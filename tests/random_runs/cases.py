"""Random runs from a seed: system or batch, scheme, states, span, attitude and events."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

import coadjoint as co

from .algebras import some_algebra
from .hamiltonians import matrix, some_hamiltonian

MEMBERS = (1, 2, 3, 4, 7, 8, 9, 15, 16, 17, 31, 32, 33, 34, 40)
STEPS = (0, 1, 2, 3, 5, 7, 8, 11, 16, 17, 23, 29, 40)
MAX_BATCH = 300  # numbers in the states of a batch, whose members are decomposed one by one
# Schemes with random options; of other registered schemes the examples are drawn.
DRAWN = (
    co.Splitting,
    co.GaussLegendre,
    co.ModifiedGaussLegendre,
    co.IteratedGaussLegendre,
    co.ExplicitRungeKutta,
    co.RadauEnergy,
    co.Taylor,
    co.Composition,
    co.ReversibleSteps,
)
REFUSALS = (ValueError, TypeError, OverflowError)
"""Errors of refused systems, schemes or states; OverflowError if a number is too large."""
MAX_TURNS = 30.0  # relative change of a motion that adaptive steps follow
CUBE_ROOT_OF_2 = 1.2599210498948732  # powers of floats depend on the C library
TRIPLE_JUMP = (1 / (2 - CUBE_ROOT_OF_2), 1 - 2 / (2 - CUBE_ROOT_OF_2), 1 / (2 - CUBE_ROOT_OF_2))


@dataclasses.dataclass(frozen=True)
class Case:
    """Arguments of `integrate`; `systems` are those of the members."""

    systems: tuple[Any, ...]
    x0: np.ndarray
    t_span: tuple[float, float]
    step: float
    method: Any
    attitude: Any
    save_every: int
    watch: bool
    events: tuple[Any, ...] = ()

    @property
    def batch(self) -> bool:
        return len(self.systems) > 1

    def __str__(self) -> str:
        return (
            f"{self.systems[0]!r}{' and others' if self.batch else ''} by {self.method}, {len(self.x0)} members, "
            f"t_span={self.t_span}, step={self.step}, attitude={self.attitude!r}, save_every={self.save_every}, "
            f"events={list(self.events)}"
        )


def some_method(rng: np.random.Generator) -> Any:
    """Return a random scheme with random options."""
    kind = rng.integers(14)
    if kind <= 3:
        compensated = (None, True, False)[rng.integers(3)]
        if rng.random() < 0.25:
            names = "yoshida4 suzuki4 blanes_moan6 blanes_casas_murua6 kahan_li8a sofroniou_spaletta10".split()
            return co.Splitting(scheme=names[rng.integers(len(names))], compensated=compensated)
        order = int(rng.choice([1, 2, 4, 6, 8, 10], p=[0.15, 0.4, 0.25, 0.1, 0.05, 0.05]))
        draw = rng.random()
        parts = "coordinates" if draw < 0.3 else "bonds" if draw > 0.95 else "free_body" if draw > 0.85 else "auto"
        rotation = "rational" if rng.random() < 0.2 and parts not in ("free_body", "bonds") else "exact"
        adjoint = bool(order == 1 and rng.random() < 0.5)
        return co.Splitting(order=order, parts=parts, compensated=compensated, rotation=rotation, adjoint=adjoint)
    if kind == 4:
        return co.GaussLegendre(int(rng.choice([1, 2, 3, 4, 5, 6, 8, 9, 12, 16, 17])))
    if kind == 5:
        return co.ModifiedGaussLegendre(int(rng.integers(1, 5)), freeze=("structure", "gradient")[rng.integers(2)])
    if kind == 6:
        return co.IteratedGaussLegendre(int(rng.integers(1, 5)), iterations=(None, 1, 4)[rng.integers(3)])
    if kind == 7:
        return co.ExplicitRungeKutta(("rk4", "runge2")[rng.integers(2)])
    if kind == 8:
        return co.RadauEnergy(int(rng.integers(1, 4)))
    if kind <= 10:
        order = int(rng.choice([1, 2, 3, 5, 8, 16, 17, 24, 33, 64]))
        return co.Taylor(order, projected=bool(rng.random() < 0.7))
    if kind == 11:
        bases = (co.Splitting(order=2), co.GaussLegendre(1), co.Splitting(order=2, compensated=True))
        return co.Composition(bases[rng.integers(3)], TRIPLE_JUMP)
    return other_schemes()[rng.integers(len(other_schemes()))]


@cache
def other_schemes() -> Sequence[Any]:
    """Return the examples of the registered schemes that are not in DRAWN."""
    classes = (co.methods.registry.scheme(name) for name in co.methods.names())
    return [method for scheme in classes if scheme not in DRAWN for method in scheme.examples()]


def ensemble(rng: np.random.Generator, members: int, n: int) -> np.ndarray:
    """Return independent or neighbouring states, some at rest, some much larger than others."""
    states = 10.0 ** rng.choice([-3, 0, 0, 0, 1]) * rng.standard_normal((members, n))
    if rng.random() < 0.3:
        # Neighbours reach the limits of an iteration in the same step.
        states = states[0] * (1.0 + 10.0 ** -rng.integers(1, 7) * np.arange(members)[:, None])
    if rng.random() < 0.25:
        far = rng.random(members) < 0.3
        states[far] *= 10.0 ** rng.choice([1, 3, 20, 100, 200])
    if rng.random() < 0.1:
        states[rng.integers(members)] = 0.0
    return states


def some_systems(rng: np.random.Generator, members: int) -> tuple[Any, ...]:
    """Return one system, or one per member with different constants."""
    algebra, sign = some_algebra(rng), int(rng.choice([-1, 1]))
    if 1 < members <= MAX_BATCH / algebra.dim and rng.random() < 0.15:
        M = matrix(rng, algebra.dim)
        factors = 1.0 + 0.1 * rng.random(members)
        return tuple(co.LiePoissonSystem(algebra, co.Quadratic(f * np.asarray(M)), sign=sign) for f in factors)
    return (co.LiePoissonSystem(algebra, some_hamiltonian(rng, algebra.dim), sign=sign),)


def case_of(seed: int) -> tuple[Case, np.random.Generator]:
    """Return the case of a seed, and the generator for its comparisons."""
    rng = np.random.default_rng(seed)
    while True:
        members = int(rng.choice(MEMBERS))
        try:
            systems, method = some_systems(rng, members), some_method(rng)
            keeps = method.properties(systems[0])
        except REFUSALS:
            # Refusals are tested elsewhere; draw again.
            continue
        n = systems[0].dim
        step = float(rng.choice([0.01, 0.0625, 0.1, 0.3, 1.0]))
        t0, steps = float(rng.choice([0.0, 0.0, 1.5, -2.0])), int(rng.choice(STEPS))
        end = t0 + step * steps * float(rng.choice([-1.0, 1.0, 1.0]))
        attitude: Any = False
        if keeps.attitude != "none" and n <= 30 and rng.random() < 0.7:
            own = systems[0].representation is not None and rng.random() < 0.5
            attitude = True if own else "coadjoint"
        save_every, watch = int(rng.choice([1, 1, 2, 3, 5, 7, 9, 13, 100])), bool(rng.random() < 0.6)
        x0 = ensemble(rng, members, n)
        case = Case(systems, x0, (t0, end), step, method, attitude, save_every, watch)
        # A separate generator does not affect the draws above.
        return with_more(case, np.random.default_rng([seed, 1])), rng


def with_more(case: Case, rng: np.random.Generator) -> Case:
    """Return the case, sometimes with adaptive steps, and sometimes with events."""
    if rng.random() < 0.25:
        case = with_own_steps(case, rng)
    if rng.random() < 0.35 and np.abs(case.x0).max() < 1e6:
        events = tuple(some_event(rng, case) for _ in range(int(rng.integers(1, 4))))
        case = dataclasses.replace(case, events=events)
    return case


def with_own_steps(case: Case, rng: np.random.Generator) -> Case:
    """Return the case with adaptive steps, unless the motion is too fast."""
    if rng.random() < 0.6:
        tolerance = 10.0 ** float(rng.uniform(-14, -2))
        method: Any = co.Taylor(tolerance=tolerance, projected=bool(rng.random() < 0.7))
    else:
        bases = (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(2))
        method = co.ReversibleSteps(bases[rng.integers(3)], float(rng.choice([0.03, 0.1, 0.3])))
    system, time = case.systems[0], abs(case.t_span[1] - case.t_span[0])
    try:
        with np.errstate(all="ignore"):
            changes = np.array([system.vector_field(x) for x in case.x0])
            fast = np.linalg.norm(changes, axis=1) * time > MAX_TURNS * np.linalg.norm(case.x0, axis=1)
        keeps = method.properties(system)
    except REFUSALS:
        return case
    if fast.any() or not np.isfinite(changes).all():
        return case
    attitude = case.attitude if keeps.attitude != "none" else False
    return dataclasses.replace(case, method=method, attitude=attitude)


def some_event(rng: np.random.Generator, case: Case) -> co.Event:
    """Return a coordinate, or a linear or quadratic function that is zero near one of the states."""
    n, direction = case.systems[0].dim, int(rng.integers(-1, 2))
    count = (None, None, 1, 3)[rng.integers(4)]
    kind, name = rng.integers(3), f"e{rng.integers(10**9)}"
    if kind == 0:
        return co.Event(int(rng.integers(n)), direction=direction, count=count, name=name)
    w = np.round(rng.standard_normal(n), 2)
    M = np.diag(rng.standard_normal(n)) if kind == 2 else np.zeros((n, n))
    x = case.x0[rng.integers(len(case.x0))] * float(rng.uniform(0.8, 1.2))
    return co.Event(
        co.Quadratic(M, linear=w, constant=-float(w @ x + 0.5 * x @ M @ x)), direction=direction, count=count, name=name
    )
