"""Base class of schemes with a step from state and time, which compositions repeat."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work

FULL_STEP = (1.0,)


class SteppedMethod(Method):
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

    def tangent_loop_of_substeps(
        self, system: System, h: float, frame: Frame, fractions: Sequence[float]
    ) -> CompiledLoop | None:
        """Return the loop with tangent vectors, or None; see `tangent_loop` and `loop_of_substeps`."""
        return None

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return the loop without substeps, with tangent vectors."""
        return self.tangent_loop_of_substeps(system, h, frame, FULL_STEP)

    def work(self, system: System, group: Representation = None) -> Work:
        return self.work_of_substeps(system, group, 1)

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return `step` evaluated in formal series: it must consist of sums, products and quotients."""
        from coadjoint.methods.formal.formal_numbers import vector

        return vector(map(type(h), self.step(system, x, 0 * h, h)))

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative, by complex steps or differences."""
        from coadjoint.methods.protocol.step_derivatives import derivative_of

        result = derivative_of(lambda y: self.step(system, y, t, h), np.asarray(x, dtype=np.float64))
        return result.value, result.derivative

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        from coadjoint.methods.protocol.step_derivatives import derivative_of

        if type(self).tangent is not SteppedMethod.tangent:
            return "formula"
        return derivative_of(lambda y: self.step(system, y, t, h), np.asarray(x, dtype=np.float64)).by

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the scheme whose step consists of these substeps."""
        from coadjoint.methods.protocol.composed import Substeps

        return Substeps(self, tuple(coefficients))
