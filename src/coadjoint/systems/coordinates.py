"""Names of the coordinates of systems."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import coordinate_names as default_names
from coadjoint.algebra.polynomials.polynomial_format import names_of_basis
from coadjoint.systems.hamiltonians.hamiltonian import PolynomialHamiltonian
from coadjoint.systems.registry import gallery_entry_of

Function = TypeVar("Function")


def coordinate_names(system: Any, count: int | None = None) -> tuple[str, ...]:
    """Return `count` (default: `dim`) coordinate names as plain text: those that the system or its algebra declares,
    else x1, x2, ...

    Examples
    --------
    >>> from coadjoint.systems.bodies.rigid_body import rigid_body
    >>> coordinate_names(rigid_body((1, 2, 3)))
    ('x1', 'x2', 'x3')
    """
    from coadjoint.systems.protocol import unforced  # that file imports this one

    system = unforced(system)
    count = system.dim if count is None else count
    entry = gallery_entry_of(system.name)
    names = () if entry is None else entry.names(count)
    if names:
        return names
    basis = getattr(system.algebra, "basis", ())
    return names_of_basis(basis) if len(basis) == count else tuple(default_names(count))


def in_coordinates_of(system: Any, function: Function) -> Function:
    """Return a function of the state; if it is a polynomial, it is printed with the coordinate names of the system."""
    result: Any = function
    if isinstance(function, Polynomial):
        result = function.named(coordinate_names(system))
    elif isinstance(function, PolynomialHamiltonian):
        named = function.polynomial.named(coordinate_names(system))
        result = function if named is function.polynomial else PolynomialHamiltonian(named)
    return result


def all_in_coordinates_of(system: Any, functions: Mapping[str, Any]) -> dict[str, Any]:
    """Return functions of the state by name, see `in_coordinates_of`."""
    return {name: in_coordinates_of(system, function) for name, function in functions.items()}
