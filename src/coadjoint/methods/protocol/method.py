"""The base class of all schemes, which defines their protocol."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import unknown_keyword
from coadjoint.memory import check_available_memory
from coadjoint.methods.protocol.properties import Properties
from coadjoint.program.numbers import Number
from coadjoint.short_repr import short
from coadjoint.systems.protocol import has_compiled_bracket
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tangents import Frame
    from coadjoint.methods.formal.formal_numbers import FormalNumber
    from coadjoint.methods.protocol.cost_model import Work
    from coadjoint.program.sweeps import Swept
    from coadjoint.program.table import Program

Representation = NDArray[np.float64] | str | None


class FinerRun(NamedTuple):
    """A more accurate scheme and number of steps, and the remaining fraction of the original error."""

    method: Method
    steps: int
    left: float


ERROR_CONTROL = frozenset(("tolerance", "rtol", "atol"))
NO_ERROR_CONTROL = (
    "a step that is chosen by an estimate of the error would lose what the scheme keeps over long times; give "
    "integrate accuracy=, which finds a constant step, or take Taylor(tolerance=...), or "
    "ReversibleSteps(Splitting(...)), whose steps follow the motion reversibly"
)
SIZE_SAMPLES = 240  # samples of the size of a motion, for schemes that choose their own steps
FEW_STEPS = 20  # with fewer steps the error may not scale with the order; a finer run takes at least this many more
BYTES_PER_CONSTANT = 450  # peak memory per structure constant during the construction of flows
MAX_PARAMETER_TEXT = 200  # characters of a parameter in a message


class Method(ABC):
    """A scheme: what it keeps, its compiled loop, its step in Python, its tangent, and its cost.

    Families implement this protocol from coefficients (`FlowMethod`), a tableau (`RungeKuttaMethod`) or a step
    (`StepMethod`, `CompiledStepMethod`); a user-defined scheme derives from one of them. All code that runs, chooses or
    tests schemes uses this protocol only.
    """

    def __new__(cls, *arguments: Any, **parameters: Any) -> Self:
        """Raise TypeError for a tolerance that the scheme does not have, and for unknown parameters."""
        for name in ERROR_CONTROL.intersection(parameters):
            if name not in getattr(cls, "__dataclass_fields__", {}):
                raise TypeError(f"{cls.__name__} has no {name}: {NO_ERROR_CONTROL}")
        for name in parameters.keys() - getattr(cls, "__dataclass_fields__", {}).keys():
            accepted = signature(cls.__init__).parameters  # a class may define its own constructor
            if name not in accepted and Parameter.VAR_KEYWORD not in {p.kind for p in accepted.values()}:
                raise unknown_keyword(cls.__name__, name, list(accepted)[1:])
        return super().__new__(cls)

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
        """Return what the scheme keeps on a system; raise an error for a system that it cannot integrate.

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

    def composed(self, coefficients: Sequence[float]) -> Method:
        """Return the composition of this scheme with these fractions of its step.

        Parameters
        ----------
        coefficients : sequence of float
            The fractions.

        Returns
        -------
        Method
            `Composition` is the public scheme, which validates them.
        """
        raise TypeError(f"{self} cannot be composed")

    def symmetrized(self) -> Method:
        """Return half a step of this scheme followed by half a step of its adjoint: a symmetric scheme of even order.

        Returns
        -------
        Method

        Raises
        ------
        TypeError
            The adjoint is not known as a scheme.
        """
        raise TypeError(f"the adjoint of {self} is not known as a scheme; take a splitting, or a Runge-Kutta tableau")

    @property
    def fractions(self) -> tuple[float, ...]:
        """Substeps of one step as fractions of it; one unless the scheme is a composition."""
        return (1.0,)

    def loop(self, system: System, h: float, representation: Representation = None) -> CompiledLoop:
        """Return the scheme on a system as a compiled loop with its tables.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        h : float
            The step, negative for backward.
        representation : ndarray of shape (n, d, d), "coadjoint", or None
            Representation in which the group element is computed; None for no group element.

        Returns
        -------
        CompiledLoop

        Raises
        ------
        ValueError, TypeError
            The scheme cannot be used for the system.
        """
        declared_properties(self, system)
        if system.algebra is not None and has_compiled_bracket(system):
            constants = system.algebra.triples.c.size
            check_available_memory(
                BYTES_PER_CONSTANT * constants, f"the tables of {type(self).__name__} for {system.name}"
            )
        return self.compiled(system, h, representation)

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

    @abstractmethod
    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return one step and its derivative.

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

    def tangent_on(self, system: System, x: Any, t: float, h: float, vectors: NDArray[Any]) -> NDArray[Any]:
        """Return the derivative of a step applied to tangent vectors (n, k), if cheaper than the whole derivative.

        Parameters
        ----------
        system, x, t, h
            As for `tangent`.
        vectors : (n, k) array
            The vectors, in columns.

        Returns
        -------
        (n, k) array
            The vectors after the step.

        Raises
        ------
        TypeError, IntegrationError
            As for `tangent`.
        """
        return np.asarray(self.tangent(system, x, t, h)[1] @ vectors)

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        """Return how `tangent` computes the derivative: by "formula", "complex step" or "differences".

        Parameters
        ----------
        system, x, t, h
            As for `tangent`.

        Returns
        -------
        str
            The first two are exact to round-off; differences have about nine digits.
        """
        return "formula"

    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return the loop that carries tangent vectors with the state, whose bits do not depend on them.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system; its Hamiltonian must have second derivatives, and a `PoissonSystem` the derivative of J.
        h : float
            The step, negative for backward.
        frame : Frame
            The vectors, and when they are made orthonormal.

        Returns
        -------
        CompiledLoop or None
            None if there is no such loop: `tangent` is then called for every step.

        Raises
        ------
        ValueError, TypeError
            The scheme cannot be used for the system, or a derivative is not known.
        """
        return None

    def formal_step(self, system: System, x: NDArray[Any], h: FormalNumber) -> NDArray[Any]:
        """Return one step as a power series in h whose coefficients are exact polynomials in the state.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system, with a polynomial vector field.
        x : (n,) array of FormalNumber
            The state.
        h : FormalNumber
            The step, or a multiple of it.

        Returns
        -------
        (n,) array of FormalNumber

        Raises
        ------
        TypeError
            The step is no power series, or no way to compute the series is known.
        """
        raise TypeError(f"a step of {self} is not known as a power series in exact numbers")

    @property
    def known_to(self) -> float:
        """Relative error of the coefficients of `formal_step`; 0 if they are exact."""
        return 0.0

    def program(self, system: System, *, group: Representation = None, number: Number = float) -> Program:
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
        Program

        Raises
        ------
        TypeError
            The scheme does not consist of flows.
        """
        raise TypeError(f"{self} is not made of exact flows, so it has no program; Splitting has one")

    def swept(self) -> Swept:
        """Return the scheme as sweeps through the parts of a Hamiltonian.

        Returns
        -------
        Swept
            Sweeps, processor, parts and rotation, from which `coadjoint.program` builds its table.

        Raises
        ------
        TypeError
            The scheme does not consist of flows.
        """
        raise TypeError(f"{self} is not made of exact flows of parts, as Splitting is")

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

    def settled(self, system: System, coordinates: Sequence[int]) -> Method:
        """Return the same scheme with all automatic choices for a system fixed, such as its parts.

        Systems that differ only in some coefficients of the linear term of H then have tables of one structure.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        coordinates : sequence of int
            Coordinates of the coefficients that differ.

        Returns
        -------
        Method
            The scheme itself, if it has no automatic choices.

        Raises
        ------
        TypeError, ValueError
            A choice cannot be fixed.
        """
        return self

    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the invariants that a step restores besides the energy; None if it does not restore the energy either.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        mapping or None
            Name -> `Polynomial` or `Quadratic`.
        """
        return None

    def finer(self, steps: int, times: float) -> FinerRun:
        """Return the scheme and number of steps of a more accurate run, for an estimate of the error of a run.

        Parameters
        ----------
        steps : int
            Number of steps of the run, at least 1.
        times : float
            Factor by which the number of steps grows, or by which steps shrink if the scheme chooses its own.

        Returns
        -------
        FinerRun
            Its `left` is the remaining fraction of the error according to the order.
        """
        count = math.ceil(times * (steps + FEW_STEPS))
        return FinerRun(self, count, (steps / count) ** self.order)

    def reaching(self, system: System, tolerance: float) -> Method:
        """Return the same scheme with another tolerance, if it chooses its own steps.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        tolerance : float
            Error of a step, relative to the largest momentum so far.

        Returns
        -------
        Method
            The scheme, with the order of least work.

        Raises
        ------
        TypeError
            The scheme has no tolerance.
        """
        raise TypeError(f"{self} has no tolerance that could be chosen for an accuracy; give step= in its place")

    def with_compensation(self) -> Method | None:
        """Return the same scheme with compensated sums, if that choice was left open; else None."""
        return None

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        """Return whether steps needed Newton's method, from the memory (members, numbers) of a run."""
        return False

    def look_ahead(self, systems: Sequence[System]) -> None:
        """Prepare jointly for many systems what `loop` would prepare for each; nothing by default."""
        return

    @classmethod
    def examples(cls) -> Sequence[Method]:
        """Return schemes of this class for the tests; together they cover all its features."""
        return [cls()]


def check_base(base: Any, wrapper: str, example: str) -> None:
    """Raise a TypeError if the base of a wrapper is not a scheme."""
    if not isinstance(base, Method):
        raise TypeError(f"the base of {wrapper} is a scheme such as {example}, not {short(base)}")


def declared_properties(method: Method, system: System) -> Properties:
    """Return what a scheme declares to keep on a system; raise TypeError if it returns anything but `Properties`."""
    declared = method.properties(system)
    if not isinstance(declared, Properties):
        raise TypeError(
            f"properties of {type(method).__name__} returned {short(declared)}; "
            "it must return coadjoint.methods.Properties"
        )
    return declared


def has_quadratic_energy(system: System) -> bool:
    """Return whether the Hamiltonian is a polynomial of degree at most two that does not depend on time."""
    return all(term.form is not None for term in system.hamiltonian.terms())
