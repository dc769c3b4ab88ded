"""Queries about any system, with forces or in a batch.

Only these functions and the writers of records distinguish the classes of systems; other code calls them:

| question | function |
|---|---|
| the system of a member, or all of them | `member_of`, `members_of`, `among` |
| the Hamiltonian part and the forces | `unforced`, `forces_of` |
| rows of numbers as states, and the inverse | `states_of`, `rows_of` |
| names of the components of a state | `coordinates_of` |
| matrices with streams, traces and spectra | `is_matrix_system`, `unforced_matrix_system` |
| the same with vectors as states | `as_vector_system` |
| brackets | `has_structure_constants`, `has_compiled_bracket` |
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from coadjoint.systems.batch import Batch
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.forces.base import Force
from coadjoint.systems.matrices.matrix_system import MatrixSystem

if TYPE_CHECKING:
    from typing_extensions import TypeIs

    from coadjoint.systems.lie_poisson import LiePoissonSystem


def is_batch(system: Any) -> TypeIs[Batch]:
    """Return whether each member has its own system; use it only where that alters shapes or messages."""
    return isinstance(system, Batch)


def members_of(system: Any) -> tuple[Any, ...]:
    """Return the systems of a batch; any other system as the only one."""
    return system.systems if is_batch(system) else (system,)


def member_of(system: Any, member: int = 0) -> Any:
    """Return the system of a member, which all members share unless they are those of a batch."""
    return system.systems[member] if is_batch(system) else system


def among(system: Any, first: int, last: int) -> Any:
    """Return the system of the members `first` to `last` - 1, whose noise keeps their original numbers."""
    if is_batch(system):
        return system.among(first, last)
    return system.numbered_from(first)


def unforced(system: Any) -> Any:
    """Return the Hamiltonian part of a system, of a batch that of its first member; None for an unknown system."""
    return None if system is None else member_of(system).unforced


def forces_of(system: Any) -> tuple[tuple[str, Force], ...]:
    """Return the forces of a system with their labels, of a batch those of its first member; empty without forces."""
    first = member_of(system)
    return () if system is None else tuple(zip(first.labels, first.forces, strict=True))


def states_of(system: Any, rows: Any) -> Any:
    """Return rows of numbers (..., dim) as states (..., *shape); vectors are such rows.

    Examples
    --------
    >>> import numpy as np
    >>> from coadjoint.systems.fluids.sphere_euler import sphere_euler
    >>> states_of(sphere_euler(N=3), np.zeros((5, 18))).shape
    (5, 3, 3)
    """
    if rows.shape[-1:] == system.shape:  # vectors
        return rows
    plain = unforced(system)
    if is_matrix_system(plain):
        return plain.states(rows)
    return rows.reshape(*rows.shape[:-1], *system.shape)


def rows_of(system: Any, states: Any) -> Any:
    """Return states (..., *shape) as rows of numbers (..., dim): the inverse of `states_of`."""
    shape = system.shape
    if len(shape) < 2:
        return states
    plain = unforced(system)
    if is_matrix_system(plain):
        return plain.to_vector(states)
    return states.reshape(*states.shape[: -len(shape)], plain.dim)


def coordinates_of(system: Any) -> tuple[str, ...]:
    """Return the names of the coordinates, for events and polynomials; empty for matrices, which have none."""
    return coordinate_names(system) if unforced_matrix_system(system) is None else ()


def is_matrix_system(system: Any) -> TypeIs[MatrixSystem]:
    """Return whether a system without forces has matrices with streams, traces and spectra as states.

    A user-defined system has a `shape` instead, and states that are numbers to all but its own functions.
    """
    return isinstance(system, MatrixSystem)


def unforced_matrix_system(system: Any) -> MatrixSystem | None:
    """Return the Hamiltonian part of a matrix system, with or without forces; None for any other system."""
    plain = unforced(system)
    return plain if is_matrix_system(plain) else None


def as_vector_system(system: Any) -> Any:
    """Return a system whose states are vectors: for matrices the one on rows of numbers, otherwise the system itself.

    Examples
    --------
    >>> from coadjoint.systems.fluids.sphere_euler import sphere_euler
    >>> as_vector_system(sphere_euler(N=3)).shape
    (18,)
    """
    return system.in_numbers if is_matrix_system(system) else system


def has_structure_constants(system: Any) -> TypeIs[LiePoissonSystem]:
    """Return whether the bracket is linear, with structure constants in memory, as flows on a Lie algebra need."""
    return getattr(system.algebra, "triples", None) is not None


def has_compiled_bracket(system: Any) -> bool:
    """Return whether the kernels can evaluate the bracket, from structure constants or a function J."""
    return system.algebra is None or has_structure_constants(system)


def has_quadratic_energy(system: Any) -> bool:
    """Return whether the Hamiltonian is a polynomial of degree at most two that does not depend on time."""
    return all(term.form is not None for term in system.hamiltonian.terms())
