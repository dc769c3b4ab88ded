"""Base class of systems: J(x), the Hamiltonian, and forces in addition to it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import in_standard_mode
from coadjoint.systems.closed_forms.closed_form import require_closed_form
from coadjoint.systems.coordinates import states_by_label
from coadjoint.systems.evaluation import ignore_overflow, read_point, vectorized_over_states
from coadjoint.systems.forces.base import Force, forces_on, forces_text, labels_of
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.validation import read_number, read_numbers, set_fields, truncate_title


class System:
    """The equations ``x' = sign * J(x) grad H(x, t)``, with forces in addition, if there are any.

    The base class of `LiePoissonSystem`, `PoissonSystem` and `MatrixSystem`. Derive a class from it for a bracket that
    these do not have. It sets `name`, `sign`, `hamiltonian`, `dim` and `casimirs`, and, without an `algebra` that has
    structure constants, `structure_function`. With `structure_matrix` or `hamiltonian_field` in its place, only a
    `StepMethod` integrates it, by calls of Python. States are vectors, or arrays of the shape `shape`.

    Attributes
    ----------
    name : str
        Name in messages, files and pictures.
    sign : {1, -1}
        Sign of the right-hand side.
    hamiltonian : Hamiltonian
        The energy, of vectors of `dim` numbers.
    dim : int
        Number n of coordinates.
    shape : tuple of int
        Shape of a state; (n,) by default.
    algebra, representation
        The Lie algebra on whose dual the state lies, and matrices for its group element; None by default.
    casimirs, integrals : mapping
        Invariants that runs record, and further constants of motion, by name; none by default.
    structure_function, derivative_function : callable
        Function of x that returns J(x), (n, n), and one that returns ``d J_ij / d x_k``, (n, n, n), which exact
        tangents need. Compiled by Numba; None by default.
    layout : mapping
        Lattice and shape of sites, for pictures; under ``"coordinates"`` kinds and units, see `LiePoissonSystem`.
    forces, labels : tuple
        Damping, torques and noise, given by `with_forces`, and their labels, numbered from the second of a type on.
    reversible : bool
        Whether all forces can run backward in time.
    boltzmann : float
        Energy of a unit of the temperatures that `thermal_states` takes; 1 but for models in kelvin.

    Examples
    --------
    >>> import coadjoint as co
    >>> class Oscillator(co.System):
    ...     name, sign, dim, hamiltonian = "oscillator", 1, 2, co.Quadratic([1.0, 1.0])
    ...     def structure_matrix(self, x):
    ...         return np.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> Oscillator().vector_field([1.0, 0.0])
    array([ 0., -1.])
    >>> Oscillator().with_forces(co.forces.LinearDamping(0.1)).vector_field([1.0, 0.0])
    array([-0.1, -1. ])
    """

    name: str
    sign: int
    hamiltonian: HamiltonianLike
    dim: int
    casimirs: Any = MappingProxyType({})
    integrals: Any = MappingProxyType({})
    layout: Any = MappingProxyType({})
    algebra: Any = None
    representation: Any = None
    forces: tuple[Force, ...] = ()
    labels: tuple[str, ...] = ()
    reversible: bool = True
    has_noise = False  # whether a force is random, so that neither a field nor states between two steps exist
    has_samples = False  # whether a force holds numbers from the start of a step
    is_batch: Literal[False] = False
    has_matrices = False  # whether states are matrices, with streams, traces and spectra
    has_attitude = False  # whether attitudes of bodies are part of the state
    frame_rate: Callable[..., Any] | None = None  # rate at which the frame of the attitude turns, a function of time
    structure_function: Callable[..., Any] | None = None
    derivative_function: Callable[..., Any] | None = None
    jacobi = True  # whether to warn if J(x) of `structure_function` violates the Jacobi identity at sample points
    _checked_function: Callable[..., Any] | None = None
    _unforced: System | None = None
    _parameters: dict[str, Any] | None = None
    _constants: Mapping[str, Any] | None = None  # by name, see `spin_constants`
    _base_parameters: dict[str, Any] | None = None  # of the system that has another linear term, without inputs
    _kind = property(type, doc="The class of the systems with which a batch mixes this one.")
    closed_form: Callable[..., Any] | None = None  # ``exact(x0, t, attitude)``
    boltzmann: float = 1.0  # energy of a unit of temperature

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of a state."""
        return (self.dim,)

    @property
    def unforced(self) -> Any:
        """The Hamiltonian part: this system without its forces."""
        return self if self._unforced is None else self._unforced

    @property
    def parameters(self) -> dict[str, Any] | None:
        """Parameters for which ``co.systems.get(name, **parameters)`` makes this system again, or None (a copy)."""
        return None if self._parameters is None else dict(self._parameters)

    states_by_label = states_by_label

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
        y = read_point(x, self.dim)
        if self.structure_function is not None:
            return np.asarray(self.structure_function(y))
        if not self.has_structure_constants:
            raise TypeError(
                f"J(x) of {self.name} is unknown: {type(self).__name__} has no structure constants; define "
                "structure_function or structure_matrix"
            )
        return np.asarray(self.algebra.structure_matrix(y))

    @property
    def has_structure_constants(self) -> bool:
        """Whether the bracket is linear, with structure constants in memory, as flows on a Lie algebra need."""
        return getattr(self.algebra, "triples", None) is not None

    @property
    def has_compiled_bracket(self) -> bool:
        """Whether the kernels can evaluate the bracket, from structure constants or a function J."""
        return self.has_structure_constants or (self.algebra is None and self.structure_function is not None)

    @property
    def has_quadratic_energy(self) -> bool:
        """Whether the Hamiltonian is a polynomial of degree at most two that does not depend on time."""
        return all(term.form is not None for term in self.hamiltonian.terms())

    def _product(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return J(x) u."""
        return self.structure_matrix(x) @ u

    def product_derivative(self, x: npt.NDArray[Any], u: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the derivative of J(x) u by x, at constant u; raise TypeError if it is unknown."""
        if self.derivative_function is not None:
            return np.einsum("ijk,j->ik", np.asarray(self.derivative_function(x)), u)
        if not self.has_structure_constants:
            raise TypeError(f"the derivative of J is unknown for {self.name}; give derivative=, or derivative_function")
        return np.asarray(self.algebra.coadjoint(u))

    def hamiltonian_field(self, x: npt.NDArray[Any], t: Any) -> npt.NDArray[Any]:
        """Return ``sign * J(x) grad H(x, t)``, (n,), at one state x, (n,), and a time, without the forces."""
        return self.sign * self._product(x, self.hamiltonian.gradient(x, t))

    def _vector(self, x: Any) -> npt.NDArray[Any]:
        """Return a state of real numbers as a vector, in which forces take it."""
        return read_point(read_numbers(self.states_by_label(x), "x"), self.dim)

    @vectorized_over_states
    @ignore_overflow
    def vector_field(self, x: npt.ArrayLike, t: Any = 0.0) -> npt.NDArray[Any]:
        """Return x': ``sign * J(x) grad H(x, t)``, and all forces.

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

        Raises
        ------
        TypeError
            A force is random.
        """
        if not self.forces:
            return self.hamiltonian_field(read_point(x, self.dim), t)
        y, t = self._vector(x), read_number(t, "t")
        field = self.unforced.vector_field(y, t)
        return np.asarray(sum((force.field(self.unforced, y, t) for force in self.forces), start=field))

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
        """Return the derivative of the vector field, dense; of systems without forces.

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
            The Hamiltonian has no second derivatives, the derivative of J was not given, or there are forces.
        """
        if self.forces:
            raise TypeError(f"the Jacobian of {self.name} is not known; take that of the Hamiltonian part, unforced")
        y = read_point(x, self.dim)
        bracket_part = self.product_derivative(y, self.hamiltonian.gradient(y, t))
        return self.sign * (bracket_part + self.structure_matrix(y) @ self.hamiltonian.hessian(y, t))

    @in_standard_mode
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
        return require_closed_form(self.closed_form, self.name)(x0, t, attitude)

    def with_forces(self, *forces: Force) -> Self:
        """Return the system with damping, torques or noise, after the forces that it has.

        A run uses a symmetric splitting: half flows of the forces in their order, a step of the scheme for the
        Hamiltonian part, half flows in reverse order. Sampled laws see the state at the start of a step, in any order.
        `Method.properties` lists the properties lost by the forces, and `Solution.balance` compares the changes of
        energy and Casimirs with the work of the forces.

        Parameters
        ----------
        *forces : Force
            One or more of ``co.forces``, in the order in which their flows are applied.

        Returns
        -------
        System
            Of the same class, with `forces`, and without a closed form; its `unforced` is the Hamiltonian part.

        Raises
        ------
        TypeError, ValueError
            No forces, an entry that is not a force, or a force that cannot act on the system.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
        >>> body.vector_field([0.0, 0.0, 1.0])
        array([ 0. ,  0. , -0.1])
        """
        if not forces:
            raise TypeError("with_forces was given no force; give one or more, such as co.forces.LinearDamping(0.1)")
        return self._with_acting((*self.forces, *forces), len(forces))

    def _with_acting(self, forces: Sequence[Force], new: int = 0) -> Self:
        """Return the Hamiltonian part with forces, of which the last ones are `new`."""
        plain, acting = forces_on(self.unforced, forces, new)
        forced = copy.copy(plain)
        vars(forced).pop("in_numbers", None)
        set_fields(forced, forces=acting, labels=labels_of(acting), _unforced=plain, _parameters=None, closed_form=None)
        set_fields(forced, name=truncate_title(f"{plain.name} with {', '.join(forced.labels)}"))
        reversible, random = all(force.reversible for force in acting), any(force.random for force in acting)
        set_fields(forced, reversible=reversible, has_noise=random, has_samples=any(f.sampled for f in acting))
        return forced

    def among(self, first: int, last: int) -> Self:
        """Return the system of the members `first` to `last` - 1, whose noise keeps their original numbers."""
        if not first or not self.has_noise:
            return self
        return self._with_acting([force.of_members_from(first) for force in self.forces])

    @property
    def flows(self) -> tuple[tuple[int, Force], ...]:
        """Flows of the forces with their positions, as in the first half of a step: laws are sampled before all act."""
        if not self.has_samples:
            return tuple(enumerate(self.forces))
        from coadjoint.systems.forces.sampled import flows_of

        return flows_of(self.forces)

    @property
    def distinct(self) -> tuple[Self, ...]:
        """The different systems of the members of an ensemble: this one, which all members share."""
        return (self,)

    def of_member(self, member: int) -> Self:
        """Return the system of a member, which all members share."""
        return self

    @property
    def in_numbers(self) -> System:
        """The same system with vectors as states, if they are matrices."""
        return self

    def states_of(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return rows of numbers (..., dim) as states (..., *shape)."""
        return rows.reshape(*rows.shape[:-1], *self.shape)

    def rows_of(self, states: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return states (..., *shape) as rows of numbers (..., dim)."""
        return states.reshape(*states.shape[: -len(self.shape)], self.dim)

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
            Label of a force to ``grad H . force``; negative if the force dissipates energy. Empty without forces.

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
        y, t = self._vector(x), read_number(t, "t")
        gradient = self.hamiltonian.gradient(y, t)
        powers = (float(gradient @ force.field(self.unforced, y, t)) for force in self.forces)
        return dict(zip(self.labels, powers, strict=True))

    def __repr__(self) -> str:
        forced = f"<{self.unforced.name} with forces, dimension {self.dim}: {forces_text(self.forces)}>"
        return forced if self.forces else self._text()

    def _text(self) -> str:
        return f"<{self.name}: {self.hamiltonian!r}>"

    def _repr_html_(self) -> str:
        from coadjoint.systems.description import system_table

        return system_table(self, **({"forces": forces_text(self.forces)} if self.forces else {}))
