"""Tables of free rigid bodies for the compiled loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.blocks import Kind
from coadjoint.program.parts.part import BodyShare
from coadjoint.program.table import Program

MAX_SWEEPS = 16  # of the Jacobi method, which takes about six for a 3 x 3 matrix
DIRECT, TOGETHER = 1, 2  # bits of `properties`


class BodyTables(NamedTuple):
    """The fields of `FlowTables` for free bodies."""

    called: NDArray[np.int64]
    body_column: NDArray[np.uint32]
    body: NDArray[np.float64]
    properties: NDArray[np.uint8]


def body_tables(program: Program) -> BodyTables:
    """Return the free bodies of a program as arrays; its constants are float64."""
    parts, bodies = program.parts, program.parts.bodies
    # A flow table may contain parts that are not in the Hamiltonian.
    index_of_share = np.full(int(program.share[-1]), -1, dtype=np.int64)
    properties = np.zeros(len(parts), dtype=np.uint8)
    index_of_share[list(bodies)] = np.arange(len(bodies))
    of_part = {int(np.searchsorted(parts.share, s, side="right")) - 1: share for s, share in bodies.items()}
    for p, share in of_part.items():
        unit_scale = all(abs(length) == 1.0 for length in share.scale)
        actions = (program.state,) if program.group is None else (program.state, program.group)
        properties[p] = DIRECT * (unit_scale and all(_turns_directly(action, p) for action in actions))
        if all(bodies[s].other and bodies[s].scale == (1.0, 1.0, 1.0) for s in range(*parts.share[p : p + 2])):
            properties[p] |= TOGETHER
    columns = np.array(
        [(*share.coordinates, *(share.other or share.coordinates)) for share in bodies.values()], dtype=np.uint32
    ).reshape(-1)
    constants = np.array([_constants(share) for share in bodies.values()], dtype=np.float64).reshape(-1)
    return BodyTables(index_of_share, columns, constants, properties)


def _turns_directly(action: Action, part: int) -> bool:
    for run in range(int(action.run[part]), int(action.run[part + 1])):
        first = int(action.constant[run])
        constants = action.constants[first : first + int(action.angles[run])]
        if action.kind[run] != Kind.ROTATE or np.any(np.abs(constants) != 1.0):
            return False
    return True


def _constants(share: BodyShare) -> list[float]:
    """Return principal moments, principal axes row by row, and the scale."""
    scaled = [[v / (share.scale[a] * share.scale[b]) for b, v in enumerate(row)] for a, row in enumerate(share.matrix)]
    moments, axes = principal_axes(scaled)
    return [*moments, *(entry for row in axes for entry in row), *share.scale]


def principal_axes(matrix: Sequence[Sequence[float]]) -> tuple[list[float], list[list[float]]]:
    """Return eigenvalues (unsorted) and eigenvectors (columns, a rotation) of a symmetric 3x3 matrix by Jacobi
    rotations.

    The bits are the same on every machine. A diagonal matrix keeps its order.

    Examples
    --------
    >>> principal_axes([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 5.0]])[0]
    [1.0, 3.0, 5.0]
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
