"""Flow methods: schemes that consist of exact flows of parts of the Hamiltonian, compiled to a table of rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.compiled import unrecorded
from coadjoint.methods.protocol.composed import Composed, Wrapper
from coadjoint.methods.protocol.method import Method, Representation, is_short
from coadjoint.program.generators import NotSplittable
from coadjoint.program.numbers import Number, precision_of
from coadjoint.program.parts.decompose import (
    BODY_FLOW_CHOICES,
    ChosenParts,
    check_body_flow_inputs,
    decompose,
)
from coadjoint.program.sweeps import Sweep as Sweep  # re-exported by coadjoint.methods
from coadjoint.shortcuts import of
from coadjoint.systems.coefficients import linear_of, with_placeholders
from coadjoint.systems.hamiltonians.terms import MAX_COORDINATES
from coadjoint.systems.system import System
from coadjoint.validation import read_bool, read_choice, read_integer, read_list

if TYPE_CHECKING:
    from coadjoint.kernels.tables.derivatives import Frame
    from coadjoint.methods.numerics.formal_series import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.methods.protocol.derivative_tables import DerivativeTables
    from coadjoint.program.interpreter import Interpreter
    from coadjoint.program.table import FlowTable
    from coadjoint.systems.energy_derivatives import EnergyDerivative
    from coadjoint.systems.system_stacks import SystemStack

COEFFICIENT_ERROR = 1e-38  # relative error of published coefficients, which have at least 40 digits
SUM_TOLERANCE = 2.0**-40  # relative to the sum of absolute coefficients of sweeps; allows coefficients of twelve digits


class FlowMethod(Method):
    """A scheme that consists of exact flows of parts, given by their order and fractions of the step."""

    def __post_init__(self) -> None:
        """Validate `parts`, `compensated` and `rotation` where they are fields of the dataclass."""
        for field in fields(cast(Any, self)):
            value = getattr(self, field.name)
            if field.name == "compensated" and value is not None:
                object.__setattr__(self, field.name, read_bool(value, field.name))
            elif field.name == "rotation":
                read_choice(value, field.name, ("exact", "rational"))
            elif field.name == "parts":
                object.__setattr__(self, field.name, _read_parts(value))
        if self.rotation == "rational" and self.parts in BODY_FLOW_CHOICES:
            raise ValueError(f'parts="{self.parts}" has no rational rotations; take rotation="exact"')

    @property
    def parts(self) -> Any:
        """How the Hamiltonian is split: "auto", "coordinates", or sets of coordinates."""
        return "auto"

    @property
    def compensated(self) -> bool | None:
        """Whether the momentum is summed with compensation; None means no."""
        return None

    @property
    def rotation(self) -> str:
        """Rotations by the angle itself ("exact"), or with tan(angle/2) replaced by half the angle ("rational")."""
        return "exact"

    @abstractmethod
    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step, first to last, with coefficients in the given number type."""

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a step P K P^-1 with `sweeps` as the kernel K; none by default."""
        return ()

    @property
    def compensates(self) -> bool:  # type: ignore[override]
        return bool(self.compensated)

    def composed(self, coefficients: Sequence[float]) -> Method:
        return ComposedFlows(self, tuple(coefficients))

    def symmetrized(self) -> Method:
        """Return the sweeps of this scheme, followed by their mirror images."""
        return PairOfFlows(self)

    def flow_table(self, system: System, *, group: Representation = None, number: Number = float) -> FlowTable:
        from coadjoint.program.table import build_flow_table

        self.properties(system)
        if not system.has_structure_constants:
            raise ValueError(
                f"{type(self).__name__} is made of flows on a Lie algebra, which {system.name} does not have; "
                "take GaussLegendre"
            )
        coefficients = [sweep.coefficient for sweep in self.sweeps()]
        if not abs(sum(coefficients) - 1.0) <= SUM_TOLERANCE * sum(map(abs, coefficients)):
            raise ValueError(
                f"the coefficients of the sweeps of {self} add up to {sum(coefficients)!r}; they must add up to 1"
            )
        return build_flow_table(cast(Any, system), self, group=group, number=number)

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        return self._flow_loop(self.flow_table(system, group=representation), h)

    def _shared_loop(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        if type(self).loop is not Method.loop or type(self).compiled is not FlowMethod.compiled:
            return self.loop(system, h, representation)
        self._check_loop(system)
        return self._flow_loop(self.flow_table(system, group=representation), h, compact=representation is None)

    def _flow_loop(self, flow_table: FlowTable, h: float, compact: bool = False) -> CompiledLoop:
        from coadjoint.kernels.tables.flow import FLOW_LOOP, flow_tables

        tables = flow_tables(flow_table, h, bool(self.compensated), compact)
        sources = tables.sources if self.differentiates(flow_table.system) else unrecorded
        return CompiledLoop(tables.tables, tables.keepalive, sources, name=FLOW_LOOP, shift=flow_table.shift)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop:
        from coadjoint.kernels.tables.derivatives import check_differentiable, with_tangents

        check_differentiable(system)
        flow_table = self.flow_table(system)
        return with_tangents(self._flow_loop(flow_table, h), system, flow_table.functions, frame)

    def differentiates(self, system: System) -> bool:
        """Whether the table contains only the parts of the Hamiltonian."""
        return type(self).flow_table is FlowMethod.flow_table

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        from coadjoint.methods.protocol.derivative_tables import flow_derivatives

        self.properties(system)
        return flow_derivatives(self, cast(Any, system), h, representation, energies)

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        point = np.asarray(x)
        number: Number = float if point.dtype != object else type(point[0])
        return _interpreter_of(self, system, number).steps(point, number(h), 1, t0=number(t))

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        from coadjoint.program.interpreter import Interpreter

        return Interpreter(self.flow_table(system, number=Fraction), number=type(h)).steps(x, h, 1, t0=0 * h)

    @property
    def known_to(self) -> float:
        """Zero if all coefficients are short fractions, else the rounding error of the published coefficients."""
        sweeps = [*self.sweeps(Fraction), *self.processor(Fraction)]
        return 0.0 if all(is_short(sweep.coefficient) for sweep in sweeps) else COEFFICIENT_ERROR

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        return self._step_with_vectors(system, x, t, h, np.eye(len(x)))

    def tangent_on(self, system: System, x: Any, t: float, h: float, vectors: NDArray[Any]) -> NDArray[Any]:
        """Return the derivative of a step applied to tangent vectors (n, k), without the whole derivative."""
        return self._step_with_vectors(system, x, t, h, vectors)[1]

    def _step_with_vectors(
        self, system: System, x: Any, t: float, h: float, vectors: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        point = np.asarray(x, dtype=np.float64)
        try:
            after, carried = _interpreter_of(self, system, float).steps(point, h, 1, t0=t, tangent=vectors)
        except (OverflowError, ValueError) as error:  # sines of infinities
            message = f"in step 1, at t = {t:g}, a number overflowed; take a smaller step than {abs(h):g}"
            raise IntegrationError(message, step=1, time=t, residual=float("nan")) from error
        return after, carried

    def work(self, system: System, group: Representation = None) -> Work:
        """Return the work of the rows of a step, by the blocks that they rotate."""
        from coadjoint.methods.protocol.cost_model import work_of_flows

        return work_of_flows(self.flow_table(system, group=group), bool(self.compensated))

    def settled(self, systems: Sequence[Any], coordinates: Sequence[int]) -> Method:
        """Return the scheme with the automatic parts of systems fixed; it needs a field `parts`.

        Where they differ between systems, each has those for the linear coefficients of the first one.
        """
        if self.parts in BODY_FLOW_CHOICES:
            for system in systems:
                check_body_flow_inputs(system, self.parts, coordinates)
        automatic = isinstance(self.parts, ChosenParts) or self.parts == "auto"
        if not automatic or not systems[0].has_structure_constants:
            return self
        if not is_dataclass(self) or all(field.name != "parts" for field in fields(self)):
            raise TypeError(f"{self} has no field `parts`, so that automatic parts cannot be fixed; give it this field")
        extended = [with_placeholders(system, coordinates) for system in systems]
        decided = set[int]()
        found: ChosenParts | None = None
        for stack in self.split_jointly(extended):
            if np.all(stack.factors == stack.factors[:, :1]):  # the choice is that of the first one
                decided.update(stack.numbers[1:].tolist())
        for k, system in enumerate(extended):
            self.properties(system)
            try:
                choice = found if found and k in decided else decompose(system, self.parts).choice
            except NotSplittable:
                return self  # the loop raises the error for a Hamiltonian that does not split
            found = found or choice
            if choice != found and getattr(self.parts, "linear", ()) == tuple(coordinates):
                return self  # with the coefficients for which they were chosen before
            if choice != found:
                at = linear_of(systems[0].hamiltonian)[list(coordinates)]
                return replace(self, parts=ChosenParts(linear=tuple(coordinates), at=tuple(at.tolist())))
        assert found is not None
        return replace(self, parts=replace(found, linear=tuple(coordinates)))

    def split_jointly(self, systems: Sequence[Any]) -> list[SystemStack]:
        from coadjoint.program.parts.joint_choice import joint_choices

        found: list[SystemStack] = []
        for stack in super().split_jointly(systems) if self.differentiates(systems[0]) else []:
            # Hamiltonians that do not split, and their functions, raise later, with the number of the member.
            with suppress(ArithmeticError, TypeError, ValueError):
                found += joint_choices(stack, self.parts)
        return found


def _read_parts(parts: Any) -> Any:
    """Validate parts as a field: a choice by name, `ChosenParts` or a mapping with them, or sets of coordinates."""
    if isinstance(parts, str):
        read_choice(parts, "choice of parts", ("auto", "coordinates", *BODY_FLOW_CHOICES))
        return parts
    if isinstance(parts, Mapping):
        return ChosenParts.from_mapping(parts)
    return parts if isinstance(parts, ChosenParts) else _sets_of_coordinates(parts)


def _sets_of_coordinates(parts: Any) -> tuple[tuple[int, ...], ...]:
    rule = "it must be 'auto', 'coordinates', 'free_body', 'bonds', or sets of coordinates such as [[0, 1], [2]]"
    groups = [read_list(group, "a set of parts", rule) for group in read_list(parts, "parts", rule)]
    sets = tuple(tuple(read_integer(i, "a coordinate in parts", 0, MAX_COORDINATES) for i in group) for group in groups)
    seen: set[int] = set()
    for i in (i for group in sets for i in group):
        if i in seen:
            raise ValueError(f"parts name coordinate {i} more than once")
        seen.add(i)
    return sets


@dataclass(frozen=True)
class ComposedFlows(Composed, FlowMethod):
    """The flows of all substeps, as one table."""

    offered = False

    base: FlowMethod
    coefficients: tuple[float, ...]

    parts = of("base.parts")
    compensated = of("base.compensated")
    rotation = of("base.rotation")

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
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
class PairOfFlows(Wrapper, FlowMethod):
    """The sweeps of a scheme over half a step, then in reverse over the other half."""

    offered = False
    explicit = True
    symmetric = True

    base: FlowMethod

    parts = of("base.parts")
    compensated = of("base.compensated")
    rotation = of("base.rotation")
    properties = of("base.properties")

    def __post_init__(self) -> None:
        if len(self.base.processor()):
            raise TypeError(f"{self.base} has a processor, so its adjoint is not a list of sweeps; take another scheme")

    @property
    def order(self) -> int:
        return self.base.order + self.base.order % 2

    def with_compensation(self) -> Method | None:
        return self._with_compensated_base()

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the base and their mirror images; times are mirrored too."""
        sweeps = list(self.base.sweeps(number))
        first_half = [Sweep(forward, c / 2, moment / 2, turn) for forward, c, moment, turn in sweeps]
        # `turn` marks the second sweep of a pair, which is the first in the mirror image.
        turns = [sweeps[-1].forward, *(sweep.turn for sweep in reversed(sweeps[1:]))]
        second_half = [
            Sweep(not forward, c / 2, 1 - moment / 2, turn)
            for (forward, c, moment, _), turn in zip(reversed(sweeps), turns, strict=True)
        ]
        return [*first_half, *second_half]


def _interpreter_of(method: FlowMethod, system: System, number: Number) -> Interpreter:
    return _cached_interpreter(method, system, number, precision_of(number))


@lru_cache(maxsize=8)
def _cached_interpreter(method: FlowMethod, system: System, number: Number, precision: int | None) -> Interpreter:
    from coadjoint.program.interpreter import Interpreter

    return Interpreter(method.flow_table(system, number=number))
