"""Base class of Runge-Kutta methods: the step and its exact derivative in NumPy, for any number type."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.methods.numerics.solvers import SOLVERS, Coefficients, Evaluation, StageProblem, begin, read_tableau
from coadjoint.methods.protocol.composed import SubstepMethod, Wrapper
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    from fractions import Fraction

    from coadjoint.kernels.tables.derivatives import Frame
    from coadjoint.methods.numerics.formal_series import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.methods.protocol.derivative_tables import DerivativeTables
    from coadjoint.systems.energy_derivatives import EnergyDerivative


class RungeKuttaMethod(SubstepMethod):
    """A user-defined Runge-Kutta scheme: a tableau, and a solver for its stages."""

    tables_of_any_step = True

    @property
    @abstractmethod
    def solver(self) -> str:
        """Solver for the slopes in the compiled loop.

        ``"explicit"``, ``"iterated"``, ``"implicit"``, or linear with ``"structure"`` or ``"gradient"`` frozen.
        """

    @property
    def function_iterations(self) -> int:
        """Number of function iterations before the output or the linear system; 0 if they converge."""
        return len(self.coefficients().node) - 1 if self.solver == "explicit" else 0

    def forecast(self, ratio: float) -> NDArray[np.float64]:
        """Return E (s, s) of the initial guess X_i = x + sum_j E_ij L_j, L the slopes of the previous substep.

        The substep is `ratio` times as long as the previous one. Zero unless overridden; for implicit schemes only.
        """
        return np.zeros_like(self.coefficients().mix)

    @abstractmethod
    def coefficients(self, number: Number = float) -> Coefficients:
        """Return the tableau.

        Parameters
        ----------
        number : callable
            Number type.

        Returns
        -------
        Coefficients
        """

    @property
    def collocation(self) -> Sequence[Fraction] | None:
        """For a collocation method, the rational polynomial whose roots are the nodes, lowest power first."""
        return None

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        from coadjoint.methods.numerics.formal_series import StagesOfCollocation, formal_end

        self.properties(system)
        if not self._as_written:
            return super().formal_step(system, x, h)
        nodes, solver = self.collocation, read_choice(self.solver, "solver", SOLVERS)
        stages = (
            begin(lambda _: self._rational[0], system, x, 0, h)
            if nodes is None
            else StagesOfCollocation(nodes, system, x, h)
        )
        return formal_end(stages, solver, self.function_iterations, h.count)

    @property
    def known_to(self) -> float:
        return 0.0 if self.collocation is not None else self._rational[1]

    @property
    def _rational(self) -> tuple[Coefficients, float]:
        """The tableau in fractions, and their relative error."""
        from coadjoint.methods.numerics.formal_series import rational_tableau

        return rational_tableau(self.coefficients)

    def symmetrized(self) -> Method:
        """Return the tableau of this scheme and its adjoint; not for solvers with a fixed number of iterations."""
        if self.solver not in ("explicit", "implicit") or not self._as_written:
            return super().symmetrized()
        return PairOfTableaux(self)

    @property
    def _as_written(self) -> bool:
        """Whether `step` and `evaluate` are not overridden."""
        return all(getattr(type(self), name) is getattr(RungeKuttaMethod, name) for name in ("step", "evaluate"))

    def evaluate(self, step: StageProblem, tangent: bool = False) -> Evaluation:
        """Return the slopes of a step by `solver`, with their derivatives if `tangent`."""
        return SOLVERS[read_choice(self.solver, "solver", SOLVERS)](step, self.function_iterations, tangent)

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        from coadjoint.kernels.tables.runge_kutta import RUNGE_KUTTA_LOOP, runge_kutta_tables

        read_choice(self.solver, "solver", SOLVERS)
        scheme = type(self).__name__
        forecast = np.shape(self.forecast(1.0)), read_tableau(self.coefficients(), self.solver, scheme).mix.shape
        if forecast[0] != forecast[1]:
            raise ValueError(f"forecast of {scheme} returned the shape {forecast[0]}; it must be {forecast[1]}")
        tables = runge_kutta_tables(system, self, representation, fractions)
        return loop_over(RUNGE_KUTTA_LOOP, tables)

    def tangent_loop_of_substeps(
        self, system: System, h: float, frame: Frame, fractions: Sequence[float]
    ) -> CompiledLoop:
        from coadjoint.kernels.tables.derivatives import check_differentiable, with_tangents
        from coadjoint.kernels.tables.field import terms_of_field

        check_differentiable(system)
        loop = self.loop_of_substeps(system, h, None, fractions)
        return with_tangents(loop, system, terms_of_field(system).functions, frame)

    def differentiates(self, system: System) -> bool:
        return self._as_written

    def derivative_tables_of_substeps(
        self,
        system: System,
        h: float,
        representation: Representation,
        energies: Mapping[str, EnergyDerivative],
        fractions: Sequence[float],
    ) -> DerivativeTables:
        from coadjoint.methods.protocol.derivative_tables import runge_kutta_derivatives

        self.properties(system)
        loop = self.loop_of_substeps(system, h, representation, fractions)
        return runge_kutta_derivatives(loop, system, energies)

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        return bool(np.any(memory[:, :1] > 0.0))

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        from coadjoint.methods.protocol.cost_model import work_of_iterations

        return work_of_iterations(system, group)

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, by the defining formulas, without compensation."""
        self.properties(system)
        step = begin(self.coefficients, system, x, t, h)
        return step.end(self.evaluate(step)[0])

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return one step and its exact derivative."""
        self.properties(system)
        step = begin(self.coefficients, system, np.asarray(x, dtype=np.float64), t, h)
        slopes, derivatives = self.evaluate(step, tangent=True)
        if derivatives is None:
            raise TypeError(f"{self} gives no derivatives")
        derivative = np.eye(step.x.size) + np.einsum("j,jab->ab", step.coefficients.out, derivatives)
        return step.end(slopes), derivative


@dataclass(frozen=True)
class PairOfTableaux(Wrapper, RungeKuttaMethod):
    """A Runge-Kutta method over half a step, then its adjoint, X_i = x + sum_j (out_j - mix_ij) L_j, over the other."""

    offered = False
    explicit = False
    symmetric = True

    base: RungeKuttaMethod

    @property
    def order(self) -> int:
        return self.base.order + self.base.order % 2

    @property
    def solver(self) -> str:
        return "implicit"

    def properties(self, system: System) -> Properties:
        declared = self.base.properties(system)
        return Properties(poisson=declared.poisson, energy=declared.energy, casimirs=declared.casimirs, attitude="none")

    def coefficients(self, number: Number = float) -> Coefficients:
        node, scale, mix, out = self.base.coefficients(number)
        s = len(node)
        both = np.concatenate([mix, 0 * mix], axis=1), np.concatenate([np.stack([out] * s), out - mix], axis=1)
        return Coefficients(
            np.concatenate([node / 2, 1 - node / 2]),
            np.concatenate([scale / 2, scale / 2]),
            np.concatenate(both),
            np.concatenate([out, out]),
        )
