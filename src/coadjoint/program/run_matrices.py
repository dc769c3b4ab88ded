"""Blocks of a run of an action as matrices, and entries of generators."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.blocks import CUBIC_HEADER, Kind


def run_blocks(action: Action, run: int, q: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return the blocks of a run at its angle number q, as (coordinates, matrix)."""
    kind, repeat = action.kind[run], int(action.repeat[run])
    width, index, constant = int(action.width[run]), int(action.place[run]), int(action.constant[run])
    constants = action.constants
    zero = 0 * constants[constant]
    found = []
    for b in range(repeat):
        place = index + (q * repeat + b) * width
        coordinates = action.indices[place : place + width].astype(np.int64)
        matrix = np.full((width, width), zero, dtype=constants.dtype)
        if kind == Kind.SCALE:
            matrix[0, 0] = constants[constant + q]
        elif kind == Kind.ROTATE:
            matrix[1, 0] = constants[constant + q]
            matrix[0, 1] = -matrix[1, 0]
        elif kind == Kind.SHEAR:
            matrix[0, 1] = constants[constant + q * repeat + b]
        elif kind == Kind.PLANE:
            mean, half, upper, lower = constants[constant + 4 * q : constant + 4 * q + 4]
            matrix[:] = [[mean + half, upper], [lower, mean - half]]
        else:
            count = int(action.entries[run])
            header = CUBIC_HEADER if kind == Kind.CUBIC else 1
            starts = action.indices[index + width : index + 2 * width + 1].astype(np.int64)
            rows = np.repeat(np.arange(width), np.diff(starts))
            columns = action.indices[index + 2 * width + 1 :][:count]
            matrix[rows, columns] = constants[constant + header :][:count]
        found.append((coordinates, matrix))
    return found


def run_entries(action: Action, run: int, q: int) -> dict[tuple[int, int], Any]:
    """Return the nonzero entries of a run's generator at its angle number q."""
    found = {}
    for coordinates, matrix in run_blocks(action, run, q):
        for i, j in np.argwhere(matrix != 0):
            found[int(coordinates[i]), int(coordinates[j])] = matrix[i, j]
    return found
