"""Base classes of schemes with a step of their own: one Python function, or a step in C++."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coadjoint.kernels.functions.compiled_functions import step_function
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.steps import STEP_LOOP, function_tables, step_tables
from coadjoint.methods.protocol.composed import SubstepMethod
from coadjoint.methods.protocol.cost_model import (
    PYTHON_COST,
    Operations,
    Work,
    work_of_evaluations,
    work_of_iterations,
    work_of_operations,
)
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.registry import SCHEME_RULE, read_method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.system import System
from coadjoint.systems.user_functions import check_places

NO_PROPERTIES = Properties(poisson=False, energy=False, casimirs="none", attitude="none")


class StepMethod(SubstepMethod):
    """Base class of user-defined schemes with a step that is one Python function.

    Derive a frozen dataclass from it; its fields are the parameters of the scheme. Define `order`, `explicit`,
    `symmetric`, `properties` and `step`. The scheme then works in every run, stepper, composition and choice. If Numba
    is installed and can compile the step, it is compiled at the start of a run, in some seconds. In compiled code
    the system has ``dim``, ``sign``, ``vector_field(x, t)``, ``energy(x, t)``, ``structure_matrix(x)``, ``jacobian(x,
    t)``, and its ``hamiltonian`` has ``value``, ``gradient`` and ``hessian``. Otherwise the loop calls Python in each
    step, and warns once. `tangent` may be defined as well; without it the derivative is computed by complex steps if
    the step supports them, else by differences, with nine digits (see `Stepper.tangent_by`).

    See Also
    --------
    CompiledStepMethod : a step in C++.

    Examples
    --------
    Heun's method:

    >>> import dataclasses
    >>> import coadjoint as co
    >>> @dataclasses.dataclass(frozen=True)
    ... class Heun(co.methods.StepMethod):
    ...     order, explicit, symmetric = 2, True, False
    ...     def properties(self, system):
    ...         return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")
    ...     def step(self, system, x, t, h):
    ...         first = h * system.vector_field(x, t)
    ...         return x + (first + h * system.vector_field(x + first, t + h)) / 2
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 10), step=0.01, method=Heun())
    >>> bool(sol.drift()["energy"] < 1e-4)
    True
    """

    failures: ClassVar[Mapping[str, str]] = {
        "UNDEFINED": "the step failed, or did not return one finite number for each coordinate"
    }
    compensates: ClassVar[bool] = False
    known_to = UNIT_ROUNDOFF

    compiles: ClassVar[bool] = True
    """Whether to compile the step by Numba; if not, each step is a Python call, without a warning."""

    @abstractmethod
    def step(self, system: System, x: Any, t: Any, h: Any) -> Any: ...

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        if representation is not None:
            raise ValueError(
                f"{type(self).__name__} is a StepMethod, which computes no group element, but its properties have "
                f'attitude="{self.properties(system).attitude}"; set it to "none"'
            )

        function, compiled = step_function(self, system)
        tables = function_tables(system, function.address, fractions, compiled)
        return loop_over(STEP_LOOP, tables, keepalive=(*tables.keepalive, function))

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the estimated work of a step: as many evaluations of the field as its order, in Python if it is not
        compiled.
        """
        if not self.compiles:
            return Work(lambda iterations, evaluations: substeps * self.order * PYTHON_COST)
        return work_of_evaluations(system, self.order, self.explicit, substeps)


@dataclass(frozen=True)
class FunctionStep(StepMethod):
    """A function ``step(x, h)``, or ``step(x, t, h)`` if `timed`, as a scheme of which no more is known."""

    function: Callable[..., Any]
    timed: bool = False
    order: int = 1

    explicit = False
    symmetric = False
    offered: ClassVar[bool] = False
    compiles: ClassVar[bool] = False

    def __str__(self) -> str:
        return f"the function {getattr(self.function, '__name__', type(self.function).__name__)}"

    def properties(self, system: System) -> Properties:
        return NO_PROPERTIES

    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        return np.asarray(self.function(x, t, h) if self.timed else self.function(x, h))


def step_takes_time(function: Callable[..., Any]) -> bool:
    """Return whether a step is a function of (x, t, h), not of (x, h)."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    needed = sum(p.kind in kinds and p.default is inspect.Parameter.empty for p in parameters)
    if needed not in (2, 3):
        raise TypeError(f"{short(function)} takes {needed} arguments; a step is a function of (x, h), or of (x, t, h)")
    check_places(function, short(function), "x, t, h" if needed == 3 else "x, h")
    return needed == 3


def read_step(value: Any, order: int = 1) -> Method:
    """Return the scheme as `read_method` does, or for a function ``step(x, h)`` or ``step(x, t, h)`` of an order."""
    if callable(value) and not isinstance(value, type):
        return FunctionStep(value, step_takes_time(value), order)
    return read_method(value, rule=f"{SCHEME_RULE}, or a function step(x, h)")


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
        return loop_over(STEP_LOOP, step_tables(system, self, representation, fractions))

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        operations = self.operations(system)
        return work_of_iterations(system, group) if operations is None else work_of_operations(operations, substeps)
