"""Base class of schemes with a step from state and time, which compositions repeat."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from coadjoint.methods.protocol.composing import Composable
from coadjoint.methods.protocol.formal_step import FormalStep
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work

FULL_STEP = (1.0,)  # fractions of a step that is not composed


class SubstepMethod(FormalStep, Composable):
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

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return `step` evaluated in formal series: it must consist of sums, products and quotients."""
        from coadjoint.methods.formal.formal_numbers import vector

        return vector(map(type(h), self.step(system, x, 0 * h, h)))

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the scheme whose step consists of these substeps."""
        from coadjoint.methods.protocol.composed import Substeps

        return Substeps(self, tuple(coefficients))
