"""Base class of schemes with a step in C++, which are neither compositions of flows nor Runge-Kutta methods."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from coadjoint.methods.protocol.method import Representation
from coadjoint.methods.protocol.substep_method import SubstepMethod
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.methods.protocol.cost_model import Operations, Work


class CompiledStepMethod(SubstepMethod):
    """A scheme with a step in C++, and the same step in NumPy.

    The C++ file derives from ``StepScheme`` of ``steps/step_scheme.hpp``, which documents its inputs. It is in the
    folder of the Python file of the scheme, or anywhere else if it is compiled by `compile_step`.
    """

    @property
    @abstractmethod
    def compiled_step(self) -> Any:
        """Name that a C++ file of the library gives to its step by ``STEP_SCHEME``, or the result of `compile_step`."""

    def constants(self) -> tuple[Sequence[int], Sequence[float]]:
        """Return the integers and the coefficients that the compiled step reads; none by default.

        Returns
        -------
        integers, numbers : sequences
        """
        return [], []

    def operations(self, system: System) -> Operations | None:
        """Return the operations of a step; None for a scheme that iterates, whose work is counted in evaluations.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        Operations or None
        """
        return None

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        """Return the loop over steps of this kind."""
        from coadjoint.kernels.loop import CompiledLoop, scheme_memory
        from coadjoint.kernels.tables.steps import STEP_LOOP, step_tables

        tables = step_tables(system, self, representation, fractions)
        memory = scheme_memory(STEP_LOOP, tables.tables)
        return CompiledLoop(STEP_LOOP, tables.tables, tables.keepalive, memory=memory, sources=tables.sources)

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the work of the operations of a step, or of its iterations."""
        from coadjoint.methods.protocol.cost_model import work_of_iterations, work_of_operations

        operations = self.operations(system)
        return work_of_iterations(system, group) if operations is None else work_of_operations(operations, substeps)
