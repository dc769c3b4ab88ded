"""Base class of schemes with a step from state and time, and their compositions, which repeat it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.wrapper import Composed
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tables.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.methods.protocol.derivative_tables import DerivativeTables
    from coadjoint.methods.protocol.step_derivatives import LinearizedStep
    from coadjoint.systems.energy_derivatives import EnergyDerivative

FULL_STEP = (1.0,)  # fractions of a step that is not composed


class SubstepMethod(Method):
    """A scheme with a step from a state; its loop supports arbitrary substeps of a step."""

    @abstractmethod
    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        """Return the compiled loop; `fractions` are the lengths of the substeps in units of the step."""

    @abstractmethod
    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the work of a step of this many substeps; iterations and evaluations are those of all substeps."""

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        """Return the loop without substeps."""
        return self.loop_of_substeps(system, h, representation, FULL_STEP)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.work_of_substeps(system, group, 1)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return the loop without substeps, with tangent vectors."""
        return self.tangent_loop_of_substeps(system, h, frame, FULL_STEP)

    def tangent_loop_of_substeps(
        self, system: System, h: float, frame: Frame, fractions: Sequence[float]
    ) -> CompiledLoop | None:
        """Return the loop with substeps that carries tangent vectors; None if there is none."""
        return None

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables without substeps."""
        return self.derivative_tables_of_substeps(system, h, representation, energies, FULL_STEP)

    def derivative_tables_of_substeps(
        self,
        system: System,
        h: float,
        representation: Representation,
        energies: Mapping[str, EnergyDerivative],
        fractions: Sequence[float],
    ) -> DerivativeTables:
        """Return the tables of a `differentiable` scheme, with substeps of these fractions of the step."""
        return super().derivative_tables(system, h, representation, energies)

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return `step` evaluated in formal series: it must consist of sums, products and quotients."""
        from coadjoint.methods.formal.formal_numbers import vector

        return vector(map(type(h), self.step(system, x, 0 * h, h)))

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the scheme whose step consists of these substeps."""
        return Substeps(self, tuple(coefficients))


@dataclass(frozen=True)
class Substeps(Composed):
    """The step of the base, repeated at each fraction."""

    offered = False

    base: SubstepMethod
    coefficients: tuple[float, ...]

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return substeps with the products of both sets of fractions."""
        return Substeps(self.base, tuple(c * f for c in coefficients for f in self.coefficients))

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        """Return the loop of the base, with its substeps."""
        return self.base.loop_of_substeps(system, h, representation, self.coefficients)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return the loop of the base with these substeps."""
        return self.base.tangent_loop_of_substeps(system, h, frame, self.coefficients)

    @property
    def differentiable(self) -> bool:
        """As for the base."""
        return self.base.differentiable

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables of the base with these substeps."""
        return self.base.derivative_tables_of_substeps(system, h, representation, energies, self.coefficients)

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        number = type(h)
        for fraction in map(number, self.coefficients):
            x, t = self.base.step(system, x, t, h * fraction), t + h * fraction
        return x

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        for fraction in self.coefficients:
            x = self.base.formal_step(system, x, h * fraction)
        return x

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        product = np.eye(len(x))
        for fraction in self.coefficients:
            x, derivative = self.base.tangent(system, x, t, h * fraction)
            product, t = derivative @ product, t + h * fraction
        return x, product

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        """Return the substeps with their derivatives."""
        from coadjoint.methods.protocol.step_derivatives import JoinedSteps

        steps: list[LinearizedStep] = []
        for fraction in self.coefficients:
            steps.append(self.base.linearized(system, x, t, h * fraction))
            x, t = steps[-1].end, t + h * fraction
        return JoinedSteps(steps)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.base.work_of_substeps(system, group, len(self.coefficients))

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the restored invariants of the base."""
        return self.base.restored(system)

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        """As for the base."""
        return self.base.took_newton(memory)
