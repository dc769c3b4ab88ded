"""Tables of the vector field sign * J(x) u and of the group equation g' = -sign * g rho(u)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import CompiledFunction, Owners
from coadjoint.kernels.tables.compiled import addresses_of
from coadjoint.program.term_table import Terms, TermTable
from coadjoint.systems.protocol import has_compiled_bracket
from coadjoint.systems.system_checks import System


class Field(NamedTuple):
    """The field x' = sign * J(x) grad H(x, t) in `size` coordinates.

    On a Lie algebra row i of J has the entries first[i] to first[i + 1], each a nonzero structure constant:
    `constant` = sign * c_ij^k with j = `column`, k = `state`. If `nonlinear`, `structure` holds the address of the
    compiled function x -> J(x). `longest` is the largest number of rows of a term of H.
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


class GroupField(NamedTuple):
    """The equation g' = -sign * g rho(u) for d x d matrices; `size` is d, or 0 if no group element is computed.

    There are `entries` nonzeros: (rho_i)_ab with i = `element`, a = `row`, b = `column`, and `value` = -sign *
    (rho_i)_ab.
    """

    size: int
    entries: int
    element: NDArray[np.uint32]
    row: NDArray[np.uint32]
    column: NDArray[np.uint32]
    value: NDArray[np.float64]


def field_of(system: System, called: bool = False) -> tuple[Field, Owners]:
    """Return the vector field of a system with its functions compiled, and the owners of the compiled functions.

    `called` means that the field is a call into Python, which does not read the bracket. Raise TypeError if a user
    function cannot be compiled.
    """
    table = TermTable()
    for term in system.hamiltonian.terms():
        table.add(term)
    terms = table.table()
    addresses, keepalive = addresses_of(table.functions, len(table), "gradient", "the Hamiltonian")
    no_integers = np.zeros(0, dtype=np.int64)
    if called:
        triples = (no_integers, no_integers, no_integers, np.zeros(0))
    elif has_compiled_bracket(system):
        triples = (
            (no_integers, no_integers, no_integers, np.zeros(0)) if system.algebra is None else system.algebra.triples
        )
    else:
        raise TypeError(
            f"{system.name} has no structure constants in memory, which this scheme reads; use a scheme whose step "
            "is written in Python, a StepMethod"
        )
    i, j, k, c = triples
    # Both orders of each pair (i, j), sorted by row, stable within a row.
    order = np.argsort(np.stack([i, j], axis=1).ravel(), kind="stable")
    row, column, state, constant = (np.stack(pair, axis=1).ravel()[order] for pair in ((i, j), (j, i), (k, k), (c, -c)))
    structure = no_integers
    if system.algebra is None and not called:
        n = system.dim
        compiled = CompiledFunction(
            system.structure_function, n, n * n, scalar=False, flat=True, timed=False, what="the structure matrix"
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
    )
    return field, keepalive


def group_of(system: System, representation: Any) -> GroupField:
    """Return the group equation for None, "coadjoint" (the coadjoint matrix) or a representation (n, d, d); size 0 for
    None.
    """
    no_integers = np.zeros(0, dtype=np.int64)
    if representation is None or system.algebra is None:
        return GroupField(0, 0, _indices(no_integers), _indices(no_integers), _indices(no_integers), np.zeros(0))
    if isinstance(representation, str):
        # (D_u)_ac = sum_i u_i c_ai^c, from both orders of each listed pair
        i, j, k, c = system.algebra.triples
        element, row, column = np.concatenate([j, i]), np.concatenate([i, j]), np.concatenate([k, k])
        value, size = np.concatenate([c, -c]), system.dim
    else:
        rho = np.asarray(representation, dtype=np.float64)
        element, row, column = np.nonzero(rho)
        value, size = rho[element, row, column], rho.shape[1]
    return GroupField(size, len(value), _indices(element), _indices(row), _indices(column), -system.sign * value)


def substeps(fractions: Sequence[float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lengths of the substeps of a step, and their start times, in units of the step.

    Examples
    --------
    >>> substeps((0.75, -0.5, 0.75))[1].tolist()
    [0.0, 0.75, 0.25]
    """
    lengths = np.array(fractions, dtype=np.float64)
    return lengths, np.array([0.0, *accumulate(fractions)][:-1], dtype=np.float64)


def _indices(values: Any) -> NDArray[np.uint32]:
    return np.ascontiguousarray(values, dtype=np.uint32)
