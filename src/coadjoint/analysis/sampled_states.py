"""States of a run that are sampled to repeat its steps: of a few members, at a few of its saved points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import member_count
from coadjoint.runs.start import any_momenta_of, vector_size

Floats = NDArray[np.float64]

# Largest number of points, and of members, at which the step is repeated.
POINTS, MEMBERS = 5, 64
# Largest number of entries of the states that are repeated; at least one state.
NUMBERS = 2**20


def states_at(solution: Solution, members: NDArray[np.int64], k: int) -> Floats:
    """Return the momenta of the members at a saved point; of members that have ended or failed, those at the start."""
    states = np.where(np.isfinite(solution.x[k]), solution.x[k], solution.x0)
    return any_momenta_of(solution.system, states)[0][members]


def sampled_members(solution: Solution, system: Any) -> NDArray[np.int64]:
    """Return the members whose steps are repeated: the first few of each system, or of systems at equal distances."""
    if not system.is_batch:
        return np.arange(min(member_count(solution), MEMBERS))
    order = np.argsort(system.owners, kind="stable")
    owners = system.owners[order]
    count = int(owners[-1]) + 1
    chosen = np.isin(owners, np.linspace(0, count - 1, min(count, MEMBERS)).astype(np.int64))
    first = np.arange(len(order)) - np.searchsorted(owners, owners) < max(1, MEMBERS // count)
    return np.sort(order[chosen & first])


def sampled_points(
    solution: Solution, system: Any, members: NDArray[np.int64]
) -> list[tuple[float, Floats, NDArray[np.bool_]]]:
    """Return a few times of a run, the start included, the states (members, n) of some members, and who has one."""
    size = vector_size(system)
    start = any_momenta_of(system, solution.x0)[0] if size is None else np.asarray(solution.x0).reshape(-1, size)
    start = start if len(start) == 1 else start[members]
    count = max(1, min(POINTS, NUMBERS // start.size, len(solution.t) - 1))
    points = [(solution.t_span[0], start, np.ones(len(start), dtype=bool))]
    if not solution._in_memory:
        return points  # archives are not read to check steps
    for k in np.linspace(0, len(solution.t) - 1, count, endpoint=False).astype(int)[1:].tolist():
        # Members that have ended or failed need some state; their steps are left out.
        finite = np.isfinite(solution.x[k])
        states, _ = any_momenta_of(system, np.where(finite, solution.x[k], solution.x0))
        held = finite.reshape(member_count(solution), -1).all(axis=1)
        points.append((float(solution.t[k]), states[members], held[members]))
    return points
