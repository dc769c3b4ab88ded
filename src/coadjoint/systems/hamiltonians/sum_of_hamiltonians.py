"""Sums of Hamiltonians of any types, the result of ``H1 + H2``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.product_sums import Coefficient
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, PolynomialHamiltonian, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.quadratic_sums import add_quadratics
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.validation import is_real


class SumOfHamiltonians(Summable):
    """A Hamiltonian that is the sum of others of several types; ``H1 + H2`` makes it.

    At most one summand is a Quadratic or a polynomial, and at most one a SplitHamiltonian; `sum_of` joins others. A
    scheme supports it if it supports every summand. `dim` is None until it is known for every summand.
    """

    def __init__(self, summands: Sequence[Any]) -> None:
        self.summands: tuple[Any, ...] = tuple(summands)
        dimensions = [one.dim for one in self.summands]
        known = set(dimensions) - {None}
        if len(known) > 1:
            raise ValueError(f"Hamiltonians of {' and '.join(map(str, sorted(known)))} coordinates cannot be added")
        self.dim: int | None = None if None in dimensions else dimensions[0]
        self.timed = any(one.timed for one in self.summands)

    def bind(self, n: int) -> SumOfHamiltonians:
        """Return the sum of the summands bound to dimension n."""
        return SumOfHamiltonians([as_hamiltonian(one, n) for one in self.summands])

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        return type(self)([factor * one for one in self.summands])

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t)."""
        return sum(one.value(x, t) for one in self.summands)

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        return np.asarray(sum(one.gradient(x, t) for one in self.summands))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        return np.asarray(sum(one.hessian(x, t) for one in self.summands))

    def terms(self) -> tuple[Term, ...]:
        """Return the terms of all summands; the sum must be bound."""
        return tuple(term for one in self.summands for term in one.terms())

    def __repr__(self) -> str:
        return " + ".join(map(repr, self.summands))


def summands_of(H: HamiltonianLike) -> tuple[HamiltonianLike, ...]:
    """Return the summands of a sum; for any other Hamiltonian itself."""
    return H.summands if isinstance(H, SumOfHamiltonians) else (H,)


def sum_of(first: Any, second: Any) -> Any:
    """Return the sum of two Hamiltonians, or of one and a number, which is a constant.

    Two of the same type `Quadratic`, `Polynomial` or `SplitHamiltonian` give this type, a Quadratic and a Polynomial a
    Polynomial, and all others a `SumOfHamiltonians`. Raises ValueError for different numbers of coordinates.
    """
    if any(is_real(one) and one == 0 for one in (first, second)):
        return second if is_real(first) else first  # the start value of `sum`
    simple: Any = None
    split: SplitHamiltonian | None = None
    others: list[Any] = []
    for one in _each((first, second)):
        if isinstance(one, Quadratic | Polynomial):
            simple = one if simple is None else _simple_sum(simple, one)
        elif isinstance(one, SplitHamiltonian):
            split = one if split is None else _split_sum(split, one)
        else:
            others.append(one)
    found = [one for one in (simple, split, *others) if one is not None]
    if len(found) == 1:
        return found[0]
    return SumOfHamiltonians([as_hamiltonian(one, one.dim) if isinstance(one, Polynomial) else one for one in found])


def _each(argument: Iterable[Any]) -> Iterable[Any]:
    """Yield the summands, a number as a Quadratic and a polynomial unchanged."""
    for one in argument:
        if is_real(one):
            yield Quadratic(0.0, constant=one)
        elif isinstance(one, SumOfHamiltonians):
            yield from _each(one.summands)
        elif isinstance(one, PolynomialHamiltonian):
            yield one.polynomial
        elif isinstance(one, Polynomial | Summable) or _is_user_defined(one):
            yield one
        else:
            raise TypeError(f"{short(one)} is not a Hamiltonian and cannot be added to one; give one, or a number")


def _is_user_defined(argument: Any) -> bool:
    """Return whether it is a Hamiltonian of a user-defined type."""
    own = type(argument).__module__.partition(".")[0] != __name__.partition(".")[0]
    return own and not isinstance(argument, type) and isinstance(argument, HamiltonianLike)


def _simple_sum(first: Quadratic | Polynomial, second: Quadratic | Polynomial) -> Quadratic | Polynomial:
    if isinstance(first, Quadratic) and isinstance(second, Quadratic):
        return add_quadratics(first, second)
    dim = first.dim if isinstance(first, Polynomial) else second.dim
    assert dim is not None
    one, other = (H if isinstance(H, Polynomial) else H.bind(dim).to_polynomial() for H in (first, second))
    return one + other


def _split_sum(first: SplitHamiltonian, second: SplitHamiltonian) -> SplitHamiltonian:
    if None not in (first.dim, second.dim) and first.dim != second.dim:
        raise ValueError(f"Hamiltonians of {first.dim} and {second.dim} coordinates cannot be added")
    both = (*zip(first.coordinates, first.pieces, strict=True), *zip(second.coordinates, second.pieces, strict=True))
    dim = first.dim if first.dim is not None else second.dim
    return SplitHamiltonian(both) if dim is None else SplitHamiltonian(both).bind(dim)
