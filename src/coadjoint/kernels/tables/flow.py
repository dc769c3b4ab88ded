"""Flow tables as the kernels read them."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Floats
from coadjoint.kernels.interface import limit
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import CompiledTables, addresses_of, as_structure, with_functions
from coadjoint.program.actions import Action, acts_rationally, empty_action
from coadjoint.program.blocks import BlockKind
from coadjoint.program.parts.part import BodyShare
from coadjoint.program.sources import Sources
from coadjoint.program.table import FlowTable, recorded_sources
from coadjoint.program.term_table import LINEAR, Terms


class FlowTables(NamedTuple):
    """A flow table as arrays, coefficients times `step`; for `called`, bodies, `properties` see `boundary/tables.hpp`.

    only[p]: row of a part of one linear angle, else -1; bent[p]: 1 if its blocks on the group have other frequencies.
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

    def at_step(self, h: float) -> FlowTables | None:
        """Return the tables of another step; None unless they are exact multiples by a power of two, of either sign."""
        ratio = h / self.step
        if abs(math.frexp(ratio)[0]) != 0.5 or ratio * self.step != h:
            return None
        tau = self.tau * ratio
        return self._replace(tau=tau, step=h) if np.array_equal(tau / ratio, self.tau) else None


FLOW_LOOP = "flow_advance"
"""Name of the loop. Between calls the state is unfinished: the last flow of a step is merged with the first of the
next, and *finish* acts on a copy.
"""


def flow_tables(flow_table: FlowTable, h: float, compensated: bool, compact: bool = False) -> CompiledTables:
    """Return `FlowTables` of a flow table with float64 constants, for a step h (negative for backward)."""
    terms = flow_table.compact_terms if compact else flow_table.terms
    count = len(terms.kind)
    addresses, keepalive = addresses_of(flow_table.functions, count, "gradient", "the Hamiltonian")
    group = flow_table.group if flow_table.group is not None else empty_action()
    rows = flow_table.stages
    edges = terms.row[flow_table.share]
    is_linear = (np.diff(edges) == 1) & (np.diff(flow_table.share) == 1) & (terms.kind[flow_table.share[:-1]] == LINEAR)
    rational = np.zeros(len(edges) - 1, dtype=bool)
    if np.any(flow_table.frequency):
        turning = np.concatenate([[0], np.cumsum(flow_table.frequency != 0)])
        rational = np.diff(turning[edges]) > 0
    rational_on_group = np.zeros_like(rational)
    if flow_table.group is not None and np.any(rational):
        rational_on_group = rational & acts_rationally(group, flow_table.parts, flow_table.frequency)
    # Kernels read the frequencies of rational rotations alone.
    frequency = flow_table.frequency if np.any(rational) or not compact else np.zeros(1)
    tables = FlowTables(
        int(np.max(np.diff(edges), initial=1)),
        np.where(is_linear, edges[:-1].astype(np.int64), -1),
        (rational & ~rational_on_group).astype(np.uint8),
        np.ascontiguousarray(frequency),
        rows.part,
        rows.coefficient * h,
        rows.moment,
        rows.section,
        flow_table.share,
        terms,
        addresses,
        mark_rational(flow_table.state, rational),
        mark_rational(group, rational_on_group),
        compensated,
        *body_tables(flow_table),
        h,
    )
    recorded, functions, energy = (
        recorded_sources(flow_table, terms),
        flow_table.functions,
        flow_table.system.hamiltonian,
    )

    def sources() -> Sources:
        return with_functions(recorded().within("terms."), functions, "gradient", "the Hamiltonian", energy.terms())

    return CompiledTables(with_properties(tables), keepalive, sources)


def with_properties(tables: FlowTables) -> FlowTables:
    """Mark parts whose runs move different coordinates (bit 4), and whose angles may be applied one by one (8)."""
    found = tables._replace(properties=tables.properties.copy())
    if kernels().flow_properties(ctypes.byref(as_structure(found)), ctypes.c_int64(len(found.only))):
        raise MemoryError("not enough memory for the properties of the parts")
    return found


def mark_rational(action: Action, rational: NDArray[np.bool_]) -> Action:
    """Mark the rotations of some parts as rational: tan(angle/2) is replaced by half the angle."""
    kind = action.kind.copy()
    for part in np.flatnonzero(rational):
        kinds = kind[action.run[part] : action.run[part + 1]]
        kinds[(kinds == BlockKind.ROTATE) | (kinds == BlockKind.CUBIC)] += limit("RATIONAL")
    return action._replace(kind=kind)


MAX_SWEEPS = 16  # of the Jacobi method, which takes about six for a 3 x 3 matrix
DIRECT, TOGETHER = 1, 2  # bits of `properties`


def body_tables(flow_table: FlowTable) -> tuple[NDArray[np.int64], NDArray[np.uint32], Floats, NDArray[np.uint8]]:
    """Return the fields `called`, `body_column`, `body` and `properties` of `FlowTables` for the free bodies."""
    parts, bodies = flow_table.parts, flow_table.parts.bodies
    # A flow table may contain parts that are not in the Hamiltonian.
    index_of_share = np.full(int(flow_table.share[-1]), -1, dtype=np.int64)
    properties = np.zeros(len(parts), dtype=np.uint8)
    index_of_share[list(bodies)] = np.arange(len(bodies))
    of_part = {int(np.searchsorted(parts.share, s, side="right")) - 1: share for s, share in bodies.items()}
    for p, share in of_part.items():
        unit_scale = all(abs(length) == 1.0 for length in share.scale)
        actions = (flow_table.state,) if flow_table.group is None else (flow_table.state, flow_table.group)
        properties[p] = DIRECT * (unit_scale and all(_turns_directly(action, p) for action in actions))
        if all(bodies[s].other and bodies[s].scale == (1.0, 1.0, 1.0) for s in range(*parts.share[p : p + 2])):
            properties[p] |= TOGETHER
    columns = np.array(
        [(*share.coordinates, *(share.other or share.coordinates)) for share in bodies.values()], dtype=np.uint32
    ).reshape(-1)
    constants = np.array([_constants(share) for share in bodies.values()], dtype=np.float64).reshape(-1)
    return index_of_share, columns, constants, properties


def _turns_directly(action: Action, part: int) -> bool:
    for run in range(int(action.run[part]), int(action.run[part + 1])):
        first = int(action.constant[run])
        constants = action.constants[first : first + int(action.angles[run])]
        if action.kind[run] != BlockKind.ROTATE or np.any(np.abs(constants) != 1.0):
            return False
    return True


def _constants(share: BodyShare) -> list[float]:
    scaled = [[v / (share.scale[a] * share.scale[b]) for b, v in enumerate(row)] for a, row in enumerate(share.matrix)]
    moments, axes = principal_axes(scaled)
    return [*moments, *(entry for row in axes for entry in row), *share.scale]


def principal_axes(matrix: Sequence[Sequence[float]]) -> tuple[list[float], list[list[float]]]:
    """Return eigenvalues (unsorted) and eigenvectors (columns, a rotation) of a symmetric 3x3 matrix (Jacobi).

    The bits are the same on every machine. A diagonal matrix keeps its order.
    """
    M = [list(row) for row in matrix]
    Q = [[float(i == j) for j in range(3)] for i in range(3)]
    for _ in range(MAX_SWEEPS):
        if M[0][1] == M[0][2] == M[1][2] == 0.0:
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            # Smaller entries no longer change the diagonal ones, since convergence is quadratic.
            if abs(M[p][q]) <= 2.0**-60 * (abs(M[p][p]) + abs(M[q][q])):
                M[p][q] = M[q][p] = 0.0
                continue
            slope = (M[q][q] - M[p][p]) / (2.0 * M[p][q])
            t = math.copysign(1.0, slope) / (abs(slope) + math.sqrt(slope * slope + 1.0))
            c = 1.0 / math.sqrt(t * t + 1.0)
            s, r = t * c, 3 - p - q
            M[p][p], M[q][q] = M[p][p] - t * M[p][q], M[q][q] + t * M[p][q]
            M[p][q] = M[q][p] = 0.0
            M[p][r], M[q][r] = c * M[p][r] - s * M[q][r], s * M[p][r] + c * M[q][r]
            M[r][p], M[r][q] = M[p][r], M[q][r]
            for row in Q:
                row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
    return [M[i][i] for i in range(3)], Q
