"""The loop over steps for Runge-Kutta methods: explicit, iterated, implicit, and linear in the last iterate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.actions import add
from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import compiled, inlined
from coadjoint.kernels.field import (
    Field,
    GroupField,
    coadjoint_matrix,
    group_matrix,
    group_slope,
    slope,
    structure_times_matrix,
)
from coadjoint.kernels.linear_stages import assemble, refine
from coadjoint.kernels.pointers import alive, pointed, shifted
from coadjoint.kernels.stagnation import FAILED, GO_ON, restage, verdict
from coadjoint.kernels.watching import (
    DONE,
    NOT_CONVERGED,
    OVERFLOW,
    Report,
    Saves,
    Schedule,
    Watch,
    finite,
    record,
    slot_of,
)

EXPLICIT, ITERATED, IMPLICIT, STRUCTURE, GRADIENT = range(5)
NOT_FROZEN = -1
REFINED = 3  # evaluations of a linear system: before the solution, before one refinement, and of the result


class RungeKuttaTables(NamedTuple):
    """The arrays of a Runge-Kutta method on a system.

    The stages are X_i = x + sum_j mix_ij L_j with L_j = h scale_j f(X_j, t + node_j h), and the step adds sum_j out_j
    L_j. `iterations` counts the function iterations before the end of `solver`, or its linear system. `direct` says
    that linear systems are solved by LU factors, with `quadratic` the dense M where that is needed; else they are
    iterated. One step is made of substeps of the lengths `fraction`, at the moments `moment`, in units of the step.
    """

    field: Field
    group: GroupField
    stages: int
    substeps: int
    solver: int
    iterations: int
    direct: bool
    node: NDArray[np.float64]
    scale: NDArray[np.float64]
    mix: NDArray[np.float64]
    out: NDArray[np.float64]
    quadratic: NDArray[np.float64]
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]


class Work(NamedTuple):
    """Room for one step.

    Stage after stage: points X, frozen points Z, gradients U, slopes L, the same for the group, and defects.
    """

    points: NDArray[np.float64]
    frozen: NDArray[np.float64]
    gradients: NDArray[np.float64]
    slopes: NDArray[np.float64]
    group_points: NDArray[np.float64]
    group_slopes: NDArray[np.float64]
    defect: NDArray[np.float64]
    change: NDArray[np.float64]
    least: NDArray[np.float64]
    rows: NDArray[np.float64]
    arguments: NDArray[np.float64]
    structure: NDArray[np.float64]
    blocks: NDArray[np.float64]
    system: NDArray[np.float64]
    pivots: NDArray[np.int64]


@inlined
def work_for(tables: Any, n: int) -> Work:
    """Return room for the steps of one call of `advance`."""
    s, d = tables.stages, tables.group.size
    size = max(n, d * d)
    edge = s * max(n, d) if tables.direct else 0
    return Work(
        np.empty(s * n),
        np.empty(s * n),
        np.empty(s * n),
        np.empty(s * n),
        np.empty(s * d * d),
        np.empty(s * d * d),
        np.empty(s * size),
        np.empty(size),
        np.empty(size),
        np.empty(tables.field.longest),
        np.empty(tables.field.longest + 1),
        np.empty(n * n if tables.field.nonlinear else 0),
        np.empty(edge * edge),
        np.empty(edge * edge),
        np.empty(edge, np.int64),
    )


@inlined
def solve_stages(tables: Any, x: Any, dx: Any, t: float, h: float, work: Any) -> tuple[int, float, int, int]:
    """Find the slopes of one step.

    Returns a status, the last correction, and how many evaluations of the field and iterations it took.
    """
    n, s, solver = tables.field.size, tables.stages, tables.solver
    for q in range(s * n):
        work.points[q] = x[q % n]
        work.slopes[q] = 0.0
    for c in range(n):
        work.least[c] = np.inf
    freeze = NOT_FROZEN
    passed, quiet, evaluations, iterations, earliest = 0, 0, 0, 0, 0.0
    while True:
        low, high = (passed, passed + 1) if solver == EXPLICIT else (0, s)
        for j in range(low, high):
            point, slopes = shifted(work.points, j * n), shifted(work.slopes, j * n)
            slope(
                tables.field,
                point,
                shifted(work.gradients, j * n),
                shifted(work.frozen, j * n) if freeze == STRUCTURE else point,
                t + tables.node[j] * h,
                freeze != GRADIENT,
                slopes,
                work.rows,
                work.arguments,
                work.structure,
            )
            factor = h * tables.scale[j]
            for c in range(n):
                slopes[c] *= factor
        passed += 1
        iterations += 1
        evaluations += high - low
        if freeze == NOT_FROZEN and solver != IMPLICIT and passed > tables.iterations:
            if solver == EXPLICIT or solver == ITERATED:
                return DONE, 0.0, evaluations, iterations
            freeze, passed = solver, 0
            for q in range(s * n):
                work.frozen[q] = work.points[q]
            for c in range(n):
                work.least[c] = np.inf
            if tables.direct:
                for j in range(s):
                    block, factor = shifted(work.blocks, j * n * n), h * tables.scale[j]
                    if solver == STRUCTURE:
                        frozen = shifted(work.frozen, j * n)
                        structure_times_matrix(tables.field, frozen, tables.quadratic, factor, block, work.structure)
                    else:
                        coadjoint_matrix(tables.field, shifted(work.gradients, j * n), factor, block)
                if not assemble(tables.mix, s, n, work):
                    return NOT_CONVERGED, np.inf, evaluations, iterations
        elif freeze != NOT_FROZEN and tables.direct:
            if passed == REFINED:
                return DONE, 0.0, evaluations, iterations
            refine(tables.mix, s, n, 1, x, dx, work.slopes, work.points, work)
        else:
            low, high = (passed, passed + 1) if solver == EXPLICIT else (0, s)
            largest, size, falling = restage(tables.mix, s, low, high, n, x, dx, work.slopes, work.points, work)
            if solver == IMPLICIT or freeze != NOT_FROZEN:
                earliest = largest if passed == 1 else earliest
                result, quiet = verdict(passed, earliest, largest, size, falling, quiet)
                if result == FAILED:
                    spoilt = passed == 1 and not largest - largest == 0.0
                    return (OVERFLOW if spoilt else NOT_CONVERGED), largest, evaluations, iterations
                if result != GO_ON:
                    return DONE, largest, evaluations, iterations


@inlined
def solve_group(tables: Any, g: Any, dg: Any, h: float, work: Any) -> tuple[int, float]:
    """Find the slopes of the group element for the gradients that the stages of the momentum left."""
    n, s, d, explicit = tables.field.size, tables.stages, tables.group.size, tables.solver == EXPLICIT
    size = d * d
    for q in range(s * size):
        work.group_points[q] = g[q % size]
        work.group_slopes[q] = 0.0
    for c in range(size):
        work.least[c] = np.inf
    if tables.direct:
        for j in range(s):
            factor = h * tables.scale[j]
            group_matrix(tables.group, shifted(work.gradients, j * n), factor, shifted(work.blocks, j * size))
        if not assemble(tables.mix, s, d, work):
            return NOT_CONVERGED, np.inf
    passed, quiet, earliest = 0, 0, 0.0
    while True:
        low, high = (passed, passed + 1) if explicit else (0, s)
        for j in range(low, high):
            point, slopes = shifted(work.group_points, j * size), shifted(work.group_slopes, j * size)
            group_slope(tables.group, shifted(work.gradients, j * n), point, slopes)
            factor = h * tables.scale[j]
            for c in range(size):
                slopes[c] *= factor
        passed += 1
        if (explicit and passed == s) or (tables.direct and passed == REFINED):
            return DONE, 0.0
        if tables.direct:
            refine(tables.mix, s, d, d, g, dg, work.group_slopes, work.group_points, work)
        else:
            low, high = (passed, passed + 1) if explicit else (0, s)
            largest, extent, falling = restage(
                tables.mix, s, low, high, size, g, dg, work.group_slopes, work.group_points, work
            )
            if not explicit:
                earliest = largest if passed == 1 else earliest
                result, quiet = verdict(passed, earliest, largest, extent, falling, quiet)
                if result == FAILED:
                    return NOT_CONVERGED, largest
                if result != GO_ON:
                    return DONE, largest


@inlined
def add_slopes(out: Any, stages: int, slopes: Any, n: int, x: Any, dx: Any) -> None:
    """Add sum_j out_j L_j to x, with compensation."""
    for c in range(n):
        total = 0.0
        for j in range(stages):
            total = fma(out[j], slopes[j * n + c], total)
        add(x, dx, c, total, True)


@compiled
def advance(
    tables: RungeKuttaTables,
    watch: Watch,
    saves: Saves,
    schedule: Schedule,
    state: Any,
    crew: Any,
    k0: int,
    k1: int,
    report: Report,
) -> None:
    """Take the steps k0 + 1 to k1 for the members crew[0] to crew[1] - 1.

    `state` is (momentum, its compensation, group, its compensation), each (members, ...). Every step starts anew from
    it.
    """
    size, square = state[0].shape[1], state[2].shape[1]
    work, room = work_for(tables, size), np.empty(watch.longest + 1)
    at, watch_at, saves_at, report_at = pointed((tables, watch, saves, report))
    x_at, dx_at, group_at, dgroup_at = pointed(state)
    work_at, room_at = pointed((work, room))
    for member in range(crew[0], crew[1]):
        if report_at.status[member] != DONE:
            continue
        x, dx = shifted(x_at, member * size), shifted(dx_at, member * size)
        group, dgroup = shifted(group_at, member * square), shifted(dgroup_at, member * square)
        for k in range(k0 + 1, k1 + 1):
            start = schedule.t0 + (k - 1) * schedule.h
            status, residual = DONE, 0.0
            for part in range(tables.substeps):
                t, h = start + at.moment[part] * schedule.h, at.fraction[part] * schedule.h
                status, residual, evaluations, iterations = solve_stages(at, x, dx, t, h, work_at)
                report_at.evaluations[member] += evaluations
                report_at.iterations[member] += iterations
                if status == DONE and square > 0:
                    status, residual = solve_group(at, group, dgroup, h, work_at)
                if status != DONE:
                    break
                add_slopes(at.out, tables.stages, work_at.slopes, size, x, dx)
                add_slopes(at.out, tables.stages, work_at.group_slopes, square, group, dgroup)
            if status == DONE and not finite(size, x):
                status, residual = OVERFLOW, np.nan
            if status != DONE:
                report_at.status[member], report_at.step[member], report_at.residual[member] = status, k, residual
                break
            slot = slot_of(schedule, k)
            if schedule.watching or slot >= 0:
                record(watch_at, saves_at, schedule, member, k, slot, size, x, square, group, room_at)
    alive((work, room))
