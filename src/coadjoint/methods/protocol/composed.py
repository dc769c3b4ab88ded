"""A scheme at several fractions of a step: common base, and one class for each family."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.free_algebra import Series, exponential, product, unit_series
from coadjoint.methods.formal.formal_numbers import is_short
from coadjoint.methods.protocol.composing import Composable
from coadjoint.methods.protocol.derivatives import CompiledDerivatives, DerivativeTables
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.formal_step import FormalStep, with_formal_step
from coadjoint.methods.protocol.linearized import JoinedSteps, Linearized, LinearizedStep, linearized
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.restored import RestoresInvariants, restored
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.methods.protocol.substep_method import SubstepMethod
from coadjoint.methods.protocol.tangents import CompiledTangents
from coadjoint.methods.protocol.wrapper import Wrapper
from coadjoint.program.sweeps import Sweep
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tables.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.systems.energy_derivatives import EnergyDerivative

MAX_ORDER = 12  # highest order that is tested, unless that of the base is higher


class Composed(Wrapper):
    """A base scheme at fractions of the step; it preserves what the base preserves."""

    base: Method
    coefficients: tuple[float, ...]

    @property
    def order(self) -> int:
        """The order, from the order conditions in the free associative algebra."""
        return composition_order(self.coefficients, self.base.order)

    @property
    def symmetric(self) -> bool:
        """Whether the base is symmetric and the coefficients are a palindrome."""
        return self.base.symmetric and self.coefficients == self.coefficients[::-1]

    @property
    def fractions(self) -> tuple[float, ...]:
        """Fractions of all substeps, with compositions in the base multiplied out."""
        return tuple(c * f for c in self.coefficients for f in self.base.fractions)

    @property
    def known_to(self) -> float:
        """The error of the base or of the fractions, whichever is larger; short fractions are exact."""
        fraction_error = 0.0 if all(map(is_short, self.coefficients)) else UNIT_ROUNDOFF
        return max(fraction_error, with_formal_step(self.base).known_to)

    def properties(self, system: System) -> Properties:
        """Return the properties of the base, which a composition shares."""
        return self.base.properties(system)


class FlowsOfBase(Wrapper, FlowMethod):
    """A flow method with the parts of another one."""

    base: FlowMethod

    @property
    def parts(self) -> Any:
        """Those of the base."""
        return self.base.parts

    @property
    def compensated(self) -> bool | None:
        """As for the base."""
        return self.base.compensated

    @property
    def rotation(self) -> str:
        """As for the base."""
        return self.base.rotation


@dataclass(frozen=True)
class ComposedFlows(Composed, FlowsOfBase):
    """The flows of all substeps, as one table."""

    offered = False

    base: FlowMethod
    coefficients: tuple[float, ...]

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the base, scaled and shifted."""
        inner = self.base.sweeps(number)
        result, elapsed = [], number(0)
        for coefficient in map(number, self.coefficients):
            result += [
                Sweep(forward, coefficient * fraction, elapsed + coefficient * moment, turn)
                for forward, fraction, moment, turn in inner
            ]
            elapsed = elapsed + coefficient
        return result


@dataclass(frozen=True)
class Substeps(Composed, FormalStep, CompiledTangents, CompiledDerivatives, Linearized, Composable, RestoresInvariants):
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
        base = self.base
        return (
            base.tangent_loop_of_substeps(system, h, frame, self.coefficients)
            if isinstance(base, RungeKuttaMethod)
            else None
        )

    @property
    def differentiable(self) -> bool:
        """As for the base."""
        return isinstance(self.base, RungeKuttaMethod) and self.base.differentiable

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables of the base with these substeps."""
        base = self.base
        assert isinstance(base, RungeKuttaMethod)
        return base.derivative_tables_of_substeps(system, h, representation, energies, self.coefficients)

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
        steps: list[LinearizedStep] = []
        for fraction in self.coefficients:
            steps.append(linearized(self.base, system, x, t, h * fraction))
            x, t = steps[-1].end, t + h * fraction
        return JoinedSteps(steps)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.base.work_of_substeps(system, group, len(self.coefficients))

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the restored invariants of the base."""
        return restored(self.base, system)


def composition_order(coefficients: Sequence[float], base_order: int) -> int:
    """Return the order of a composition of a symmetric map of even order p, up to max(12, p).

    The base is exp(h Y_1 + h^(p+1) Y_(p+1) + h^(p+3) Y_(p+3) + ...) in the free associative algebra of the Y's; the
    product is compared with exp(h Y_1) word by word.
    """
    highest = max(MAX_ORDER, base_order)
    letters = [1, *range(base_order + 1, highest + 1, 2)]

    def exponential_of(coefficients: dict[int, float]) -> Series:
        return exponential([{(d,): coefficients[d]} if d in coefficients else {} for d in range(highest + 1)])

    composed = unit_series(highest)
    for c in coefficients:
        composed = product(composed, exponential_of({d: c**d for d in letters}))
    exact = exponential_of({1: 1.0})
    scale = max(1.0, max(map(abs, coefficients)))
    for order in range(base_order + 1, highest + 1):
        words = composed[order].keys() | exact[order].keys()
        # Rounding of the coefficients changes a condition by u times the sum of its terms.
        tolerance = UNIT_ROUNDOFF * 8 * len(coefficients) * scale**order
        if any(abs(composed[order].get(word, 0.0) - exact[order].get(word, 0.0)) > tolerance for word in words):
            return order - 1
    return highest
