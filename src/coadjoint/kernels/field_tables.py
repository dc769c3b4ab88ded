"""Construction of the arrays of a vector field and of its group equation from a system."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.field import Field, GroupField
from coadjoint.kernels.functions import CompiledFunction, Owners
from coadjoint.kernels.tables import addresses_of
from coadjoint.program.term_table import TermTable
from coadjoint.systems.system_checks import System, has_compiled_bracket


def field_of(system: System, called: bool = False) -> tuple[Field, Owners]:
    """Return the vector field of a system with its functions compiled, and the owners of the compiled functions.

    `called` means that the field is a call into Python, so that the bracket is not read. Raise TypeError if a function
    of the user cannot be compiled.
    """
    table = TermTable()
    for term in system.hamiltonian.terms():
        table.add(term)
    terms = table.table()
    addresses, keepalive = addresses_of(table.functions, len(table), "gradient", "the Hamiltonian")
    none = np.zeros(0, dtype=np.int64)
    if called:
        read = (none, none, none, np.zeros(0))
    elif has_compiled_bracket(system):
        read = (none, none, none, np.zeros(0)) if system.algebra is None else system.algebra.triples
    else:
        raise TypeError(
            f"{system.name} has no structure constants in memory, which this scheme reads; take one whose step is "
            "written in Python, a StepMethod"
        )
    i, j, k, c = read
    # Both orders of each pair (i, j), sorted by row, stable within a row.
    order = np.argsort(np.stack([i, j], axis=1).ravel(), kind="stable")
    row, column, state, constant = (np.stack(pair, axis=1).ravel()[order] for pair in ((i, j), (j, i), (k, k), (c, -c)))
    structure = none
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
    none = np.zeros(0, dtype=np.int64)
    if representation is None or system.algebra is None:
        return GroupField(0, 0, _indices(none), _indices(none), _indices(none), np.zeros(0))
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
