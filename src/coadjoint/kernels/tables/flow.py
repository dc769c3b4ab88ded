"""Tables of programs of exact flows."""

from __future__ import annotations

import ctypes
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import CompiledTables, addresses_of
from coadjoint.kernels.tables.free_body import body_tables
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.program.actions import Action, empty_action
from coadjoint.program.blocks import Kind
from coadjoint.program.rational_rotations import acts_rationally
from coadjoint.program.table import Program, recorded_sources
from coadjoint.program.term_table import LINEAR, Terms


class FlowTables(NamedTuple):
    """The arrays of a program; the coefficients of the rows are already multiplied by `step`, and the loops rescale
    them.

    A part has at most `longest` angles; only[p] is the row of a part with a single, linear one, else -1. bent[p] is 1
    if the blocks of part p on the group have other frequencies, frequency[row], than on the momentum, so that they need
    the angle itself. Rational rotations are marked in the kinds of the actions. called[k] is the index of the free body
    of share k, else -1; `body_column` has its triple and the other triple of a bond (the same one without a bond),
    `body` its constants. properties[p] has bit 1 if all blocks of a body part rotate by the angle itself, bit 2 if it
    consists of bonds of unit scale; bits 4 and 8 are those of `with_properties`.
    """

    longest: int
    only: NDArray[np.int64]
    bent: NDArray[np.uint8]
    frequency: NDArray[np.float64]
    part: NDArray[np.uint32]
    tau: NDArray[np.float64]
    moment: NDArray[np.float64]
    section: NDArray[np.uint32]
    share: NDArray[np.uint32]
    terms: Terms
    addresses: NDArray[np.int64]
    state: Action
    group: Action
    compensated: bool
    called: NDArray[np.int64]
    body_column: NDArray[np.uint32]
    body: NDArray[np.float64]
    properties: NDArray[np.uint8]
    step: float


FLOW_LOOP = "flow_advance"
"""Name of the loop. Between calls the state is unfinished: the last flow of a step is merged with the first of the
next, and *finish* acts on a copy.
"""


def flow_tables(program: Program, h: float, compensated: bool, compact: bool = False) -> CompiledTables:
    """Return `FlowTables` of a program with float64 constants, for a step h (negative for backward).

    `compensated` selects compensated summation of the momentum; `compact` tables are for the loop over flows alone.
    """
    terms = program.compact_terms if compact else program.terms
    count = len(terms.kind)
    addresses, keepalive = addresses_of(program.functions, count, "gradient", "the Hamiltonian")
    group = program.group if program.group is not None else empty_action()
    rows = program.rows
    edges = terms.row[program.share]
    is_linear = (np.diff(edges) == 1) & (np.diff(program.share) == 1) & (terms.kind[program.share[:-1]] == LINEAR)
    rational = np.zeros(len(edges) - 1, dtype=bool)
    if np.any(program.frequency):
        turning = np.concatenate([[0], np.cumsum(program.frequency != 0)])
        rational = np.diff(turning[edges]) > 0
    rational_on_group = np.zeros_like(rational)
    if program.group is not None and np.any(rational):
        rational_on_group = rational & acts_rationally(group, program.parts, program.frequency)
    # Kernels read the frequencies of rational rotations alone.
    frequency = program.frequency if np.any(rational) or not compact else np.zeros(1)
    tables = FlowTables(
        int(np.max(np.diff(edges), initial=1)),
        np.where(is_linear, edges[:-1].astype(np.int64), -1),
        (rational & ~rational_on_group).astype(np.uint8),
        np.ascontiguousarray(frequency),
        rows.part,
        rows.coefficient * h,
        rows.moment,
        rows.section,
        program.share,
        terms,
        addresses,
        mark_rational(program.state, rational),
        mark_rational(group, rational_on_group),
        compensated,
        *body_tables(program),
        h,
    )
    return CompiledTables(with_properties(tables), keepalive, recorded_sources(program, terms))


def with_properties(tables: FlowTables) -> FlowTables:
    """Return tables with the properties of parts that follow from their structure: that runs move different
    coordinates (bit 4), and that rotations may follow their angles one by one (bit 8).
    """
    found = tables._replace(properties=tables.properties.copy())
    if kernels().flow_properties(ctypes.byref(as_structure(found)), ctypes.c_int64(len(found.only))):
        raise MemoryError("not enough memory for the properties of the parts")
    return found


def at_step(tables: FlowTables, h: float) -> FlowTables | None:
    """Return the tables of another step; None unless they are exact multiples by a power of two, with either sign."""
    ratio = h / tables.step
    if abs(math.frexp(ratio)[0]) != 0.5 or ratio * tables.step != h:
        return None
    tau = tables.tau * ratio
    return tables._replace(tau=tau, step=h) if np.array_equal(tau / ratio, tables.tau) else None


def mark_rational(action: Action, rational: NDArray[np.bool_]) -> Action:
    """Mark the rotations of some parts as rational: tan(angle/2) is replaced by half the angle."""
    kind = action.kind.copy()
    for part in np.flatnonzero(rational):
        kinds = kind[action.run[part] : action.run[part + 1]]
        kinds[(kinds == Kind.ROTATE) | (kinds == Kind.CUBIC)] += limit("RATIONAL")
    return action._replace(kind=kind)
