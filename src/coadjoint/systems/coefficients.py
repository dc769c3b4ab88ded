"""Coefficients of Hamiltonians: of their monomials, as sorted arrays, and of the linear term, which may change."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import distinct
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.hamiltonians.summable import Summable, no_linear_term
from coadjoint.systems.hamiltonians.terms import built_in
from coadjoint.systems.system import System

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Key = tuple[int, ...]
"""A monomial: its coordinates, sorted, each as often as its exponent."""

SystemT = TypeVar("SystemT", bound=System)

# Bits of a coordinate in the code of a monomial.
CODE_BITS = 31

PLACEHOLDER_COEFFICIENT = 2.0**-300
"""Placeholder for a zero coefficient that may change later; products with it vanish."""


class Monomials(NamedTuple):
    """Distinct monomials, sorted: those up to the second degree by their codes, and then the others."""

    # The code of x_i x_j, i <= j, is (i + 1) 2^31 + j + 1, that of x_i is i + 1, and that of a constant zero.

    codes: Integers
    others: tuple[Key, ...] = ()

    @classmethod
    def joined(cls, pieces: Sequence[Monomials]) -> Monomials:
        """Return the monomials of all pieces."""
        if not pieces:
            return cls(np.zeros(0, dtype=np.int64))
        codes = pieces[0].codes
        if not all(np.array_equal(codes, one.codes) for one in pieces[1:]):
            codes = distinct(np.concatenate([one.codes for one in pieces]))
        others = {key for one in pieces for key in one.others}
        return cls(codes, tuple(sorted(others, key=lambda key: (len(key), key))))

    @property
    def size(self) -> int:
        return len(self.codes) + len(self.others)

    @property
    def keys(self) -> list[Key]:
        """The monomials by their coordinates."""
        first, second = decoded(self.codes)
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        return [(i, j) if i >= 0 else (j,) if j >= 0 else () for i, j in pairs] + list(self.others)

    def positions(self, part: Monomials) -> Integers:
        """Return the positions of some of these monomials."""
        number = {key: k for k, key in enumerate(self.others, len(self.codes))} if part.others else {}
        of_others = np.array([number[key] for key in part.others], dtype=np.int64)
        return np.concatenate([np.searchsorted(self.codes, part.codes), of_others])

    def where(self, chosen: NDArray[np.bool_]) -> Monomials:
        count = len(self.codes)
        others = zip(self.others, chosen[count:].tolist(), strict=True)
        return Monomials(self.codes[chosen[:count]], tuple(key for key, one in others if one))


class EnergyCoefficients(NamedTuple):
    """Coefficients `values` of monomials, complex where an energy is differentiated."""

    monomials: Monomials
    values: NDArray[Any]

    @classmethod
    def summed(cls, codes: Integers, values: NDArray[Any], others: Mapping[Key, Any]) -> Self:
        """Construct from codes that may be repeated, whose values are added in their order, and other monomials."""
        distinct, position = np.unique(codes, return_inverse=True)
        sums = np.zeros(len(distinct), dtype=values.dtype)
        np.add.at(sums, position, values)
        keys = sorted(others, key=lambda key: (len(key), key))
        return cls(Monomials(distinct, tuple(keys)), np.concatenate([sums, [others[key] for key in keys]]))

    @classmethod
    def of_distinct(cls, codes: Integers, values: NDArray[Any]) -> Self:
        """Construct from codes that are not repeated."""
        order = np.argsort(codes, kind="stable")
        return cls(Monomials(codes[order]), values[order])

    def equal(self, other: EnergyCoefficients) -> bool:
        return (
            np.array_equal(self.monomials.codes, other.monomials.codes)
            and self.monomials.others == other.monomials.others
            and np.array_equal(self.values, other.values)
        )

    def without_zeros(self) -> EnergyCoefficients:
        """Return the coefficients that are not zero, with their monomials."""
        return self.where(self.values != 0.0)

    def where(self, chosen: NDArray[np.bool_]) -> EnergyCoefficients:
        return EnergyCoefficients(self.monomials.where(chosen), self.values[chosen])

    def at(self, x: Floats) -> Any:
        """Return the energy at a state."""
        first, second = decoded(self.monomials.codes)
        one = np.append(x, 1.0)  # the last for an index of -1
        products = [*(one[first] * one[second]), *(np.prod(x[list(key)]) for key in self.monomials.others)]
        return self.values @ np.array(products, dtype=np.float64)

    def by_key(self) -> dict[Key, float]:
        """Return the coefficients by the coordinates of their monomials."""
        return dict(zip(self.monomials.keys, self.values.tolist(), strict=True))


def encoded(first: NDArray[Any], second: NDArray[Any]) -> Integers:
    """Return the codes of x_i x_j for i <= j; with i = -1 those of x_j, and with both -1 that of a constant."""
    return ((first.astype(np.int64) + 1) << CODE_BITS) + (second.astype(np.int64) + 1)


def decoded(codes: Integers) -> tuple[Integers, Integers]:
    """Return i and j of `encoded`."""
    return (codes >> CODE_BITS) - 1, (codes & (2**CODE_BITS - 1)) - 1


def coefficients_of(system: Any) -> EnergyCoefficients:
    """Return the coefficients of the monomials of H; functions of the user have none."""
    codes, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    others: dict[Key, float] = {}

    def add(first: NDArray[Any], second: NDArray[Any], numbers: Any) -> None:
        codes.append(encoded(first, second))
        values.append(np.asarray(numbers, dtype=np.float64))

    for term in built_in(system.hamiltonian.terms()):
        add(np.array([-1]), np.array([-1]), [term.constant])
        form, polynomial = term.form, term.to_polynomial() if term.form is None else None
        if form is not None:
            i = np.flatnonzero(form.linear)
            add(np.full(len(i), -1), i, form.linear[i])
            i, j = form.rows, form.indices
            upper = i <= j
            i, j, numbers = i[upper], j[upper], form.values[upper]
            add(i, j, np.where(i == j, 0.5 * numbers, numbers))
        elif polynomial is not None:
            low, high = _by_degree({exponents: float(one) for exponents, one in polynomial.monomials.items()})
            codes.append(low[0])
            values.append(np.asarray(low[1], dtype=np.float64))
            others |= {key: others.get(key, 0.0) + value for key, value in high.items()}
    return EnergyCoefficients.summed(np.concatenate(codes), np.concatenate(values), others)


def coordinates_of(exponents: tuple[int, ...]) -> Key:
    """Return the coordinates of a monomial, each as often as its exponent."""
    return tuple(factors_of(exponents))


def _by_degree(monomials: Mapping[tuple[int, ...], Any]) -> tuple[tuple[Integers, list[Any]], dict[Key, Any]]:
    """Return the codes and coefficients of the monomials up to the second degree, and the others."""
    keys = {coordinates_of(exponents): value for exponents, value in monomials.items()}
    low = {(-1, -1, *key)[-2:]: value for key, value in keys.items() if len(key) <= 2}
    first, second = np.array(list(low), dtype=np.int64).reshape(-1, 2).T
    return (encoded(first, second), list(low.values())), {key: one for key, one in keys.items() if len(key) > 2}


def coefficients_in(energy: Any) -> EnergyCoefficients:
    """Return the coefficients of an energy, of any numbers, in one of the forms that `ready_made` accepts."""
    if isinstance(energy, EnergyCoefficients):
        return energy
    if isinstance(energy, Mapping):
        (codes, low), others = _by_degree(energy)
        return EnergyCoefficients.summed(codes, np.array(low), others)
    return _of_quadratic(*energy)


def _of_quadratic(M: Any, linear: Any = (), constant: Any = 0.0) -> EnergyCoefficients:
    M, linear = np.asarray(M), np.asarray(linear)
    rows, columns = (np.flatnonzero(M),) * 2 if M.ndim == 1 else np.nonzero(np.triu(M))
    entries, i = M[rows] if M.ndim == 1 else M[rows, columns], np.flatnonzero(linear)
    none = np.full(1, -1)
    return EnergyCoefficients.of_distinct(
        np.concatenate([encoded(none, none), encoded(np.full(len(i), -1), i), encoded(rows, columns)]),
        np.concatenate([[constant], linear[i], np.where(rows == columns, 0.5 * entries, entries)]),
    )


def linear_of(H: HamiltonianLike) -> Floats:
    """Return the coefficients of the linear term, (n,), of a bound Hamiltonian; TypeError if it has none to read."""
    return _with_linear_term(H).linear_part()


def _with_linear_term(H: HamiltonianLike) -> Summable:
    if not isinstance(H, Summable):
        raise no_linear_term(H)
    return H


def with_linear(system: SystemT, linear: Floats) -> SystemT:
    """Return the system with another linear term in its Hamiltonian; without closed form, integrals and parameters."""
    H = _with_linear_term(system.hamiltonian)
    changed = with_hamiltonian(system, H.with_linear(np.asarray(linear, dtype=np.float64)))
    base = system._base_parameters if system.parameters is None else system.parameters
    object.__setattr__(changed, "_base_parameters", base)
    return changed


def with_hamiltonian(system: SystemT, hamiltonian: HamiltonianLike) -> SystemT:
    """Return the system with another bound Hamiltonian; closed form, integrals, parameters and caches are dropped."""
    changed = copy.copy(system)
    for name in list(vars(changed)):
        if isinstance(getattr(type(system), name, None), cached_property):
            del vars(changed)[name]
    fields: dict[str, Any] = {"hamiltonian": hamiltonian, "_integrals": {}}
    fields |= dict.fromkeys(("closed_form", "_parameters", "_base_parameters", "_constants"))
    for name, value in fields.items():
        if hasattr(system, name):
            object.__setattr__(changed, name, value)
    return changed


def with_placeholders(system: SystemT, coordinates: Sequence[int]) -> SystemT:
    """Replace zero linear coefficients, so that the Hamiltonian has every part that it can have for other values."""
    linear, chosen = linear_of(system.hamiltonian), np.array(coordinates, dtype=np.int64)
    absent = chosen[linear[chosen] == 0.0]
    linear[absent] = PLACEHOLDER_COEFFICIENT
    return with_linear(system, linear) if len(absent) else system


def check_linear(system: Any) -> None:
    """Raise TypeError if the Hamiltonian of a system has no linear term to replace."""
    try:
        linear_of(system.hamiltonian)
    except TypeError as reason:
        raise TypeError(f"{short(system.name)} cannot take inputs: {reason}") from None
