"""The program: rows of elementary flows in three sections, the shares that give their angles, and what they act on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.methods.base import FlowMethod, Sweep
from coadjoint.program.actions import Action, BasisMatrices, build_action
from coadjoint.program.decompose import decompose
from coadjoint.program.numbers import Number, array_of, convert
from coadjoint.program.parts import LinearShare, Part, PolynomialShare
from coadjoint.program.rational import rational_frequencies
from coadjoint.program.terms import Terms, TermTable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.terms import FunctionTerm

MOST_REMEMBERED = 64  # forms: what larger systems do is not kept


class Rows(NamedTuple):
    """The rows, section after section.

    Row r moves by part[r] over the time coefficient[r] * h, with functions of time taken at t + moment[r] * h. Section
    s (0 start, 1 step, 2 finish) has the rows section[s] to section[s + 1]. The first step is *start*, every other one
    *step*; *finish* completes a state for output. Of a processed scheme P K P^-1, *start* is P^-1 and K, *step* is K,
    and *finish* is P.
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
    frequency : ndarray, shape (angles,)
        The frequencies of the angles that are rational rotations, part after part; 0 for exact ones.
    shift : tuple of (Polynomial, float)
        Casimirs and factors taken off the Hamiltonian: what `group` leaves out.
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
    frequency: NDArray[Any]
    shift: tuple[tuple[Polynomial, float], ...]


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
    >>> paper = co.Splitting(order=2, parts="coordinates")
    >>> program = build_program(co.systems.rigid_body(inertia=(1, 2, 3)), paper)
    >>> [int(p) for p in program.rows.part]
    [0, 1, 2, 1, 0, 1, 2, 1, 0]
    >>> [int(s) for s in program.rows.section]
    [0, 4, 8, 9]
    """
    decomposition = decompose(system, method.parts)
    parts = decomposition.parts
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
    count = sum(len(part.forms) for part in parts)
    if number is float and count <= MOST_REMEMBERED:
        state = _remembered_action(system.algebra, tuple(part.forms for part in parts))
    else:
        state = build_action(BasisMatrices.coadjoint(system.algebra), parts, number)
    frequency = array_of(number, [0] * count)
    if method.rotation == "rational":
        frequency = rational_frequencies(system, parts, state, number)
    return Program(
        rows=_rows(
            tuple(method.sweeps(number)),
            tuple(method.processor(number)),
            _Joining.of(parts, frequency),
            system.sign,
            number,
        ),
        parts=parts,
        terms=table.table(number),
        share=np.array(share, dtype=np.uint32),
        functions=table.functions,
        state=state,
        group=_group_action(system, group, parts, number),
        sign=system.sign,
        number=number,
        frequency=frequency,
        shift=decomposition.shift,
    )


# Members of an ensemble differ in their constants; what their parts do is often the same.
@lru_cache(maxsize=256)
def _remembered_action(algebra: LieAlgebra, forms: tuple[Any, ...]) -> Action:
    return build_action(BasisMatrices.coadjoint(algebra), [Part(own, ()) for own in forms], float)


def _group_action(system: LiePoissonSystem, group: Any, parts: tuple[Part, ...], number: Number) -> Action | None:
    if group is None:
        return None
    representation = None if isinstance(group, str) else group
    return build_action(BasisMatrices.on_group(system.algebra, representation), parts, number)


class _Row(NamedTuple):
    part: int
    coefficient: Any
    moment: Any
    turn: bool = False


class _Joining(NamedTuple):
    """What decides whether two flows of one part, one after the other, are one: which parts depend on time, and which
    turn rationally.
    """

    timed: tuple[bool, ...]
    rational: tuple[bool, ...]

    @classmethod
    def of(cls, parts: tuple[Part, ...], frequency: NDArray[Any]) -> _Joining:
        ends = np.cumsum([0] + [len(part.forms) for part in parts])
        rational = tuple(bool(np.any(frequency[a:b] != 0)) for a, b in pairwise(ends))
        return cls(tuple(part.timed for part in parts), rational)

    def join(self, last: _Row, row: _Row, moment: Any) -> _Row | None:
        """Return two flows as one, the first at the given moment of the step of the second, or None.

        Not where each of two flows has its own moment; and two half rational rotations are not a whole one.
        """
        apart = self.timed[row.part] and moment != row.moment
        if last.part != row.part or apart or (self.rational[row.part] and not row.turn):
            return None
        return _Row(row.part, last.coefficient + row.coefficient, row.moment)

    def joined(self, rows: Iterable[_Row]) -> list[_Row]:
        found: list[_Row] = []
        for row in rows:
            both = self.join(found[-1], row, found[-1].moment) if found else None
            if both is None:
                found.append(row)
            else:
                found[-1] = both
        return found


@lru_cache(maxsize=64)
def _rows(sweeps: tuple[Sweep, ...], after: tuple[Sweep, ...], joining: _Joining, sign: int, number: Number) -> Rows:
    kernel = joining.joined(_flows(sweeps, len(joining.timed), number))
    processor = joining.joined(_flows(after, len(joining.timed), number))
    undone = [row._replace(coefficient=-row.coefficient) for row in processor[::-1]]
    later = [row._replace(moment=row.moment + 1) for row in processor]
    start, step, finish = [*undone, *kernel], kernel, later
    # The last row belongs to the step before: seen from this one its moment lies a whole step earlier.
    if len(kernel) > 1 and (outer := joining.join(kernel[-1], kernel[0], kernel[-1].moment - 1)):
        start, step, finish = start[:-1], [outer, *kernel[1:-1]], [kernel[-1], *later]
    start, finish = joining.joined(start), joining.joined(finish)
    everything = [*start, *step, *finish]
    ends = [0, len(start), len(start) + len(step), len(everything)]
    return Rows(
        np.array([row.part for row in everything], dtype=np.uint32),
        array_of(number, [sign * row.coefficient for row in everything]),
        array_of(number, [row.moment for row in everything]),
        np.array(ends, dtype=np.uint32),
    )


def _flows(sweeps: Sequence[Sweep], parts: int, number: Number) -> Iterable[_Row]:
    for sweep in sweeps:
        coefficient, moment = convert(number, sweep.coefficient), convert(number, sweep.moment)
        for place in range(parts):
            part = place if sweep.forward else parts - 1 - place
            yield _Row(part, coefficient, moment, sweep.turn and place == 0)
