"""Flow methods: schemes that consist of exact flows of parts of the Hamiltonian, compiled to a table of rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.formal.formal_numbers import is_short
from coadjoint.methods.protocol.composing import Composable
from coadjoint.methods.protocol.derivatives import CompiledDerivatives, DerivativeTables
from coadjoint.methods.protocol.formal_step import FormalStep
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.tangents import CompiledTangents
from coadjoint.program.numbers import Number, precision_of
from coadjoint.program.sweeps import Sweep as Sweep  # re-exported by coadjoint.methods
from coadjoint.systems.protocol import has_structure_constants
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tables.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.program.interpreter import Interpreter
    from coadjoint.program.table import Program
    from coadjoint.systems.energy_derivatives import EnergyDerivative

COEFFICIENT_ERROR = 1e-38  # relative error of published coefficients, which have at least 40 digits
SUM_TOLERANCE = 2.0**-40  # relative to the sum of absolute coefficients of sweeps; allows coefficients of twelve digits


class FlowMethod(FormalStep, CompiledTangents, CompiledDerivatives, Composable):
    """A scheme that consists of exact flows of parts, given by their order and fractions of the step."""

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
        """As `compensated`, with None as False."""
        return bool(self.compensated)

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the flows of all substeps as one table, in which adjacent flows of the same part are merged."""
        from coadjoint.methods.protocol.composed import ComposedFlows

        return ComposedFlows(self, tuple(coefficients))

    def symmetrized(self) -> Method:
        """Return the sweeps of this scheme, followed by their mirror images."""
        from coadjoint.methods.symmetrized import PairOfFlows

        return PairOfFlows(self)

    def program(self, system: System, *, group: Representation = None, number: Number = float) -> Program:
        from coadjoint.program.table import build_program

        self.properties(system)
        if not has_structure_constants(system):
            raise ValueError(
                f"{type(self).__name__} is made of flows on a Lie algebra, which {system.name} does not have; "
                "take GaussLegendre"
            )
        coefficients = [sweep.coefficient for sweep in self.sweeps()]
        if not abs(sum(coefficients) - 1.0) <= SUM_TOLERANCE * sum(map(abs, coefficients)):
            raise ValueError(
                f"the coefficients of the sweeps of {self} add up to {sum(coefficients)!r}; they must add up to 1"
            )
        return build_program(system, self, group=group, number=number)

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        """Return the loop over the rows of the table."""
        return self._program_loop(self.program(system, group=representation), h)

    def _shared_loop(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        if type(self).loop is not Method.loop or type(self).compiled is not FlowMethod.compiled:
            return self.loop(system, h, representation)
        self._check_loop(system)
        return self._program_loop(self.program(system, group=representation), h, compact=representation is None)

    def _program_loop(self, program: Program, h: float, compact: bool = False) -> CompiledLoop:
        from coadjoint.kernels.loop import CompiledLoop
        from coadjoint.kernels.tables.flow import FLOW_LOOP, flow_tables

        tables = flow_tables(program, h, bool(self.compensated), compact)
        return CompiledLoop(FLOW_LOOP, tables.tables, tables.keepalive, program.shift, parts=program.parts)

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop:
        """Return the loop over the rows of the table, with tangent vectors."""
        from coadjoint.kernels.tables.tangents import check_differentiable, with_tangents

        check_differentiable(system)
        program = self.program(system)
        return with_tangents(self._program_loop(program, h), system, program.functions, frame)

    @property
    def differentiable(self) -> bool:
        """Whether the table contains only the parts of the Hamiltonian."""
        return type(self).program is FlowMethod.program

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables of flows and of their transposes."""
        from coadjoint.methods.protocol.flow_derivatives import flow_derivatives

        self.properties(system)
        assert has_structure_constants(system)
        return flow_derivatives(self, system, h, representation, energies)

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        point = np.asarray(x)
        number: Number = float if point.dtype != object else type(point[0])
        return _interpreter_of(self, system, number).steps(point, number(h), 1, t0=number(t))

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        from coadjoint.program.interpreter import Interpreter

        return Interpreter(self.program(system, number=Fraction), number=type(h)).steps(x, h, 1, t0=0 * h)

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

        return work_of_flows(self.program(system, group=group), bool(self.compensated))

    def with_compensation(self) -> Method | None:
        """Return the same scheme with compensated sums, if that choice was left open; else None."""
        return None


def flows_of(method: Method) -> FlowMethod:
    """Return a scheme as one of flows; raise TypeError if it does not consist of flows."""
    form = method.expanded
    if not isinstance(form, FlowMethod):
        raise TypeError(f"{method} is not made of exact flows, so it has no program; Splitting has one")
    return form


def _interpreter_of(method: FlowMethod, system: System, number: Number) -> Interpreter:
    return _cached_interpreter(method, system, number, precision_of(number))


@lru_cache(maxsize=8)
def _cached_interpreter(method: FlowMethod, system: System, number: Number, precision: int | None) -> Interpreter:
    from coadjoint.program.interpreter import Interpreter

    return Interpreter(method.program(system, number=number))
