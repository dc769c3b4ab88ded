"""Sums of Hamiltonians of any types, the result of ``H1 + H2``, multiples of quadratic ones, and polynomials."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import MAX_SHOWN_LENGTH, short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import (
    Hamiltonian,
    HamiltonianLike,
    as_hamiltonian,
    is_plain_function,
)
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.repeated_rows import BYTES_PER_ENTRY
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, Summable
from coadjoint.systems.hamiltonians.terms import Term, built_in
from coadjoint.systems.hamiltonians.user_hamiltonian import is_user_defined
from coadjoint.validation import is_real


class SumOfHamiltonians(Summable):
    """A Hamiltonian that is the sum of others of several types; ``H1 + H2`` makes it."""

    # At most one summand is a Quadratic or a polynomial, and at most one a SplitHamiltonian; `sum_of` joins others.

    def __init__(self, summands: Sequence[Any]) -> None:
        self.summands: tuple[Any, ...] = tuple(summands)
        dimensions = [summand.dim for summand in self.summands]
        known = set(dimensions) - {None}
        if len(known) > 1:
            raise ValueError(f"Hamiltonians of {' and '.join(map(str, sorted(known)))} coordinates cannot be added")
        self.dim: int | None = None if None in dimensions else dimensions[0]
        self.timed = any(summand.timed for summand in self.summands)

    def bind(self, n: int) -> SumOfHamiltonians:
        """Return the sum of the summands bound to dimension n."""
        return SumOfHamiltonians([as_hamiltonian(summand, n) for summand in self.summands])

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        return type(self)([factor * summand for summand in self.summands])

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return the sum of the linear parts of the summands, (n,)."""
        assert self.dim is not None
        parts = [summand.linear_part() for summand in self.summands if getattr(summand, "has_linear", False)]
        return np.asarray(sum(parts) + np.zeros(self.dim))

    def with_linear(self, linear: npt.NDArray[np.float64]) -> SumOfHamiltonians:
        """Replace the linear term of the `Quadratic` or polynomial, the first summand; add one if missing."""
        first, *rest = self.summands
        if not isinstance(first, Quadratic | PolynomialHamiltonian):
            first, rest = Quadratic(np.zeros(len(linear))), [first, *rest]
        elsewhere = SumOfHamiltonians([first, *rest]).linear_part() - first.linear_part()
        return SumOfHamiltonians([first.with_linear(linear - elsewhere), *rest])

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t)."""
        return sum(summand.value(x, t) for summand in self.summands)

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        return np.asarray(sum(summand.gradient(x, t) for summand in self.summands))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        return np.asarray(sum(summand.hessian(x, t) for summand in self.summands))

    def terms(self) -> tuple[Term, ...]:
        """Return the terms of all summands; the sum must be bound."""
        return tuple(term for summand in self.summands for term in summand.terms())

    def __repr__(self) -> str:
        text = " + ".join(map(repr, self.summands))
        return text if len(text) <= MAX_SHOWN_LENGTH else f"a sum of {len(self.summands)} Hamiltonians"


def summands_of(H: HamiltonianLike) -> tuple[HamiltonianLike, ...]:
    """Return the summands of a sum; for any other Hamiltonian itself."""
    return H.summands if isinstance(H, SumOfHamiltonians) else (H,)


def sum_of(first: Any, second: Any) -> Any:
    """Return the sum of two Hamiltonians, or of one and a number, which is a constant."""
    if any(is_real(summand) and summand == 0 for summand in (first, second)):
        return second if is_real(first) else first  # the start value of `sum`
    simple: Any = None
    split: SplitHamiltonian | None = None
    rest: list[Any] = []
    for summand in _flatten((first, second)):
        if isinstance(summand, Quadratic | Polynomial):
            simple = summand if simple is None else _simple_sum(simple, summand)
        elif isinstance(summand, SplitHamiltonian):
            split = summand if split is None else _split_sum(split, summand)
        else:
            rest.append(summand)
    summands = [summand for summand in (simple, split, *rest) if summand is not None]
    if len(summands) == 1:
        return summands[0]
    return SumOfHamiltonians(
        [as_hamiltonian(summand, summand.dim) if isinstance(summand, Polynomial) else summand for summand in summands]
    )


def _flatten(argument: Iterable[Any]) -> Iterable[Any]:
    """Yield the summands, a number as a Quadratic and a polynomial unchanged."""
    for summand in argument:
        if is_real(summand):
            yield Quadratic(0.0, constant=summand)
        elif isinstance(summand, SumOfHamiltonians):
            yield from _flatten(summand.summands)
        elif isinstance(summand, PolynomialHamiltonian):
            yield summand.polynomial
        elif isinstance(summand, Polynomial | Summable):
            yield summand
        elif is_user_defined(summand) and isinstance(summand, HamiltonianLike) and not isinstance(summand, type):
            yield summand
        elif is_plain_function(summand):
            yield Hamiltonian(summand)
        else:
            raise TypeError(f"{short(summand)} is not a Hamiltonian and cannot be added to one; give one, or a number")


def _simple_sum(first: Quadratic | Polynomial, second: Quadratic | Polynomial) -> Quadratic | Polynomial:
    if isinstance(first, Quadratic) and isinstance(second, Quadratic):
        return add_quadratics(first, second)
    dim = first.dim if isinstance(first, Polynomial) else second.dim
    assert dim is not None
    polynomial, other_polynomial = (
        H if isinstance(H, Polynomial) else H.bind(dim).to_polynomial() for H in (first, second)
    )
    return polynomial + other_polynomial


def _split_sum(first: SplitHamiltonian, second: SplitHamiltonian) -> SplitHamiltonian:
    if None not in (first.dim, second.dim) and first.dim != second.dim:
        raise ValueError(f"Hamiltonians of {first.dim} and {second.dim} coordinates cannot be added")
    pieces = (*zip(first.coordinates, first.pieces, strict=True), *zip(second.coordinates, second.pieces, strict=True))
    dim = first.dim if first.dim is not None else second.dim
    return SplitHamiltonian(pieces) if dim is None else SplitHamiltonian(pieces).bind(dim)


@ignore_overflow
def add_quadratics(first: Quadratic, second: Quadratic) -> Quadratic:
    """Return the sum of two quadratic Hamiltonians; raise ValueError on different dimensions or overflow."""
    dim = first.dim if first.dim is not None else second.dim
    if dim is None:
        return Quadratic(first.scalar + second.scalar, constant=first.constant + second.constant)
    if second.dim not in (None, dim):
        raise ValueError(f"Hamiltonians of {dim} and {second.dim} coordinates cannot be added")
    a, b = first.bind(dim).as_given(), second.bind(dim).as_given()
    count = len(a.entries) + len(b.entries)
    check_available_memory(BYTES_PER_ENTRY * count, f"a sum of matrices with {count} entries")
    rows, columns = np.r_[a.rows, b.rows], np.r_[a.columns, b.columns]
    entries = np.concatenate([a.entries, b.entries])
    order = np.lexsort((columns, rows))
    rows, columns, entries = rows[order], columns[order], entries[order]
    starts = np.flatnonzero(np.r_[True, (np.diff(rows) != 0) | (np.diff(columns) != 0)][: len(rows)])
    if len(starts):
        rows, columns, entries = rows[starts], columns[starts], np.add.reduceat(entries, starts)
    return Quadratic.from_entries(
        dim, rows, columns, _as_floats(entries), _as_floats(a.linear + b.linear), first.constant + second.constant
    )


@ignore_overflow
def scale_quadratic(H: Quadratic, factor: Coefficient) -> Quadratic:
    """Return a multiple of a quadratic Hamiltonian, bound or not; raise ValueError on overflow."""
    if H.dim is None:
        return Quadratic(H.scalar * factor, constant=H.constant * factor)
    stored = H.as_given()
    entries, linear = (
        _as_floats(stored.entries * _as_number_type(factor, stored.entries)),
        _as_floats(stored.linear * _as_number_type(factor, stored.linear)),
    )
    return Quadratic.from_entries(H.dim, stored.rows, stored.columns, entries, linear, H.constant * factor)


def _as_number_type(factor: Coefficient, numbers: npt.NDArray[Any]) -> Any:
    return factor if numbers.dtype == object else float(factor)


def _as_floats(numbers: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an array of objects as float64 if all are floats."""
    if numbers.dtype == object and all(isinstance(number, float) for number in numbers):
        return numbers.astype(np.float64)
    return numbers


def polynomial_of(hamiltonian: HamiltonianLike) -> Polynomial | None:
    """Return a bound Hamiltonian as a polynomial, with its given coefficients; None if it calls user functions."""
    if isinstance(hamiltonian, Quadratic):
        return hamiltonian.to_polynomial()
    polynomials = [term.to_polynomial() for term in built_in(hamiltonian.terms())]
    known = [polynomial for polynomial in polynomials if polynomial is not None]
    return sum(known[1:], known[0]) if len(known) == len(polynomials) else None
