"""What systems have in common, and systems with forces: damping, torques and noise in addition to the Hamiltonian."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.closed_forms.closed_form import require_closed_form
from coadjoint.systems.evaluation import ignore_overflow, read_point, vectorized_over_states
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.validation import read_list, read_number, read_numbers, to_array, truncate_title

OF_BODIES = (
    "state",
    "attitudes",
    "positions",
    "velocities",
    "angular_velocity",
    "angular_momentum",
    "momentum",
    "wheel_speeds",
    "gimbal_angles",
)
"""Methods of systems of bodies, which these have with forces as well."""
MAX_FORCES_TEXT = 240  # characters of the forces in a representation; longer lists are cut


class System(ABC):
    """The equations ``x' = sign * J(x) grad H(x)``; a subclass gives J."""

    sign: int
    name: str
    hamiltonian: HamiltonianLike
    _parameters: dict[str, Any] | None
    _exact: Callable[..., Any] | None

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number n of coordinates."""

    @abstractmethod
    def structure_matrix(self, x: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return the structure matrix J(x), dense.

        Parameters
        ----------
        x : (n,)
            The state.

        Returns
        -------
        ndarray, shape (n, n)
        """

    def _product(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return J(x) u."""
        return self.structure_matrix(x) @ u

    @abstractmethod
    def _product_derivative(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the derivative of J(x) u by x, at constant u; raise TypeError if it is unknown."""

    def _field(self, x: npt.NDArray[Any], t: Any) -> npt.NDArray[Any]:
        """Return J(x) grad H(x, t)."""
        return self._product(x, self.hamiltonian.gradient(x, t))

    @property
    def parameters(self) -> dict[str, Any] | None:
        """Parameters for which ``co.systems.get(name, **parameters)`` makes this system again, or None (a copy)."""
        return None if self._parameters is None else dict(self._parameters)

    @property
    def closed_form(self) -> Callable[..., Any] | None:
        """The given function ``exact(x0, t, attitude)``, or None."""
        return self._exact

    @vectorized_over_states
    @ignore_overflow
    def vector_field(self, x: npt.ArrayLike, t: Any = 0.0) -> npt.NDArray[Any]:
        """Return ``sign * J(x) grad H(x, t)``, without a matrix if the structure constants are known.

        Parameters
        ----------
        x : (n,) or (..., n)
            One state or several, of floats, complex numbers or Python objects (fractions, multiprecision numbers).
        t : float or (k,)
            The time, or one for each entry of the first axis of several states.

        Returns
        -------
        ndarray, shape (n,) or (..., n)
            Bit-identical to separate calls for each state.
        """
        return self.sign * self._field(read_point(x, self.dim), t)

    @vectorized_over_states
    @ignore_overflow
    def energy(self, x: npt.ArrayLike, t: Any = 0.0) -> Any:
        """Return H(x, t).

        Parameters
        ----------
        x : (n,) or (..., n)
            One state or several.
        t : float or (k,)
            The time, or one for each entry of the first axis of several states.

        Returns
        -------
        float, or a number of the type of x, or ndarray of the shape (...)

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(2, 4, 4))
        >>> body.energy([[1.0, 0.0, 0.0], [1.0, 2.0, 4.0]])
        array([0.25, 2.75])
        """
        return self.hamiltonian.value(read_point(x, self.dim), t)

    @ignore_overflow
    def jacobian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the derivative of the vector field, dense.

        Parameters
        ----------
        x : (n,)
            The state.
        t : float
            The time.

        Returns
        -------
        ndarray, shape (n, n)

        Raises
        ------
        TypeError
            The Hamiltonian has no second derivatives, or the derivative of J was not given.
        """
        y = read_point(x, self.dim)
        bracket_part = self._product_derivative(y, self.hamiltonian.gradient(y, t))
        return self.sign * (bracket_part + self.structure_matrix(y) @ self.hamiltonian.hessian(y, t))

    def exact(self, x0: npt.ArrayLike, t: npt.ArrayLike, attitude: Any = False) -> Any:
        """Return the closed-form solution, if known.

        Parameters
        ----------
        x0 : (n,)
            The state at time zero.
        t : float or (k,)
            One time, or several.
        attitude : bool or (d, d)
            Also return the group element; an array, or a rotation as in `integrate`, is its initial value.

        Returns
        -------
        ndarray, shape (n,) or (k, n)
            With `attitude` the pair of this and the group elements, shape (d, d) or (k, d, d).

        Raises
        ------
        TypeError
            No closed form is known.
        """
        return require_closed_form(self._exact, self.name)(x0, t, attitude)

    def with_forces(self, *forces: Force) -> ForcedSystem:
        """Return the system with damping, torques or noise; runs record the resulting changes of invariants.

        Parameters
        ----------
        *forces : Force
            One or more of ``co.forces``, in the order in which their flows are applied.

        Returns
        -------
        ForcedSystem
            For `integrate`, `prepare` and `stepper`.
        """
        return ForcedSystem(self, forces)

    def _repr_html_(self) -> str:
        from coadjoint.systems.description import system_table

        return system_table(self)


@suggest_keywords
class ForcedSystem:
    """A system with forces: ``x' = sign J(x) grad H(x, t) + the sum of the forces``.

    ``system.with_forces(...)`` makes it. A run uses a symmetric splitting: half flows of the forces in their order, a
    step of the scheme for the Hamiltonian part, half flows in reverse order. `Method.properties` lists the properties
    lost by the forces, and `Solution.balance` compares the changes of energy and Casimirs with the work of the forces.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The Hamiltonian part.
    forces : sequence of Force
        One or more, in the order in which their flows are applied.

    Attributes
    ----------
    system, forces
        As given.
    dim, sign, name, algebra, representation, hamiltonian, casimirs
        Those of the Hamiltonian part. Runs record the Casimirs, which forces may change.

    Raises
    ------
    TypeError, ValueError
        Not a system, no forces, an entry that is not a force, or a force that cannot act on the system.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
    >>> body.vector_field([0.0, 0.0, 1.0])
    array([ 0. ,  0. , -0.1])
    """

    parameters = None
    closed_form: Callable[..., Any] | None = None

    def __init__(self, system: Any, forces: Sequence[Force]) -> None:
        from coadjoint.systems.system_checks import check_one_system

        check_one_system(system)
        forces = read_list(forces, "forces", "give a list of forces of co.forces")
        if not forces:
            raise TypeError("with_forces was given no force; give one or more, such as co.forces.LinearDamping(0.1)")
        for force in forces:
            if not isinstance(force, Force):
                raise TypeError(f"a force is {short(force)}; it must be one of co.forces, such as LinearDamping(0.1)")
        system, forces = _with_held_numbers(system, forces)
        for force in forces:
            force.check(system)
        streams = [(force.seed, force.stream) for force in forces if force.random]  # type: ignore[attr-defined]
        if len(set(streams)) < len(streams):
            raise ValueError("two forces have the same seed and stream, and so the same noise; give each its own seed")
        if not getattr(system, "linear_stream", True):
            # the kernels compute the energy of matrices from their stream
            raise ValueError(f"the energy of {system.name} is a user function; forces need a system without energy=")
        self.system, self.forces = system, forces

    def __getattr__(self, name: str) -> Any:
        # Copies and pickles look attributes up before there is a system.
        if name in OF_BODIES and "system" in vars(self):
            return getattr(self.system, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def with_forces(self, *forces: Force) -> ForcedSystem:
        """Return the system with further forces after the present ones.

        Parameters
        ----------
        *forces : Force
            One or more.

        Returns
        -------
        ForcedSystem
        """
        return ForcedSystem(self.system, (*self.forces, *forces))

    def numbered_from(self, first: int) -> ForcedSystem:
        """Return the system for members whose numbers begin at `first`; noise depends on these numbers."""
        if not first or not any(force.random for force in self.forces):
            return self
        forces: list[Any] = list(self.forces)
        renumbered = [replace(force, stream=force.stream + first) if force.random else force for force in forces]
        return ForcedSystem(self.system, renumbered)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the forces, numbered from the second of a type on."""
        labels: list[str] = []
        for k, force in enumerate(self.forces):
            earlier = sum(other.label == force.label for other in self.forces[:k])
            labels.append(f"{force.label} {earlier + 1}" if earlier else force.label)
        return tuple(labels)

    @property
    def reversible(self) -> bool:
        """Whether all forces can run backward in time."""
        return all(force.reversible for force in self.forces)

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return int(self.system.dim)

    @property
    def sign(self) -> int:
        """The sign of the Hamiltonian part."""
        return int(self.system.sign)

    @property
    def name(self) -> str:
        """Name of the Hamiltonian part and of the forces."""
        return truncate_title(f"{self.system.name} with {', '.join(self.labels)}")

    @property
    def algebra(self) -> Any:
        """Algebra of the Hamiltonian part."""
        return self.system.algebra

    @property
    def representation(self) -> Any:
        """Representation of the Hamiltonian part."""
        return self.system.representation

    @property
    def hamiltonian(self) -> Any:
        """The energy, which forces change."""
        return self.system.hamiltonian

    @property
    def casimirs(self) -> dict[str, Any]:
        """The Casimirs of the Hamiltonian part, which forces may change."""
        return dict(self.system.casimirs)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a state."""
        return tuple(getattr(self.system, "shape", (self.dim,)))

    def structure_matrix(self, x: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return J(x), shape (n, n)."""
        return np.asarray(self.system.structure_matrix(x))

    @vectorized_over_states
    @ignore_overflow
    def vector_field(self, x: npt.ArrayLike, t: Any = 0.0) -> npt.NDArray[Any]:
        """Return the vector field x', including all forces.

        Parameters
        ----------
        x : (n,) or (..., n)
            One state or several.
        t : float or (k,)
            The time, or one for each entry of the first axis of several states.

        Returns
        -------
        ndarray, shape (n,) or (..., n)
            Bit-identical to separate calls for each state.

        Raises
        ------
        TypeError
            A force is random.
        """
        y, t = self._numbers(x), read_number(t, "t")
        field = sum((force.field(self.system, y, t) for force in self.forces), start=self.system.vector_field(y, t))
        return np.asarray(self.system.from_vector(field) if to_array(x, "x", "iufc").ndim > 1 else field)

    def _numbers(self, x: Any) -> npt.NDArray[Any]:
        """Return a state as a vector; a matrix by its entries."""
        if hasattr(self.system, "from_vector") and to_array(x, "x", "iufc").ndim > 1:
            x = self.system.read(x, "x")
        return read_point(read_numbers(x, "x"), self.dim)

    def exact(self, x0: npt.ArrayLike, t: npt.ArrayLike, attitude: Any = False) -> Any:
        """Raise TypeError: systems with forces have no closed form."""
        return require_closed_form(None, self.name)(x0, t, attitude)

    @vectorized_over_states
    def energy(self, x: npt.ArrayLike, t: Any = 0.0) -> Any:
        """Return H(x, t) of one state or several; see `LiePoissonSystem.energy`."""
        return self.system.energy(x, t)

    @ignore_overflow
    def power(self, x: npt.ArrayLike, t: float = 0.0) -> dict[str, float]:
        """Return the rate at which each force changes the energy at a state.

        Parameters
        ----------
        x : (n,)
            The state.
        t : float
            The time.

        Returns
        -------
        dict
            Label of a force to ``grad H . force``; negative if the force dissipates energy.

        Raises
        ------
        TypeError
            A force is random.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(2, 4, 4)).with_forces(co.forces.LinearDamping(0.5))
        >>> body.power([0.0, 0.0, 2.0])
        {'LinearDamping': -0.5}
        """
        y, t = self._numbers(x), read_number(t, "t")
        gradient = self.hamiltonian.gradient(y, t)
        pairs = zip(self.labels, self.forces, strict=True)
        return {label: float(gradient @ force.field(self.system, y, t)) for label, force in pairs}

    def __repr__(self) -> str:
        return f"<{self.system.name} with forces, dimension {self.dim}: {forces_text(self.forces)}>"

    def _repr_html_(self) -> str:
        from coadjoint.systems.description import system_table

        return system_table(self, forces=forces_text(self.forces))


def _with_held_numbers(system: Any, forces: Sequence[Any]) -> tuple[Any, tuple[Any, ...]]:
    """Return a system with room in its state for the numbers that forces hold, and the forces with their places."""
    counts = [force.held_numbers(system) for force in forces]
    if not any(counts):
        return system, tuple(forces)
    starts = [0, *accumulate(counts)]
    placed = [
        replace(force, first=first) if count else force
        for force, count, first in zip(forces, counts, starts, strict=False)
    ]
    return system.with_held(starts[-1]), tuple(placed)


def forces_text(forces: Sequence[Force]) -> str:
    """Return the forces with their parameters; of many the names, and of more their number."""
    text = ", ".join(map(str, forces))
    if len(text) > MAX_FORCES_TEXT:
        text = ", ".join(force.label for force in forces)
    if len(text) > MAX_FORCES_TEXT:
        return ", ".join(short(force.label) for force in forces[:2]) + f", and {len(forces) - 2} more"
    return text
