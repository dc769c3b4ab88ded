"""The Gauss method in C++, `gauss.cpp`: an implicit scheme of your own (docs/own_schemes.md)."""

import dataclasses
from pathlib import Path

import coadjoint as co


@dataclasses.dataclass(frozen=True)
class Gauss(co.methods.CompiledStepMethod):
    """The Gauss method with `stages` stages."""

    stages: int = 1

    explicit, symmetric = False, True

    @property
    def order(self):
        return 2 * self.stages

    @property
    def compiled_step(self):
        return co.methods.compile_step(Path(__file__).with_name("gauss.cpp"))

    def properties(self, system):
        energy = isinstance(system.hamiltonian, co.Quadratic)
        return co.methods.Properties(poisson=False, energy=energy, casimirs="quadratic", attitude="none")

    def tableau(self, number=float):
        return co.methods.gauss_tableau(self.stages, number)

    def constants(self):
        return [self.stages], [number for part in self.tableau() for number in part.ravel()]

    def step(self, system, x, t, h):
        step = co.methods.begin(self.tableau, system, x, t, h)
        return step.x + step.coefficients.out @ co.methods.iterate_to_stagnation(step, step.fields)
