"""A flow table: the sub-flows of a splitting in three sections, with their angles and actions; export as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.actions import Action, build_action, copied_action, rational_frequencies
from coadjoint.program.generators import NOTHING_OMITTED, BasisMatrices, NotSplittable, given_matrices
from coadjoint.program.numbers import Number, array_of
from coadjoint.program.parts.casimir_shifts import quadratic_casimirs, shifted_terms
from coadjoint.program.parts.decompose import ChosenParts, decompose
from coadjoint.program.parts.part import Parts
from coadjoint.program.separated_parts import separated_parts
from coadjoint.program.sources import CoefficientNumbers, Sources, sources_of_parts
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, Pattern, SparseRows
from coadjoint.program.sweeps import FlowStages, JoinRules, Swept, stages_of
from coadjoint.program.term_table import Terms, TermTable
from coadjoint.systems.hamiltonians.repeated_rows import RepeatedRows
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.vanishing_products import field_products

# Smallest number of angles in each share of a table whose rows repeat; loops read shorter shares row by row.
MIN_REPEATED_ROWS = 256


@dataclass(frozen=True)
class FlowTable:
    """A splitting compiled to a list of sub-flows exp(a_i h X_i), as plain arrays for compiled and Python interpreters.

    `frequency`: of rational rotations, else 0 (exact numbers: squared); `omitted`: entries (angle, row, column) whose
    products cancel; `shift`: Casimirs and factors subtracted from H.
    """

    system: LiePoissonSystem
    stages: FlowStages
    parts: Parts
    table: TermTable
    share: NDArray[np.uint32]
    functions: dict[int, FunctionTerm]
    state: Action
    group: Action | None
    sign: int
    number: Number
    frequency: NDArray[Any]
    omitted: NDArray[np.int64]
    shift: tuple[tuple[Polynomial, float], ...]
    choice: ChosenParts

    @cached_property
    def terms(self) -> Terms:
        return self.table.table(self.number)

    @property
    def compact_terms(self) -> Terms:
        """The terms for loops over flows, with the entries of rows that repeat stored once."""
        shortest = int(np.diff(self.parts.row).min(initial=MIN_REPEATED_ROWS))
        return (self.table.repeated_table() if shortest >= MIN_REPEATED_ROWS else None) or self.terms

    def to_mapping(self) -> dict[str, Any]:
        """Return the table as arrays, numbers and lists by name; `docs/table.md` documents them.

        Arrays are of int64, or of the number type of the flow table. As lists they can be written to JSON.

        Examples
        --------
        >>> import coadjoint as co
        >>> table = co.Splitting(order=2).flow_table(co.systems.rigid_body(inertia=(1, 2, 2.5))).to_mapping()
        >>> table["part"].tolist(), table["section"].tolist()
        ([0, 1, 0, 1, 0], [0, 2, 4, 5])
        >>> [table[name].tolist() for name in ("state_part", "state_row", "state_column", "state_value")]
        [[0, 0, 1, 1], [1, 2, 0, 1], [2, 1, 1, 0], [-1.0, 1.0, -1.0, 1.0]]
        """
        from coadjoint.program.public_table import mapping_of

        return mapping_of(self)


def build_flow_table(
    system: LiePoissonSystem,
    method: Swept,
    *,
    group: NDArray[Any] | str | None = None,
    number: Number = float,
) -> FlowTable:
    """Build the table of a splitting method; `group` is the representation (n, d, d), "coadjoint", or None."""
    try:
        decomposition = decompose(system, method.parts)
    except NotSplittable as reason:
        raise ValueError(f"{type(method).__name__} cannot be used for {system.name}: {reason}") from None
    parts, omitted = decomposition.parts, NOTHING_OMITTED
    if field_products(system) is not None:
        parts, omitted = separated_parts(system.algebra, parts, decomposition.choice.linear)
    if decomposition.shift is None and group is not None:
        raise ValueError(
            f'parts="{method.parts}" subtracts Casimirs from the energy of {system.name} that have too many terms '
            'for the attitude to be computed; take parts="auto"'
        )
    table = term_table(parts)
    state = _state_action(system.algebra, parts, omitted, number)
    zeros = np.broadcast_to(0.0, len(parts.offset))
    frequency = zeros if number is float else array_of(number, zeros)
    if method.rotation == "rational":
        frequency = rational_frequencies(system, parts, state, number)
    return FlowTable(
        system=system,
        stages=stages_of(method, JoinRules.from_parts(parts, frequency), system.sign, number),
        parts=parts,
        table=table,
        share=parts.share.astype(np.uint32),
        functions=table.functions,
        state=state,
        group=_group_action(system, group, parts, number),
        sign=system.sign,
        number=number,
        frequency=frequency,
        omitted=omitted,
        shift=decomposition.shift or (),
        choice=decomposition.choice,
    )


def term_table(parts: Parts) -> TermTable:
    """Collect the shares of all parts, in their order."""
    table = TermTable()
    if isinstance(parts.weights, RepeatedRows) and not parts.nonlinear and len(parts.row) > 1:
        table.add_linear_terms(parts.row, parts.offset, parts.weights)
        return table
    weights_of_all = SparseRows(parts.weights.start, parts.weights.coordinate, parts.weights.value)
    angle = weights_of_all.start
    gradients = parts.gradients
    edges = sorted(gradients)
    for first, last in zip([0, *(s + 1 for s in edges)], [*edges, len(parts.row) - 1], strict=True):
        if last > first:
            rows = parts.row[first : last + 1]
            begin, end = angle[rows[0]], angle[rows[-1]]
            weights = SparseRows(
                angle[rows[0] : rows[-1] + 1] - begin,
                weights_of_all.coordinate[begin:end],
                weights_of_all.value[begin:end],
            )
            table.add_linear_terms(rows, parts.offset[rows[0] : rows[-1]], weights)
        share = gradients.get(last)
        if share is not None and share.polynomial is not None:
            table.add_polynomial(share.coordinates, share.polynomial)
        elif share is not None and share.term is not None:
            table.function(share.divided or share.term)
    return table


def recorded_sources(flow_table: FlowTable, terms: Terms) -> Callable[[], Sources]:
    """Return a function, without the flow table, for its sources with these terms, by the paths of `Terms`."""
    fixed = flow_table.system, flow_table.parts, flow_table.choice.shift
    parts = flow_table.parts
    shares = np.searchsorted(parts.row, flow_table.omitted[:, 0], side="right") - 1
    of_functions = all(s in parts.gradients and parts.gradients[s].term for s in shares.tolist())
    plain = of_functions and not np.any(flow_table.frequency)

    def sources() -> Sources:
        system, parts, shift = fixed
        of_energy = system.hamiltonian.terms()
        shifted = shifted_terms(of_energy, quadratic_casimirs(system), shift)
        energy, split_energy = CoefficientNumbers.of(of_energy), CoefficientNumbers.of(shifted)
        numbers = np.arange(split_energy.size)
        edges = zip(of_energy, shifted, energy.starts, pairwise(split_energy.starts), strict=False)
        for own, other, start, (first, last) in edges:
            unchanged = last - first if own is other else len(other.form.linear) if other.form else 0
            numbers[first : first + unchanged] = start + np.arange(unchanged)
            numbers[first + unchanged : last] = -1 - np.arange(first + unchanged, last)
        found = sources_of_parts(terms, parts, shifted).renumbered(numbers)
        if plain:
            return found
        kind = np.concatenate([energy.others, found.computed.get("kind", energy.others[:0])])
        return found._replace(computed={**found.computed, "kind": kind})

    return sources


def dual_action(algebra: LieAlgebra, flow_table: FlowTable) -> Action:
    """Return the action on cotangents of the state, by floating-point numbers."""
    return _state_action(algebra, flow_table.parts, flow_table.omitted, float, dual=True)


def _state_action(
    algebra: LieAlgebra, parts: Parts, omitted: NDArray[np.int64], number: Number, dual: bool = False
) -> Action:
    if number is not float:
        return _built_action(algebra, parts, omitted, dual, number)
    if len(parts.offset) <= MAX_PATTERN_SIZE:
        return _cached_action(algebra, Pattern((parts, omitted), *parts.forms, parts.angle, omitted), dual)
    actions = _ACTIONS.setdefault(parts, {})
    if dual not in actions:
        action = None if dual or len(omitted) else copied_action(algebra, parts)
        actions[dual] = action or _built_action(algebra, parts, omitted, dual, float)
    return actions[dual]


# Building the action takes seconds for large systems, so all schemes and steps share it. Parts are cached for the
# lifetime of their system, and their actions with them.
_ACTIONS: WeakKeyDictionary[Parts, dict[bool, Action]] = WeakKeyDictionary()


@lru_cache(maxsize=256)
def _cached_action(algebra: LieAlgebra, forms: Pattern[tuple[Parts, NDArray[np.int64]]], dual: bool) -> Action:
    return _built_action(algebra, *forms.source, dual, float)


def _built_action(algebra: LieAlgebra, parts: Parts, omitted: NDArray[np.int64], dual: bool, number: Number) -> Action:
    if dual:
        return build_action(BasisMatrices.on_group(algebra, None), parts, number, omitted[:, [0, 2, 1]])
    return build_action(BasisMatrices.coadjoint(algebra), parts, number, omitted)


def _group_action(system: LiePoissonSystem, group: Any, parts: Parts, number: Number) -> Action | None:
    if group is None:
        return None
    return build_action(BasisMatrices.on_group(system.algebra, given_matrices(group)), parts, number)
