"""Stages that solve a linear system: its factors, and its solution with refinement."""

from __future__ import annotations

from typing import Any

from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import inlined
from coadjoint.kernels.linear_solve import factorize, substitute


@inlined
def assemble(mix: Any, stages: int, edge: int, work: Any) -> bool:
    """Factorize I - (mix_ij W_j), W_j the (edge * edge) blocks; False if it is singular."""
    size = stages * edge
    for i in range(stages):
        for a in range(edge):
            for j in range(stages):
                factor = -mix[i * stages + j]
                for b in range(edge):
                    unit = 1.0 if i == j and a == b else 0.0
                    entry = work.blocks[(j * edge + a) * edge + b]
                    work.system[(i * edge + a) * size + j * edge + b] = fma(factor, entry, unit)
    return factorize(work.system, size, work.pivots)


@inlined
def refine(
    mix: Any, stages: int, edge: int, lanes: int, base: Any, error: Any, slopes: Any, points: Any, work: Any
) -> None:
    """Add to the points the solution of the factorized system for their defect: the first time solves it."""
    n = edge * lanes
    for i in range(stages):
        for c in range(n):
            total = error[c]
            for j in range(stages):
                total = fma(mix[i * stages + j], slopes[j * n + c], total)
            work.defect[i * n + c] = (base[c] - points[i * n + c]) + total
    substitute(work.system, stages * edge, work.pivots, work.defect, lanes)
    for q in range(stages * n):
        points[q] += work.defect[q]
