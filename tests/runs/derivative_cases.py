"""Schemes, systems and initial elements for tests of derivatives of runs, and products that must agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co
from coadjoint.methods.protocol.flow_method import FlowMethod
from group_elements import random_element
from long import long_where
from verification.schemes_under_test import schemes, serves

U = 2.0**-53
H = 0.125


def wave(y, t):
    return np.cos(y) * (1.0 + 0.5 * t)


def wave_slope(y, t):
    return -np.sin(y) * (1.0 + 0.5 * t)


def wave_curvature(y, t):
    return -np.cos(y) * (1.0 + 0.5 * t)


@cache
def flow_schemes() -> dict[str, Any]:
    """Return schemes of exact flows by name: with all options, processed and composed."""
    found = {name: method for name, method in schemes().items() if isinstance(method.expanded, FlowMethod)}
    return found | {
        "Splitting 6": co.Splitting(order=6),
        "Splitting 2 bonds": co.Splitting(parts="bonds"),
        "Splitting 2 rational": co.Splitting(parts="coordinates", rotation="rational"),
        "Splitting 4 rational": co.Splitting(order=4, rotation="rational"),
        "Splitting processed": co.Splitting(scheme="blanes_casas_murua6"),
        "Splitting processed, compensated": co.Splitting(scheme="blanes_casas_murua6", compensated=True),
    }


def fits(method: Any, system: Any) -> bool:
    """Return whether a scheme supports a system; rational rotations are tried."""
    if not serves(method, system):
        return False
    try:
        return getattr(method, "rotation", "exact") == "exact" or bool(method.program(system))
    except ValueError:
        return False


def with_each_once(pairs: Sequence[tuple[str, str]], share: int) -> list[Any]:
    """Return cases for `parametrize`, of which one of about `share` is not long, but at least one for each name.

    Those stay whose ranks among the first and the second names add up to a multiple of `share`.
    """
    ranks = [{name: k for k, name in enumerate(dict.fromkeys(names))} for names in zip(*pairs, strict=True)]
    stay = {pair for pair in pairs if sum(rank[name] for rank, name in zip(ranks, pair, strict=True)) % share == 0}
    for column, rank in enumerate(ranks):
        for name in rank.keys() - {pair[column] for pair in stay}:
            stay.add(next(pair for pair in pairs if pair[column] == name))
    return long_where([pair for pair in pairs if pair not in stay], pairs)


def element_for(system: Any, attitude: Any, seed: int, members: int | None = None) -> np.ndarray | None:
    """Return an element that is not the unit, or one for each member; None without an attitude."""
    if attitude is False:
        return None
    units = np.eye(system.dim)
    rho = system.representation if attitude is True else np.array([system.algebra.coadjoint(unit) for unit in units])
    return random_element(rho, seed, members, size=0.3)


def attitudes_of(system: Any) -> tuple[Any, ...]:
    return (False, "coadjoint") if system.representation is None else (True, False, "coadjoint")


class Span(NamedTuple):
    """Span of a run, and the points at which it is saved."""

    ends: tuple[float, float]
    points: Mapping[str, Any]


SPANS = (
    Span((0.0, 7 * H), {"save_every": 3}),
    Span((1.5, 1.5 - 4 * H), {"t_eval": 1.5 - H * np.array([0.0, 0.0, 0.25, 1.0, 2.75, 2.875, 4.0])}),
    Span((-40.0, -40.0 + 3 * H), {"t_eval": -40.0 + H * np.array([0.5, 2.25])}),
    Span((1.0, 1.0 - 5 * H), {"save_every": 2}),
)
"""Forward and backward, from other times than 0, with times between steps, also before the first one."""


class Derivatives(NamedTuple):
    """A run, its tangents along random directions, and its gradient for random cotangents."""

    solution: Any
    directions: dict[str, np.ndarray]
    tangents: Any
    cotangents: dict[str, np.ndarray]
    gradient: Any

    @property
    def rounding(self) -> float:
        """Relative bound on round-off: a unit for each flow of a member, and each product of a sum."""
        members = self.solution.x[0].size // self.solution.system.dim
        return U * (self.solution.stats.evaluations / members + self.solution.x[0].size)

    def products(self, k: int) -> tuple[float, float, float]:
        """Return the sums of cotangents times tangents, and of gradient times direction k, and of their sizes."""
        after = [self.cotangents[name] * getattr(self.tangents, name)[..., k] for name in self.cotangents]
        before = [self.gradient[name] * direction[..., k] for name, direction in self.directions.items()]
        sums = [float(np.sum([part.sum() for part in parts])) for parts in (after, before)]
        return sums[0], sums[1], float(np.sum([np.abs(part).sum() for part in after + before]))


def derivatives(ready: Any, x0: np.ndarray, span: Span, rng: np.random.Generator, element: Any = None) -> Derivatives:
    """Return the derivatives along two directions of everything, and the gradient of a random sum of all outputs."""
    given = {**span.points, "attitude": element}
    count = 2
    directions = {"x0": rng.standard_normal((*x0.shape, count))}
    directions |= {name: rng.standard_normal((*value.shape, count)) for name, value in ready.parameters.items()}
    if ready.carries:
        shape = np.shape(ready.run(x0, span.ends, **given).attitude)[1:]
        directions["attitude0"] = rng.standard_normal((*shape, count))
    solution, tangents = ready.jvp(x0, span.ends, directions, **given)
    same, pullback = ready.vjp(x0, span.ends, **given)
    assert np.array_equal(solution.x, same.x)
    cotangents = {
        name: rng.standard_normal(getattr(solution, name).shape)
        for name in ("x", "attitude", "energy")
        if getattr(solution, name) is not None
    }
    return Derivatives(solution, directions, tangents, cotangents, pullback(**cotangents))


def assert_adjoint(found: Derivatives) -> None:
    for k in range(2):
        after, before, size = found.products(k)
        assert abs(after - before) <= found.rounding * size, (after, before, abs(after - before) / size)
    assert set(found.gradient) == set(found.directions)
