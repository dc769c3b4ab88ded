"""Step methods: a scheme of your own, written in Python as one function."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from coadjoint.methods.base import Representation
from coadjoint.methods.stepped import SteppedMethod
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.kinds import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.methods.work import Work


class StepMethod(SteppedMethod):
    """A scheme of your own whose step is one Python function.

    Derive from it, as a frozen dataclass whose fields are the parameters of the scheme. Set `order`, `explicit` and
    `symmetric`, and write `properties` and `step`. Then every run, stepper, composition and choice takes it. Where
    Numba is installed and can compile the step, it is compiled when a run begins, in a second or two. In compiled code
    the system offers ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``,
    ``jacobian(x, t)`` and of its ``hamiltonian`` ``value``, ``gradient`` and ``hessian``. Elsewhere the loop calls
    Python in each step, and says so once. `tangent` may be written as well; without it the derivative is found by
    complex steps where the step takes them, else by differences, with nine digits (`Stepper.tangent_by` says which).

    See Also
    --------
    CompiledStepMethod : a step in C++.

    Examples
    --------
    Kahan's method, for fields that are quadratic:

    >>> import dataclasses
    >>> import coadjoint as co
    >>> import numpy as np
    >>> @dataclasses.dataclass(frozen=True)
    ... class Kahan(co.methods.StepMethod):
    ...     order, explicit, symmetric = 2, False, True
    ...     def properties(self, system):
    ...         return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    ...     def step(self, system, x, t, h):
    ...         matrix = np.eye(len(x)) - h / 2 * system.jacobian(x, t)
    ...         return x + np.linalg.solve(matrix, h * system.vector_field(x, t))
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 10), step=0.01, method=Kahan())
    >>> bool(sol.drift()["energy"] < 1e-4)
    True
    """

    failures: ClassVar[Mapping[str, str]] = {
        "UNDEFINED": "the step failed, or did not return one finite number for each coordinate"
    }
    compensates: ClassVar[bool] = False
    known_to = UNIT_ROUNDOFF

    compiles: ClassVar[bool] = True
    """Whether Numba is asked to compile the step; where not, each step is a call of Python, and nothing is said."""

    @abstractmethod
    def step(self, system: System, x: Any, t: Any, h: Any) -> Any: ...

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        """Return the loop over steps that are functions; they move the momentum alone."""
        if representation is not None:
            raise ValueError(
                f"{type(self).__name__} is a StepMethod, whose steps carry no group element, though its properties say "
                f'attitude="{self.properties(system).attitude}"; they must say "none"'
            )
        from coadjoint.kernels.loop import CompiledLoop
        from coadjoint.kernels.step_functions import StepFunction
        from coadjoint.kernels.step_tables import function_tables
        from coadjoint.kernels.stepping import STEP_LOOP

        function = StepFunction(self, system)
        found = function_tables(system, function.address, fractions)
        return CompiledLoop(STEP_LOOP, found.tables, (*found.keep, function))

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the estimated work of a step: as many evaluations of the field as its order."""
        from coadjoint.methods.work import work_of_evaluations

        return work_of_evaluations(system, substeps * self.order, self.explicit)
