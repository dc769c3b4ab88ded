"""A scheme at several fractions of a step: common base, and one class for each family."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.formal.formal_numbers import is_short
from coadjoint.methods.formal.order_conditions import composition_order
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.stepped_method import SteppedMethod
from coadjoint.program.sweeps import Sweep
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work


class WithBase(Method):
    """A scheme with the failure messages and the largest dimension of its base."""

    base: Method

    @property
    def failures(self) -> Mapping[str, str]:  # type: ignore[override]
        """Those of the base."""
        return self.base.failures

    @property
    def largest(self) -> float:  # type: ignore[override]
        """As for the base."""
        return self.base.largest


class Composed(WithBase):
    """A base scheme at fractions of the step; it keeps what the base keeps."""

    base: Method
    coefficients: tuple[float, ...]

    @property
    def order(self) -> int:
        """The order, from the order conditions in the free associative algebra."""
        return composition_order(self.coefficients, self.base.order)

    @property
    def explicit(self) -> bool:
        """As for the base."""
        return self.base.explicit

    @property
    def symmetric(self) -> bool:
        """Whether the base is symmetric and the coefficients are a palindrome."""
        return self.base.symmetric and self.coefficients == self.coefficients[::-1]

    @property
    def compensates(self) -> bool:  # type: ignore[override]
        """As for the base."""
        return self.base.compensates

    @property
    def fractions(self) -> tuple[float, ...]:
        """Fractions of all substeps, with compositions in the base multiplied out."""
        return tuple(c * f for c in self.coefficients for f in self.base.fractions)

    @property
    def known_to(self) -> float:
        """The larger of two errors: that of the base, and that of the fractions, which are exact if they are short."""
        own = 0.0 if all(map(is_short, self.coefficients)) else UNIT_ROUNDOFF
        return max(own, self.base.known_to)

    def properties(self, system: System) -> Properties:
        """Return the properties of the base, which a composition shares."""
        return self.base.properties(system)

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return those of the base."""
        return self.base.restored(system)

    def settled(self, system: System, coordinates: Sequence[int]) -> Method:
        """Return the composition of the settled base."""
        return with_settled_base(self, system, coordinates)

    def with_compensation(self) -> Method | None:
        """Return the composition of the compensated base."""
        return with_compensated_base(self)


def with_compensated_base(method: Any) -> Any:
    """Return a scheme, a dataclass, with its base compensated; None if the base has no such choice left."""
    base = method.base.with_compensation()
    return None if base is None else replace(method, base=base)


def with_settled_base(method: Any, system: System, coordinates: Sequence[int]) -> Any:
    """Return a scheme, a dataclass, with the automatic choices of its base for a system fixed."""
    base = method.base.settled(system, coordinates)
    return method if base is method.base else replace(method, base=base)


class FlowsOfBase(WithBase, FlowMethod):
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

    def settled(self, system: System, coordinates: Sequence[int]) -> Method:
        """Return the flows of the settled base."""
        return with_settled_base(self, system, coordinates)

    def with_compensation(self) -> Method | None:
        """Return the flows of the compensated base."""
        return with_compensated_base(self)


@dataclass(frozen=True)
class ComposedFlows(Composed, FlowsOfBase):
    """The flows of all substeps, as one table."""

    offered = False

    base: FlowMethod
    coefficients: tuple[float, ...]

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the base, scaled and shifted."""
        inner = self.base.sweeps(number)
        result, passed = [], number(0)
        for coefficient in map(number, self.coefficients):
            result += [
                Sweep(forward, coefficient * fraction, passed + coefficient * moment, turn)
                for forward, fraction, moment, turn in inner
            ]
            passed = passed + coefficient
        return result


@dataclass(frozen=True)
class Substeps(Composed):
    """The step of the base, repeated at each fraction."""

    offered = False

    base: SteppedMethod
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
            x, own = self.base.tangent(system, x, t, h * fraction)
            product, t = own @ product, t + h * fraction
        return x, product

    def work(self, system: System, group: Representation = None) -> Work:
        return self.base.work_of_substeps(system, group, len(self.coefficients))

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        """Return whether the base needed Newton's method."""
        return self.base.took_newton(memory)
