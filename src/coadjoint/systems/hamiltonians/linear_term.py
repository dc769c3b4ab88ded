"""The linear term of a Hamiltonian (a field, gravity, rotors): extraction and replacement."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, PolynomialHamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.separable import Separable
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import SumOfHamiltonians
from coadjoint.systems.system import System

Floats = npt.NDArray[np.float64]
SystemT = TypeVar("SystemT", bound=System)

PLACEHOLDER_COEFFICIENT = 2.0**-300
"""Placeholder for a zero coefficient that may change later; products with it vanish."""


def linear_of(H: HamiltonianLike, n: int) -> Floats:
    """Return the coefficients of the linear term, (n,), of a bound Hamiltonian; TypeError if it has none to read."""
    if isinstance(H, Quadratic):
        (term,) = H.terms()
        assert term.form is not None
        return np.array(term.form.linear)
    linear = np.zeros(n)
    if isinstance(H, Separable):
        return linear
    if isinstance(H, SumOfHamiltonians):
        return np.asarray(sum(linear_of(summand, n) for summand in H.summands if _has_linear(summand)) + linear)
    if isinstance(H, PolynomialHamiltonian):
        for exponents, coefficient in H.polynomial.monomials.items():
            if sum(exponents) == 1:
                linear[exponents.index(1)] = float(coefficient)
        return linear
    if isinstance(H, SplitHamiltonian):
        for coordinates, piece in zip(H.coordinates, H.pieces, strict=True):
            if _has_linear(piece):
                linear[list(coordinates)] += linear_of(piece, len(coordinates))
        return linear
    raise TypeError(
        f"the Hamiltonian is a {type(H).__name__}, which has no linear term to replace; give a Quadratic, a "
        "Polynomial, a Separable or a SplitHamiltonian"
    )


def _has_linear(H: HamiltonianLike) -> bool:
    return isinstance(H, Quadratic | PolynomialHamiltonian | SplitHamiltonian)


def with_linear(system: SystemT, linear: Floats) -> SystemT:
    """Return the system with another linear term in its Hamiltonian; without closed form, integrals and parameters."""
    return with_hamiltonian(system, _replace_linear(system.hamiltonian, np.asarray(linear, dtype=np.float64)))


def with_hamiltonian(system: SystemT, hamiltonian: HamiltonianLike) -> SystemT:
    """Return the system with another bound Hamiltonian; closed form, integrals, parameters and caches are dropped."""
    changed = copy.copy(system)
    for name in list(vars(changed)):
        if isinstance(getattr(type(system), name, None), cached_property):
            del vars(changed)[name]
    fields: dict[str, Any] = {"hamiltonian": hamiltonian, "_exact": None, "_parameters": None, "_integrals": {}}
    for name, value in fields.items():
        if hasattr(system, name):
            object.__setattr__(changed, name, value)
    return changed


def with_placeholders(system: SystemT, coordinates: Sequence[int]) -> SystemT:
    """Replace zero linear coefficients, so that the Hamiltonian has every part that it can have for other values."""
    linear, chosen = linear_of(system.hamiltonian, system.dim), np.array(coordinates, dtype=np.int64)
    absent = chosen[linear[chosen] == 0.0]
    linear[absent] = PLACEHOLDER_COEFFICIENT
    return with_linear(system, linear) if len(absent) else system


def _replace_linear(H: HamiltonianLike, linear: Floats) -> HamiltonianLike:
    if isinstance(H, Quadratic):
        return H.with_linear(linear)
    if isinstance(H, PolynomialHamiltonian):
        monomials = {e: c for e, c in H.polynomial.monomials.items() if sum(e) != 1}
        n = H.polynomial.dim
        for k in np.flatnonzero(linear).tolist():
            monomials[tuple(int(i == k) for i in range(n))] = float(linear[k])
        return PolynomialHamiltonian(Polynomial(monomials, dim=n))
    if isinstance(H, SplitHamiltonian):
        return _replace_linear_in_split(H, linear)
    if isinstance(H, SumOfHamiltonians):
        return _replace_linear_in_sum(H, linear)
    if isinstance(H, Separable):
        pieces = []
        for term in H.functions():
            functions: tuple[Any, ...] = (term.value, term.gradient, *([] if term.hessian is None else [term.hessian]))
            pieces.append(((int(term.coordinates[0]),), Separable({0: functions})))
        return _replace_linear_in_split(SplitHamiltonian(pieces).bind(len(linear)), linear)
    raise TypeError(f"the Hamiltonian is a {type(H).__name__}, which has no linear term to replace")


def _replace_linear_in_sum(H: SumOfHamiltonians, linear: Floats) -> HamiltonianLike:
    """Replace the linear term of the `Quadratic` or polynomial of a sum, its first summand; add one if missing."""
    first, n = H.summands[0], len(linear)
    if not isinstance(first, Quadratic | PolynomialHamiltonian):
        first = Quadratic(np.zeros(n))
        H = SumOfHamiltonians([first, *H.summands])
    elsewhere = linear_of(H, n) - linear_of(first, n)
    return SumOfHamiltonians([_replace_linear(first, linear - elsewhere), *H.summands[1:]])


def _replace_linear_in_split(H: SplitHamiltonian, linear: Floats) -> SplitHamiltonian:
    changed = np.flatnonzero(linear != linear_of(H, len(linear))).tolist()
    pieces = list(zip(H.coordinates, H.pieces, strict=True))
    for k in changed:
        candidates = [p for p, (coordinates, piece) in enumerate(pieces) if k in coordinates and _has_linear(piece)]
        if len(candidates) > 1:
            raise ValueError(
                f"pieces {candidates[0]} and {candidates[1]} of the SplitHamiltonian are polynomials in coordinate "
                f"{k}, so its linear coefficient is ambiguous; use the coordinate in one of them"
            )
        if not candidates:
            pieces.append(((k,), Quadratic(0.0, linear=linear[k : k + 1])))
            continue
        coordinates, piece = pieces[candidates[0]]
        piece_linear = linear_of(piece, len(coordinates))
        piece_linear[coordinates.index(k)] = linear[k]
        pieces[candidates[0]] = coordinates, _replace_linear(piece, piece_linear)
    return SplitHamiltonian(pieces).bind(len(linear))


def check_linear(system: Any) -> None:
    """Raise TypeError if the Hamiltonian of a system has no linear term to replace."""
    try:
        linear_of(system.hamiltonian, system.dim)
    except TypeError as reason:
        raise TypeError(f"{short(system.name)} cannot take inputs: {reason}") from None
