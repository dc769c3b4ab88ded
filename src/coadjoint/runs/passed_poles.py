"""Poles that a run has passed, of schemes whose steps solve a linear system: steps that jump through infinity."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.numerics.quadratic_field import QuadraticField
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.unfinished_members import ends_by_events
from coadjoint.runs.start import momenta_of
from coadjoint.systems.protocol import forces_of, is_batch, member_of

Floats = NDArray[np.float64]

# Largest number of entries of matrices f'(x) whose sizes are compared, and of those whose determinants are computed.
COMPARED, EXAMINED = 2**22, 2**15
# Least size of h/2 f' at the ends of saved intervals of several steps that are repeated; at a pole it is at least 1.
LOW = 0.02
# Rounding of numbers of steps between saved points, relative to them.
ROUNDING = 64 * UNIT_ROUNDOFF
# Largest number of systems of a batch.
SYSTEMS = 16


class Pole(NamedTuple):
    """The number among the chosen members, and the time of the step."""

    member: int
    t: float


def states_in_memory(solution: Solution) -> bool:
    """Test whether the states are those of a run or a file; those of archives are not read to check steps."""
    return "saved" in solution.record or "dataset" in solution.record


def passed_pole(solution: Solution, system: Any, method: Method, members: NDArray[np.int64], h: float) -> Pole | None:
    """Return the first step found that passes a pole; None for schemes without poles, and with forces.

    The steps examined are those after the saved points where f' is largest.
    """
    if forces_of(system) or system.dim**3 > EXAMINED:
        return None
    owners = system.owners[members] if is_batch(system) else np.zeros(len(members), dtype=np.int64)
    chosen = [np.flatnonzero(owners == owner) for owner in np.unique(owners)[:SYSTEMS]]
    candidates = (method.field_with_poles(member_of(system, int(members[those[0]]))) for those in chosen)
    fields = [field for field in candidates if field is not None]
    if not fields:
        return None
    if states_in_memory(solution) and len(solution.t) > 1:
        t, states = solution.t, solution.x.reshape(len(solution.t), -1, system.dim)[:, members]
    else:
        t = np.array([solution.t_span[0], solution.t_span[0] + h])
        states = np.repeat(momenta_of(system, solution.x0)[0][None, members], 2, 0)
    found, lengths = [], [h * fraction for fraction in method.fractions]
    ends = np.fmin(abs(t[-1] - t[0]), np.abs(ends_by_events(solution)[members] - t[0]))
    for field, those in zip(fields, chosen, strict=True):
        pole = _first_pole(field, t, states[:, those], lengths, ends[those])
        found += [] if pole is None else [pole._replace(member=int(those[pole.member]))]
    return min(found, key=lambda pole: abs(pole.t - t[0]), default=None)


def _first_pole(field: QuadraticField, t: Floats, states: Floats, lengths: list[float], ends: Floats) -> Pole | None:
    """Return the first pole found between states (points, members, n), by steps of these substeps.

    `ends` are the lengths of the runs of the members; the steps after a saved point end at the next one.
    """
    n, h = states.shape[2], sum(lengths)
    count = max(1, math.ceil(float(np.abs(np.diff(t)).max() / abs(h)) * (1.0 - ROUNDING)))
    # Of many steps between saved points the first ones are repeated.
    count = min(count, max(1, EXAMINED // (n**2 * len(lengths))))
    flat = states.reshape(-1, n)
    sizes = np.nan_to_num(np.linalg.norm(flat, axis=1), nan=0.0, posinf=0.0)
    near = _largest(sizes, COMPARED // n**2)
    sizes[near] = np.linalg.norm(field.derivative(flat[near]), axis=(1, 2))
    # The size in an interval is that at its larger end; a real eigenvalue is no larger than the norm.
    sizes = sizes.reshape(len(t), -1)
    sizes = (np.maximum(sizes[:-1], sizes[1:]) if count * len(lengths) > 1 else sizes[:-1]).ravel()
    starts = _largest(sizes, max(1, EXAMINED // (n**2 * count * len(lengths))))
    least = 2.0 / max(map(abs, lengths)) * (LOW if count * len(lengths) > 1 else 1.0)
    starts = starts[sizes[starts] >= least]
    if not len(starts):
        return None
    x, first = flat[starts], None
    points, owners = np.divmod(starts, states.shape[1])
    elapsed = np.abs(t - t[0])
    last = np.minimum(elapsed[points + 1], ends[owners]) - elapsed[points]
    for step in range(count):
        inside = step * abs(h) < last - ROUNDING * max(abs(t[0]), abs(t[-1]))
        for length in lengths:
            x, passed = field.step(x, length)
            for k in np.flatnonzero(passed & inside).tolist():
                pole = Pole(int(owners[k]), float(t[points[k]]) + step * h)
                if first is None or abs(pole.t - t[0]) < abs(first.t - t[0]):
                    first = pole
    return first


def _largest(sizes: Floats, count: int) -> NDArray[np.int64]:
    """Return the numbers of the largest sizes."""
    return np.arange(len(sizes)) if len(sizes) <= count else np.argpartition(-sizes, count)[:count]
