"""Base classes of schemes around another scheme, of compositions, and of schemes with a step that these repeat."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.methods.protocol.method import Method, Representation, is_short
from coadjoint.program.numbers import full_precision
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.shortcuts import of
from coadjoint.systems.step_derivatives import LinearizedStep, joined_steps
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.kernels.tables.derivatives import Frame
    from coadjoint.methods.numerics.formal_series import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.methods.protocol.derivative_tables import DerivativeTables
    from coadjoint.systems.energy_derivatives import EnergyDerivative

FULL_STEP = (1.0,)  # fractions of a step that is not composed
MAX_ORDER = 12  # highest order of a composition that is tested, unless that of the base is higher


class Wrapper(Method):
    """A scheme with the attributes of its base, except for those that it overrides."""

    base: Method

    order = of("base.order")
    explicit = of("base.explicit")
    symmetric = of("base.symmetric")
    compensates = of("base.compensates")
    failures = of("base.failures")
    largest = of("base.largest")
    split_jointly = of("base.split_jointly")

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        own = type(self).tangent is not Method.tangent
        return self.base.tangent_by(system, x, t, h) if own else super().tangent_by(system, x, t, h)

    def settled(self, systems: Sequence[Any], coordinates: Sequence[int]) -> Method:
        base = self.base.settled(systems, coordinates)
        return self if base is self.base else self._around(base)

    def _around(self, base: Method) -> Method:
        changed: Method = replace(self, base=base)  # type: ignore[type-var]
        return changed

    def _with_compensated_base(self) -> Method | None:
        base = self.base.with_compensation()
        return None if base is None else self._around(base)


class Composed(Wrapper):
    """A base scheme at fractions of the step; it preserves what the base preserves."""

    base: Method
    coefficients: tuple[float, ...]

    properties = of("base.properties")

    @property
    def order(self) -> int:
        return composition_order(self.coefficients, self.base.order)

    @property
    def symmetric(self) -> bool:
        return self.base.symmetric and self.coefficients == self.coefficients[::-1]

    @property
    def fractions(self) -> tuple[float, ...]:
        return tuple(c * f for c in self.coefficients for f in self.base.fractions)

    @property
    def known_to(self) -> float:
        """The error of the base or of the fractions, whichever is larger; short fractions are exact."""
        fraction_error = 0.0 if all(map(is_short, self.coefficients)) else UNIT_ROUNDOFF
        return max(fraction_error, self.base.known_to)

    def with_compensation(self) -> Method | None:
        return self._with_compensated_base()

    def matrix_products(
        self, system: System, steps: int, evaluations: int, iterations: int
    ) -> tuple[float, float] | None:
        return self.base.matrix_products(system, len(self.coefficients) * steps, evaluations, iterations)


def check_base(base: Any, wrapper: str, example: str) -> None:
    """Raise a TypeError if the base of a wrapper is not a scheme."""
    if not isinstance(base, Method):
        raise TypeError(f"the base of {wrapper} is a scheme such as {example}, not {short(base)}")


def composition_order(coefficients: Sequence[float], base_order: int) -> int:
    """Return the order of a composition of a symmetric map of even order p, up to max(12, p)."""
    # In the free algebra the product of exp(c h Y_1 + (c h)^(p+1) Y_(p+1) + ...) is compared with exp(h Y_1).
    from coadjoint.algebra.exact.free_algebra import Series, exponential, product, unit_series

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
        return self.loop_of_substeps(system, h, representation, FULL_STEP)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.work_of_substeps(system, group, 1)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        return self.tangent_loop_of_substeps(system, h, frame, FULL_STEP)

    def tangent_loop_of_substeps(
        self, system: System, h: float, frame: Frame, fractions: Sequence[float]
    ) -> CompiledLoop | None:
        """Return the loop with substeps that carries tangent vectors; None if there is none."""
        return None

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        return self.derivative_tables_of_substeps(system, h, representation, energies, FULL_STEP)

    def derivative_tables_of_substeps(
        self,
        system: System,
        h: float,
        representation: Representation,
        energies: Mapping[str, EnergyDerivative],
        fractions: Sequence[float],
    ) -> DerivativeTables:
        """Return the tables of loops that differentiate runs, with substeps of these fractions of the step."""
        return super().derivative_tables(system, h, representation, energies)

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return `step` evaluated in formal series: it must consist of sums, products and quotients."""
        from coadjoint.methods.numerics.formal_series import vector

        return vector(map(type(h), self.step(system, x, 0 * h, h)))

    def composed(self, coefficients: Sequence[float]) -> Method:
        return Substeps(self, tuple(coefficients))


@dataclass(frozen=True)
class Substeps(Composed):
    """The step of the base, repeated at each fraction."""

    offered = False

    base: SubstepMethod
    coefficients: tuple[float, ...]

    by_stages = of("base.by_stages")
    differentiates = of("base.differentiates")
    restored = of("base.restored")
    took_newton = of("base.took_newton")

    def composed(self, coefficients: Sequence[float]) -> Method:
        return Substeps(self.base, tuple(c * f for c in coefficients for f in self.coefficients))

    @property
    def stored_states(self) -> int:
        return len(self.coefficients) * self.base.stored_states

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        return self.base.loop_of_substeps(system, h, representation, self.coefficients)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        return self.base.tangent_loop_of_substeps(system, h, frame, self.coefficients)

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        return self.base.derivative_tables_of_substeps(system, h, representation, energies, self.coefficients)

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        x, h = np.array(x), full_precision(h)  # a step of the user may write into its state
        for fraction in map(type(h), self.coefficients):
            x, t = self.base.step(system, x, t, h * fraction), t + h * fraction
        return x

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        for fraction in self.coefficients:
            x = self.base.formal_step(system, x, h * fraction)
        return x

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        product = np.eye(system.dim)  # of coordinates, also for a matrix
        for fraction in self.coefficients:
            x, derivative = self.base.tangent(system, x, t, h * fraction)
            product, t = derivative @ product, t + h * fraction
        return x, product

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        steps: list[LinearizedStep] = []
        for fraction in self.coefficients:
            steps.append(self.base.linearized(system, x, t, h * fraction))
            x, t = steps[-1].end, t + h * fraction
        return joined_steps(steps)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.base.work_of_substeps(system, group, len(self.coefficients))
