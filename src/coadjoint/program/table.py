"""The program: rows of elementary flows in three sections, the shares that give their angles, and what they act on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.base import FlowMethod, Sweep
from coadjoint.program.actions import Action, BasisMatrices, build_action
from coadjoint.program.numbers import Number, array_of, convert
from coadjoint.program.parts import LinearShare, Part, PolynomialShare
from coadjoint.program.split import split
from coadjoint.program.terms import Terms, TermTable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.terms import FunctionTerm


class Rows(NamedTuple):
    """The rows, section after section.

    Row r moves by part[r] over the time coefficient[r] * h, with functions of time taken at t + moment[r] * h. Section
    s (0 start, 1 step, 2 finish) has the rows section[s] to section[s + 1]. The first step is *start*, every other one
    *step*; *finish* completes a state for output.
    """

    part: NDArray[np.uint32]
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    section: NDArray[np.uint32]


@dataclass(frozen=True)
class Program:
    """A splitting of one system as a table, without Numba: the same arrays serve every reading.

    Parameters
    ----------
    rows : Rows
        What is applied in which order.
    parts : tuple of Part
        The exact flows.
    terms : Terms
        The shares of all parts.
    share : ndarray of uint32, shape (parts + 1,)
        Part p has the shares share[p] to share[p + 1].
    functions : dict
        Number of a FUNCTION term -> the user's functions.
    state : Action
        The coadjoint action on the momentum.
    group : Action or None
        The action on the rows of the group element, where one is carried.
    sign : int
        Sign of the equation; the rows' coefficients include it.
    number : callable
        Number type of the constants.
    """

    rows: Rows
    parts: tuple[Part, ...]
    terms: Terms
    share: NDArray[np.uint32]
    functions: dict[int, FunctionTerm]
    state: Action
    group: Action | None
    sign: int
    number: Number


def build_program(
    system: LiePoissonSystem,
    method: FlowMethod,
    *,
    group: NDArray[Any] | str | None = None,
    number: Number = float,
) -> Program:
    """Write a splitting method for a system as a table.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    method : FlowMethod
        The splitting.
    group : ndarray of shape (n, d, d), "coadjoint", or None
        The representation that the group element is carried in.
    number : callable
        Number type: `float`, or for instance `mpmath.mpf` for the plain reading.

    Returns
    -------
    Program
        The table.

    Examples
    --------
    >>> import coadjoint as co
    >>> program = build_program(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=2))
    >>> [int(p) for p in program.rows.part]
    [0, 1, 2, 1, 0, 1, 2, 1, 0]
    >>> [int(s) for s in program.rows.section]
    [0, 4, 8, 9]
    """
    parts = split(system, method.parts)
    if not parts:
        raise ValueError(f"Splitting has nothing to do for {system.name}: its Hamiltonian is constant")
    table, share = TermTable(), [0]
    for part in parts:
        for given in part.shares:
            if isinstance(given, LinearShare):
                rows = np.zeros(len(given.offset), dtype=np.int64)
                table.add_linear(rows, given.offset, given.indptr, given.columns, given.weights)
            elif isinstance(given, PolynomialShare):
                table.add_polynomial(given.coordinates, given.polynomial)
            else:
                table.add_function(given.term)
        share.append(len(table))
    return Program(
        rows=_rows(method.sweeps(number), parts, system.sign, number),
        parts=parts,
        terms=table.table(number),
        share=np.array(share, dtype=np.uint32),
        functions=table.functions,
        state=build_action(BasisMatrices.coadjoint(system.algebra), parts, number),
        group=_group_action(system, group, parts, number),
        sign=system.sign,
        number=number,
    )


def _group_action(system: LiePoissonSystem, group: Any, parts: tuple[Part, ...], number: Number) -> Action | None:
    if group is None:
        return None
    representation = None if isinstance(group, str) else group
    return build_action(BasisMatrices.on_group(system.algebra, representation), parts, number)


class _Row(NamedTuple):
    part: int
    coefficient: Any
    moment: Any


def _rows(sweeps: Sequence[Sweep], parts: tuple[Part, ...], sign: int, number: Number) -> Rows:
    sequence: list[_Row] = []
    for sweep in sweeps:
        order = range(len(parts)) if sweep.forward else range(len(parts) - 1, -1, -1)
        for part in order:
            row = _Row(part, convert(number, sweep.coefficient), convert(number, sweep.moment))
            if sequence and (merged := _merge(sequence[-1], row, parts, sequence[-1].moment)):
                sequence[-1] = merged
            else:
                sequence.append(row)
    start, step, finish = sequence, sequence, list[_Row]()
    # The last row belongs to the step before: seen from this one its moment lies a whole step earlier.
    if len(sequence) > 1 and (outer := _merge(sequence[-1], sequence[0], parts, sequence[-1].moment - 1)):
        start, step, finish = sequence[:-1], [outer, *sequence[1:-1]], sequence[-1:]
    everything = [*start, *step, *finish]
    ends = [0, len(start), len(start) + len(step), len(everything)]
    return Rows(
        np.array([row.part for row in everything], dtype=np.uint32),
        array_of(number, [sign * row.coefficient for row in everything]),
        array_of(number, [row.moment for row in everything]),
        np.array(ends, dtype=np.uint32),
    )


def _merge(last: _Row, row: _Row, parts: tuple[Part, ...], moment: Any) -> _Row | None:
    """Two flows of one part in a row are one flow, unless it depends on time and each has its own moment."""
    if last.part != row.part or (parts[row.part].timed and moment != row.moment):
        return None
    return _Row(row.part, last.coefficient + row.coefficient, row.moment)
