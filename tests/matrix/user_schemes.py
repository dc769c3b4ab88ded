"""Schemes as a user writes them, one or two of each base class."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

import coadjoint as co
from own_schemes import NOTHING, Classical


def only_of_vectors(system):
    """Refuse matrices, whose states are no vectors."""
    if isinstance(system, co.MatrixSystem):
        raise ValueError(f"{system.name} has matrix states; use IsospectralGauss")
    return NOTHING


@dataclasses.dataclass(frozen=True)
class Heun(co.methods.StepMethod):
    """Two slopes, weighted by a list: steps that read one are Python calls."""

    order, explicit, symmetric = 2, True, False
    weights = ([0.5, 0.5],)

    def properties(self, system):
        return only_of_vectors(system)

    def step(self, system, x, t, h):
        (one, other), first = self.weights[0], h * system.vector_field(x, t)
        return x + one * first + other * h * system.vector_field(x + first, t + h)


@dataclasses.dataclass(frozen=True)
class RungeKutta(Classical):
    """The classical method, compiled by Numba."""

    def properties(self, system):
        return only_of_vectors(system)


@dataclasses.dataclass(frozen=True)
class Kutta(co.methods.RungeKuttaMethod):
    """Kutta's explicit method of order 3."""

    order, explicit, symmetric = 3, True, False
    solver = "explicit"

    def properties(self, system):
        only_of_vectors(system)
        attitude = "none" if system.algebra is None else "integrated"
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude=attitude)

    def coefficients(self, number=float):
        one, zero = number(1), number(0)
        return co.methods.Coefficients(
            node=np.array([zero, one / 2, one]),
            scale=np.array([one, one, one]),
            mix=np.array([[zero, zero, zero], [one / 2, zero, zero], [-one, 2 * one, zero]]),
            out=np.array([one / 6, 2 * one / 3, one / 6]),
        )


@dataclasses.dataclass(frozen=True)
class Flows(co.methods.FlowMethod):
    """McLachlan's symmetric splitting of order 2 with the smallest error."""

    parts: str = "auto"

    order, explicit, symmetric = 2, True, True

    def properties(self, system):
        return co.Splitting().properties(system)

    def sweeps(self, number=float):
        a, half, there, end = number("0.1931833275037836"), number(1) / 2, number(0), number(1)
        return [
            co.methods.Sweep(True, a, there),
            co.methods.Sweep(False, half - a, half),
            co.methods.Sweep(True, half - a, half),
            co.methods.Sweep(False, a, end),
        ]


@dataclasses.dataclass(frozen=True)
class Compiled(co.methods.CompiledStepMethod):
    """Heun's method in C++; the second slope after `share` of the step."""

    share: float = 0.75

    order, explicit, symmetric = 2, True, False

    @property
    def compiled_step(self):
        return co.methods.compile_step(Path(__file__).parents[2] / "examples" / "heun.cpp")

    def properties(self, system):
        return only_of_vectors(system)

    def constants(self):
        return [], [self.share]

    def step(self, system, x, t, h):
        first = h * system.vector_field(x, t)
        second = h * system.vector_field(x + self.share * first, t + self.share * h)
        late = 0.5 / self.share
        return x + (1 - late) * first + late * second
