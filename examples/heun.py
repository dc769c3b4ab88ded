"""Heun's method in C++, `heun.cpp`, with a parameter (docs/own_schemes.md)."""

import dataclasses
from pathlib import Path

import coadjoint as co


@dataclasses.dataclass(frozen=True)
class Heun(co.methods.CompiledStepMethod):
    """Two slopes, the second after `share` of the step."""

    share: float = 1.0

    order, explicit, symmetric = 2, True, False

    @property
    def compiled_step(self):
        return co.methods.compile_step(Path(__file__).with_name("heun.cpp"))

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def constants(self):
        return [], [self.share]  # whole numbers, and coefficients

    def step(self, system, x, t, h):
        first = h * system.vector_field(x, t)
        second = h * system.vector_field(x + self.share * first, t + self.share * h)
        late = 0.5 / self.share
        return x + (1 - late) * first + late * second
