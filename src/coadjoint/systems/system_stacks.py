"""Stacks of systems that differ only in the coefficients of their energies, as one array."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.hamiltonians.terms import Term, built_in
from coadjoint.systems.lie_poisson import LiePoissonSystem, known_or_found_casimirs
from coadjoint.systems.vanishing_products import without_cancelling

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_DIMENSION = 1024  # of larger systems, tables of which each takes long, no structures are compared


class SystemStack(NamedTuple):
    """Some of the `systems`: of one algebra, with the same Casimirs, and energies of one structure."""

    # `numbers` (k,) are their numbers. `coefficients` (count, k) are those of all terms of the energy: of a quadratic
    # term the linear part and the entries of M, of a polynomial those of its monomials, of a function its constants,
    # and at the end the constant of the energy. The same linear coefficients are zero, no products of the field cancel
    # but those that do in all, and functions are equal or follow from constants of one pattern. `split` are those of
    # the terms that a scheme reads, from which Casimirs may be subtracted, with `factors` (casimirs, k). `forces` are
    # those numbers in tables of forces that differ, the sources `rows`, and `owners` keep their functions alive.

    systems: Sequence[Any]
    rows: Integers
    numbers: Integers
    coefficients: Floats
    split: Floats
    factors: Floats
    forces: Floats
    owners: NDArray[Any]

    @property
    def first(self) -> Any:
        return self.systems[int(self.numbers[0])]

    @property
    def size(self) -> int:
        return len(self.numbers)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the energy of the first system."""
        terms: tuple[Term, ...] = self.first.hamiltonian.terms()
        return terms

    @property
    def functions_differ(self) -> bool:
        """Whether functions among the terms have other constants in some systems."""
        counts, terms = counts_of(self.terms), self.terms
        functions = np.repeat([term.called for term in terms], counts)
        return bool(np.any(different(self.coefficients[: len(functions)][functions])))

    def take(self, members: Integers) -> SystemStack:
        columns: Any = self[2:]
        return SystemStack(self.systems, self.rows, *(column[..., members] for column in columns))

    def varying(self) -> tuple[Integers, Floats]:
        """Return the sources that differ between systems, numbered as in `program/sources.py`, with values (k, m)."""
        sources = np.concatenate([self.coefficients, self.split])
        numbers = np.concatenate([np.arange(len(self.coefficients)), -1 - np.arange(len(self.split))])
        differ = different(sources)
        values = np.concatenate([sources[differ], self.forces])
        return np.concatenate([numbers[differ], self.rows]), np.ascontiguousarray(values.T)

    @classmethod
    def joined(cls, pieces: Sequence[SystemStack]) -> SystemStack:
        """Join stacks of systems of one structure, by their numbers."""
        columns = (np.concatenate(column, axis=-1) for column in zip(*(piece[2:] for piece in pieces), strict=True))
        joined = cls(*pieces[0][:2], *columns)
        return joined if len(pieces) == 1 else joined.take(np.argsort(joined.numbers))


def different(rows: Floats) -> NDArray[np.bool_]:
    """Return which rows (count, members) have other bits for other members."""
    return np.any(rows.view(np.int64) != rows[:, :1].view(np.int64), axis=1)


def counts_of(terms: Sequence[Term]) -> list[int]:
    """Return the number of coefficients of each term in a stack."""
    return [sum(len(numbers) for part in built_in([term]) for numbers in part.structure()[1]) for term in terms]


def stacks_of(systems: Sequence[Any]) -> list[SystemStack]:
    """Return stacks of at least two of the systems."""
    known: dict[Hashable, int] = {}
    members: dict[Hashable, tuple[list[int], list[Any]]] = {}
    for m, system in enumerate(systems):
        if not isinstance(system, LiePoissonSystem) or system.dim > MAX_DIMENSION:
            continue
        keys, coefficients, constant = list[Hashable](), list[Any](), 0.0
        for term in built_in(system.hamiltonian.terms()):
            structure, numbers = term.structure()
            keys.append(structure)
            coefficients += numbers
            constant += float(term.constant)
        coefficients.append((constant,))
        try:
            key: Any = (system._kind, *_algebra(system, known), type(system.hamiltonian), *keys)
            chosen, columns = members.setdefault(key, ([], [[] for _ in coefficients]))
        except TypeError:  # functions that have no hash
            continue
        chosen.append(m)
        for column, values in zip(columns, coefficients, strict=True):
            column.append(values)
    stacks: list[SystemStack] = []
    for chosen, columns in members.values():
        if len(chosen) < 2:
            continue
        joined = np.ascontiguousarray(np.concatenate([np.array(column, dtype=np.float64).T for column in columns]))
        none, owners = np.zeros((0, len(chosen))), np.empty(len(chosen), dtype=object)
        stack = SystemStack(systems, np.arange(0), np.array(chosen), joined, joined, none, none, owners)
        groups = grouped(_presence(stack))
        pieces = [stack] if len(groups) == 1 else [stack.take(columns) for _, columns in groups]
        for piece in pieces:
            plain = without_cancelling(piece.first.algebra, piece.terms, piece.coefficients)
            stacks.append(piece if plain.all() else piece.take(np.flatnonzero(plain)))
    return [stack for stack in stacks if stack.size > 1]


def _algebra(system: LiePoissonSystem, known: dict[Hashable, int]) -> tuple[int, int]:
    """Return the numbers in `known` of what tables depend on: the algebra and the Casimirs of a system."""
    algebra, casimirs = system.algebra, system._casimirs
    keys = id(algebra), ("casimirs", id(algebra)) if casimirs is None else tuple(casimirs.items())
    if keys[0] not in known:
        constants = algebra._copied is None, algebra.dim, *(column.tobytes() for column in algebra.triples)
        known[keys[0]] = known.setdefault(constants, len(known))
    if keys[1] not in known:
        found = tuple(known_or_found_casimirs(algebra).items()) if casimirs is None else keys[1]
        known[keys[1]] = known.setdefault(found, len(known))
    return known[keys[0]], known[keys[1]]


def _presence(stack: SystemStack) -> NDArray[np.bool_]:
    """Return which linear coefficients of quadratic terms are not zero, (k, members)."""
    starts = np.cumsum([0, *counts_of(stack.terms)]).tolist()
    rows = [
        stack.coefficients[start : start + len(term.form.linear)] != 0
        for start, term in zip(starts, stack.terms, strict=False)
        if term.form is not None
    ]
    return np.concatenate([np.zeros((0, stack.size), dtype=bool), *rows])


def grouped(masks: NDArray[np.bool_]) -> list[tuple[bytes, Integers]]:
    """Return the columns of masks (rows, columns) that are equal, with a key, in the order of the first ones."""
    packed = np.ascontiguousarray(np.packbits(masks, axis=0).T)
    if not packed.shape[1]:
        return [(b"", np.arange(masks.shape[1]))]
    keys = packed.view(np.dtype((np.void, packed.shape[1])))[:, 0]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if len(first) == 1:
        return [(keys[0].tobytes(), np.arange(len(keys)))]
    order = np.argsort(inverse, kind="stable")
    pieces = np.split(order, np.cumsum(np.bincount(inverse))[:-1])
    return [(keys[first[k]].tobytes(), pieces[k]) for k in np.argsort(first).tolist()]
