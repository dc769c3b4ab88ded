"""Tables of the vector field sign * J(x) u and of the group equation g' = -sign * g rho(u)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import compiled_function
from coadjoint.kernels.tables.compiled import Owners, addresses_of, unrecorded
from coadjoint.program.generators import given_matrices
from coadjoint.program.sources import CoefficientNumbers, Sources, sources_of
from coadjoint.program.term_table import FUNCTION, Terms, TermTable
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_structure
from coadjoint.systems.vanishing_products import FieldProducts, Products, field_products


class Field(NamedTuple):
    """The field x' = sign * J(x) grad H(x, t). On a Lie algebra, row i of J has the entries first[i] to first[i + 1]:
    `constant` = sign * c_ij^k with j = `column`, k = `state`; if `nonlinear`, `structure` is the address of x -> J(x).
    `separated` and the fields after it are described in `boundary/tables.hpp`.
    """

    size: int
    sign: float
    first: NDArray[np.uint32]
    column: NDArray[np.uint32]
    state: NDArray[np.uint32]
    constant: NDArray[np.float64]
    nonlinear: bool
    structure: NDArray[np.int64]
    terms: Terms
    addresses: NDArray[np.int64]
    longest: int
    separated: bool
    own_first: NDArray[np.uint32]
    own_column: NDArray[np.uint32]
    own_state: NDArray[np.uint32]
    own_constant: NDArray[np.float64]
    partials: int
    partial_rows: int
    partial: NDArray[np.uint32]
    partial_row: NDArray[np.uint32]


class GroupField(NamedTuple):
    """The equation g' = -sign * g rho(u) of d x d matrices: nonzeros `value` = -sign * (rho_element)_row,column."""

    size: int
    entries: int
    element: NDArray[np.uint32]
    row: NDArray[np.uint32]
    column: NDArray[np.uint32]
    value: NDArray[np.float64]


def field_of(system: System, called: bool = False) -> tuple[Field, Owners]:
    """Return the vector field of a system with its functions compiled, and the owners of the compiled functions."""
    table = terms_of_field(system)
    terms = table.table()
    addresses, keepalive = addresses_of(table.functions, len(table), "gradient", "the Hamiltonian")
    no_integers = np.zeros(0, dtype=np.int64)
    if called:
        triples = (no_integers, no_integers, no_integers, np.zeros(0))
    elif system.has_compiled_bracket:
        triples = (
            (no_integers, no_integers, no_integers, np.zeros(0)) if system.algebra is None else system.algebra.triples
        )
    else:
        raise TypeError(
            f"{system.name} has neither structure constants in memory nor a structure_function, which this scheme "
            "reads; define structure_function(x), or use a scheme whose step is written in Python, a StepMethod"
        )
    i, j, k, c = triples
    # Both orders of each pair (i, j), sorted by row, stable within a row.
    order = np.argsort(np.stack([i, j], axis=1).ravel(), kind="stable")
    pairs: Any = ((i, j), (j, i), (k, k), (c, -c))
    row, column, state, constant = (np.stack(pair, axis=1).ravel()[order] for pair in pairs)
    structure = no_integers
    if system.algebra is None and not called:
        n = system.dim
        check_structure(system)
        compiled = compiled_function(
            cast(Any, system.structure_function),
            n,
            n * n,
            scalar=False,
            flat=True,
            timed=False,
            what="the structure matrix",
        )
        structure, keepalive = np.array([compiled.address], dtype=np.int64), (*keepalive, compiled)
    field = Field(
        system.dim,
        float(system.sign),
        _indices(np.searchsorted(row, np.arange(system.dim + 1))),
        _indices(column),
        _indices(state),
        np.ascontiguousarray(system.sign * constant, dtype=np.float64),
        len(structure) > 0,
        structure,
        terms,
        addresses,
        max(1, int(np.max(np.diff(terms.row.astype(np.int64)), initial=0))),
        *_own_products(system, Products(row, state, column, constant), terms),
    )
    return field, keepalive


def sources_of_field(system: System, field: Field) -> Sources:
    """Return the sources of the constants of a field, which is part of a table."""
    terms = system.hamiltonian.terms()
    if field.terms.size != len(terms):
        unrecorded()
    found = sources_of(field.terms, np.arange(len(terms)), field.terms.target, terms).within("terms.")
    # Numbers decide which products cancel.
    computed = {"separated": CoefficientNumbers.of(terms).others} if field.separated else {}
    return found.and_of(Sources(computed=computed)).within("field.")


def terms_of_field(system: System) -> TermTable:
    """Return the terms of the energy, with the functions that a field separates."""
    own, table = _separated(system), TermTable()
    for term in own.terms if own else system.hamiltonian.terms():
        table.add(term)
    return table


def _separated(system: System) -> FieldProducts | None:
    return field_products(system) if system.has_structure_constants else None


def _own_products(system: System, products: Products, terms: Terms) -> tuple[Any, ...]:
    """Return the values from `separated` on."""
    n, own, none = system.dim, _separated(system), _indices(())
    if own is None:
        return False, none, none, none, np.zeros(0), 0, 0, none, none
    column = own.columns(products, n)
    retained = column >= 0
    row, state, _, constant = (values[retained] for values in products)
    column = column[retained]
    rows = terms.row.astype(np.int64)
    sources = []
    for number, entries in enumerate(own.partial):
        for term, entry in entries:
            if terms.kind[term] != FUNCTION:
                entry = int(np.flatnonzero(terms.target[rows[term] : rows[term + 1]] == entry)[0])
            sources.append((int(rows[term]) + entry, number))
    partial_row, partial = np.array(sorted(sources), dtype=np.int64).reshape(-1, 2).T
    return (
        True,
        _indices(np.searchsorted(row, np.arange(n + 1))),
        _indices(column),
        _indices(state),
        np.ascontiguousarray(system.sign * constant, dtype=np.float64),
        len(own.partial),
        len(sources),
        _indices(partial),
        _indices(partial_row),
    )


def group_of(system: System, representation: Any) -> GroupField:
    """Return the group equation for None (size 0), "coadjoint" (the coadjoint matrix) or a representation (n, d, d)."""
    no_integers = np.zeros(0, dtype=np.int64)
    if representation is None or system.algebra is None:
        return GroupField(0, 0, _indices(no_integers), _indices(no_integers), _indices(no_integers), np.zeros(0))
    rho = given_matrices(representation)
    if rho is None:
        # (D_u)_ac = sum_i u_i c_ai^c, from both orders of each listed pair
        i, j, k, c = system.algebra.triples
        element, row, column = np.concatenate([j, i]), np.concatenate([i, j]), np.concatenate([k, k])
        value, size = np.concatenate([c, -c]), system.dim
    else:
        rho = np.asarray(rho, dtype=np.float64)
        element, row, column = np.nonzero(rho)
        value, size = rho[element, row, column], rho.shape[1]
    return GroupField(size, len(value), _indices(element), _indices(row), _indices(column), -system.sign * value)


def substeps(fractions: Sequence[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lengths of the substeps of a step, and their start times, in units of the step."""
    lengths = np.array(fractions, dtype=np.float64)
    return lengths, np.array([0.0, *accumulate(fractions)][:-1], dtype=np.float64)


def _indices(values: Any) -> NDArray[np.uint32]:
    return np.ascontiguousarray(values, dtype=np.uint32)
