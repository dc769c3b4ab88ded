"""The base class of all schemes, which defines their protocol."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.keyword_hints import Abstract
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.properties import Properties, check_attitude
from coadjoint.program.numbers import Number
from coadjoint.short_repr import short
from coadjoint.systems.step_derivatives import LinearizedStep, dense_step, derivative_of
from coadjoint.systems.system import System

if TYPE_CHECKING:
    from coadjoint.kernels.tables.derivatives import Frame
    from coadjoint.methods.numerics.formal_series import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.methods.protocol.derivative_tables import DerivativeTables
    from coadjoint.program.table import FlowTable
    from coadjoint.systems.energy_derivatives import EnergyDerivative
    from coadjoint.systems.system_stacks import SystemStack

Representation = NDArray[np.float64] | str | None

BYTES_PER_CONSTANT = 450  # peak memory per structure constant during the construction of flows
MAX_PARAMETER_TEXT = 200  # characters of a parameter in a message
MAX_SHORT_DENOMINATOR = 2**20  # floats with larger denominators are measured numbers, not short fractions
SIZE_SAMPLES = 240  # samples of the size of a motion, at output points that do not affect own steps


class FinerRun(NamedTuple):
    """A more accurate scheme and number of steps, and the remaining fraction of the original error."""

    method: Method
    steps: int
    left: float


class Method(Abstract):
    """A scheme: what it preserves, its compiled loop, its step in Python, its tangent, and its cost.

    Families implement this protocol from coefficients (`FlowMethod`), a tableau (`RungeKuttaMethod`) or a step
    (`StepMethod`, `CompiledStepMethod`); a user-defined scheme derives from one of them. What only some schemes can do
    has a default that refuses by name, or that returns what holds for the others.
    """

    failures: ClassVar[Mapping[str, str]] = {}
    """Messages for statuses of a step, by name, other than the common ones (no convergence, overflow)."""

    largest: ClassVar[float] = np.inf
    """Largest dimension for which the scheme is considered if none was requested."""

    tables_of_any_step: ClassVar[bool] = False
    """Whether the result of `loop` without a group element does not depend on the step."""

    compensates: ClassVar[bool] = True
    """Whether the momentum is updated by compensated sums."""

    def __str__(self) -> str:
        """Return the scheme with its non-default parameters, and its order or stages."""
        if not is_dataclass(self):
            return repr(self)
        shown = []
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("order", "stages") or value != field.default:
                shown.append(f"{field.name}={value if isinstance(value, Method) else short(value, MAX_PARAMETER_TEXT)}")
        return f"{type(self).__name__}({', '.join(shown)})"

    @property
    @abstractmethod
    def order(self) -> int:
        """Order of accuracy: the error over a fixed time is O(step^order)."""

    @property
    @abstractmethod
    def explicit(self) -> bool:
        """Whether a step solves no system of equations."""

    @property
    @abstractmethod
    def symmetric(self) -> bool:
        """Whether a step by -h undoes a step by h."""

    offered: ClassVar[bool] = True
    """Whether the registry lists the scheme."""

    instead: ClassVar[str] = ""
    """For a scheme that is not symmetric: the scheme to compose instead, for messages."""

    @property
    def own_steps(self) -> bool:
        """Whether the scheme chooses its own steps; the step of a run is then the distance of possible saved points."""
        return False

    @abstractmethod
    def properties(self, system: System) -> Properties:
        """Return what the scheme preserves on a system; raise an error for a system that it cannot integrate.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        Properties
            The declaration, which the verification tests check.

        Raises
        ------
        ValueError
            If the scheme cannot be used for the system.
        """

    @property
    def expanded(self) -> Method:
        """The scheme that is run: the flows or the substeps of a composition, and any other scheme itself."""
        return self

    @property
    def fractions(self) -> tuple[float, ...]:
        """Substeps of one step as fractions of it; one unless the scheme is a composition."""
        return (1.0,)

    def steps_between_forces(self) -> tuple[Method, tuple[float, ...]]:
        """Return a symmetric scheme of order two and the fractions of the step at which forces act around it."""
        return self, (1.0,)

    def loop(self, system: System, h: float, representation: Representation = None) -> CompiledLoop:
        """Return the compiled loop on a system for the step h (negative: backward).

        `representation` (n, d, d) or "coadjoint" is that of the group element; None computes none.
        """
        self._check_loop(system)
        return self.compiled(system, h, representation)

    def _shared_loop(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        """Return the `loop` for members that share all constants, whose tables may take less memory."""
        return self.loop(system, h, representation)

    def _check_loop(self, system: System) -> None:
        declared_properties(self, system)
        if system.algebra is not None and system.has_compiled_bracket:
            constants = system.algebra._constant_count
            check_available_memory(
                BYTES_PER_CONSTANT * constants, f"the tables of {type(self).__name__} for {system.name}"
            )

    @abstractmethod
    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        """Return the compiled loop for a system that the scheme can integrate; parameters are those of `loop`."""

    @abstractmethod
    def step(self, system: System, x: Any, t: Any, h: Any) -> Any:
        """Return one step, computed in Python.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state: floats, or objects such as ``mpmath.mpf``, whose precision is then used throughout.
        t, h : number
            Time at the start, and length of the step.

        Returns
        -------
        (n,) array
        """

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative.

        Schemes without a formula for it use complex steps, or else differences.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system; its Hamiltonian must have second derivatives, and a `PoissonSystem` the derivative of J.
        x : (n,) array
            The state.
        t, h : float
            Time at the start, and length of the step.

        Returns
        -------
        x_new : (n,) array
            The step.
        P : (n, n) array
            Its derivative with respect to x.

        Raises
        ------
        TypeError
            A derivative is not known.
        IntegrationError
            The iteration of an implicit scheme does not converge.
        """
        return derivative_of(lambda y: self.step(system, y, t, h), np.asarray(x, dtype=np.float64))[:2]

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        """Return how `tangent` is computed: by "formula", "complex step" or "differences", with about nine digits."""
        if type(self).tangent is not Method.tangent:
            return "formula"
        return derivative_of(lambda y: self.step(system, y, t, h), np.asarray(x, dtype=np.float64))[2]

    def tangent_on(self, system: System, x: Any, t: float, h: float, vectors: NDArray[Any]) -> NDArray[Any]:
        """Return the derivative of a step applied to tangent vectors (n, k)."""
        return np.asarray(self.tangent(system, x, t, h)[1] @ vectors)

    def linearized(self, system: System, x: Any, t: float, h: float) -> LinearizedStep:
        """Return a step from a vector, with its derivative as a linear map; by default from its matrix, `tangent`."""
        end, matrix = self.tangent(system, x, t, h)
        return dense_step(np.asarray(end), np.asarray(matrix))

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return the loop that carries tangent vectors, with the same bits of states; None: `tangent` is called."""
        return None

    @property
    def by_stages(self) -> bool:
        """Whether `linearized` has the stages by which steps of vectors are differentiated by parameters of H."""
        return False

    def differentiates(self, system: System) -> bool:
        """Whether there are loops that differentiate whole runs of a system, `derivative_tables`."""
        return False

    @property
    def stored_states(self) -> int:
        """States in memory for each step of a segment that is differentiated backward."""
        return 1

    def derivative_tables(
        self, system: System, h: float, representation: Representation, energies: Mapping[str, EnergyDerivative]
    ) -> DerivativeTables:
        """Return the tables of these loops; `energies` are the derivatives of the energy by the parameters wanted."""
        raise TypeError(f"runs by {self} have no derivatives; take a Splitting or a Runge-Kutta method")

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return one step as a power series in h, of formal numbers; TypeError if it is not known."""
        raise TypeError(f"a step of {self} is not known as a power series in exact numbers")

    @property
    def known_to(self) -> float:
        """Relative error of the coefficients of `formal_step`; 0 if they are exact."""
        return 0.0

    def flow_table(self, system: System, *, group: Representation = None, number: Number = float) -> FlowTable:
        """Return the table of exact flows that make up a step.

        Parameters
        ----------
        system : LiePoissonSystem
            The system.
        group : ndarray of shape (n, d, d), "coadjoint", or None
            Representation in which the group element is computed; None for no group element.
        number : callable
            Number type: `float`, or for instance `mpmath.mpf` for evaluation in Python.

        Returns
        -------
        FlowTable

        Raises
        ------
        TypeError
            The scheme does not consist of flows.
        """
        raise TypeError(f"{self} is not made of exact flows, so it has no flow table; Splitting has one")

    @abstractmethod
    def work(self, system: System, group: Representation = None) -> Work:
        """Return the cost of a step on a system.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        group : ndarray of shape (n, d, d), "coadjoint", or None
            Representation in which the group element is computed; None for no group element.

        Returns
        -------
        Work
        """

    def matrix_products(
        self, system: System, steps: int, evaluations: int, iterations: int
    ) -> tuple[float, float] | None:
        """Return the products of matrices of so many steps, in the precision of the states and in the lower one, or
        None.
        """
        return None

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the `Polynomial`s and `Quadratic`s that a step restores with the energy, by name; None: no energy."""
        return None

    def finer(self, steps: int, times: float) -> FinerRun | None:
        """Return a run with own steps shorter by a factor, for `steps` output points; None if steps are given."""
        return None

    @property
    def fixed_steps(self) -> Method:
        """The scheme itself, or that of the steps that it chooses, with lengths that are given."""
        if self.own_steps:
            raise TypeError(
                f"{self} chooses its own steps, and its runs have no derivatives; define fixed_steps and next_length"
            )
        return self

    def next_length(self, system: System, x: NDArray[np.float64], h: float, memory: Any) -> tuple[float, Any]:
        """Return the length of the next own step, with the sign of h, and the memory (None at the start) after it."""
        raise NotImplementedError

    takes_tolerance: ClassVar[bool] = False
    """Whether the scheme can choose its own steps by an estimate of their errors, see `reaching`."""

    def reaching(self, system: System, tolerance: float) -> Method:
        """Return the scheme of least work with this error of a step, relative to the largest momentum so far."""
        raise TypeError(f"{self} has no tolerance that could be chosen for an accuracy; give step= in its place")

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the composition of this scheme with these fractions of its step, which `Composition` validates."""
        raise TypeError(f"{self} cannot be composed")

    def symmetrized(self) -> Method:
        """Return half a step of this scheme followed by half a step of its adjoint: symmetric, of even order."""
        raise TypeError(f"the adjoint of {self} is not known as a scheme; take a splitting, or a Runge-Kutta tableau")

    def settled(self, systems: Sequence[Any], coordinates: Sequence[int]) -> Method:
        """Return the scheme with automatic choices for systems fixed, for any linear terms at these coordinates."""
        return self

    def split_jointly(self, systems: Sequence[Any]) -> list[SystemStack]:
        """Return those of many systems whose tables differ only in coefficients of H, the `sources` of a loop."""
        from coadjoint.systems.system_stacks import stacks_of

        return stacks_of(systems)

    def with_compensation(self) -> Method | None:
        """Return the same scheme with compensated sums, if that choice was left open; else None."""
        return None

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        """Return whether an implicit step of any member of a run, with memory (members, numbers), used Newton."""
        return False

    def check_attitude(self, system: System, representation: Any) -> None:
        """Raise ValueError if the scheme cannot preserve the group in this representation, "coadjoint" or (n, d, d)."""
        check_attitude(declared_properties(self, system).attitude, type(self).__name__, system, representation)

    @classmethod
    def examples(cls) -> Sequence[Method]:
        """Return schemes of this class for the tests; together they cover all its features."""
        return [cls()]


def declared_properties(method: Method, system: System) -> Properties:
    """Return what a scheme declares to preserve on a system; raise TypeError if this is no `Properties`."""
    declared = method.properties(system)
    if not isinstance(declared, Properties):
        raise TypeError(
            f"properties of {type(method).__name__} returned {short(declared)}; "
            "it must return coadjoint.methods.Properties"
        )
    return declared


def is_short(value: Any) -> bool:
    """Return whether a number is exactly a fraction with a small denominator, such as 0.375 or 1/3 but not 0.1."""
    return Fraction(value).denominator <= MAX_SHORT_DENOMINATOR
