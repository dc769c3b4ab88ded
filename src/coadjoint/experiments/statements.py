"""Statements of the literature with verdicts, and what they are measured by: orders, and steps as matrices."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.powers import OrderFit, fit_order
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre
from coadjoint.methods.protocol.method import Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System

Floats = npt.NDArray[np.float64]
HOLDS, LIMITED, FAILS = "holds", "holds with a limit", "does not hold"
SLOPE_TOLERANCE = 0.2  # contribution of the next error term to a slope at the steps used here

# Numbers of steps for slopes: few, large steps for high orders, which soon reach round-off; small ones for low orders,
# whose slopes converge late.
LOW_ORDER_COUNTS = (32, 64, 128, 256, 512)
HIGH_ORDER_COUNTS = (12, 16, 24, 32, 48, 64, 96)


class Statement(NamedTuple):
    """A row of the table; the verdict is ``"holds"``, ``"holds with a limit"`` or ``"does not hold"``."""

    key: str
    place: str
    statement: str
    paper: str
    criterion: str
    measured: str
    verdict: str


def judge(
    key: str,
    place: str,
    statement: str,
    *,
    paper: str,
    criterion: str,
    measured: str,
    holds: bool,
    limited: bool = False,
) -> Statement:
    """Return a row with its verdict: `holds` if the criterion is met, `limited` if the paper omits a limit."""
    verdict = FAILS if not holds else LIMITED if limited else HOLDS
    return Statement(key, place, statement, paper, criterion, measured, verdict)


def write_csv(rows: Sequence[Statement], path: Path) -> None:
    """Write the rows as comma-separated values with a header."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Statement._fields)
        writer.writerows(rows)


def markdown(rows: Sequence[Statement]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| place | statement | what the paper says | criterion | measured | verdict |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (cell.replace("|", r"\|").replace("\n", " ") for cell in row[1:])
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


class ReferenceProblem(NamedTuple):
    """A test problem: system, initial state, end time, and the exact state there."""

    system: System
    x0: npt.NDArray[np.float64]
    end: float
    exact: npt.NDArray[np.float64]


def reference_problem(system: System, x0: npt.ArrayLike, end: float) -> ReferenceProblem:
    """Return a test problem whose exact end state is that of 8 Gauss stages, accurate to a few units of round-off."""
    start = np.array(x0, dtype=np.float64)
    run = integrate(system, start, (0.0, end), end / 64, GaussLegendre(8), save_every=64, watch=False)
    return ReferenceProblem(system, start, end, run.x[-1])


def roundoff(steps: float, size: float) -> float:
    """Return an upper bound of accumulated round-off: 8 roundings of 2^-53 per step, all of one sign.

    Examples
    --------
    >>> roundoff(1000, 1.0) < 1e-12
    True
    """
    return 8 * UNIT_ROUNDOFF * steps * size


def fitted_order(case: ReferenceProblem, method: Method, counts: Sequence[int] | None = None) -> OrderFit:
    """Fit the order of a scheme from its error at the end of a trial; default `counts` follow the declared order."""
    numbers = counts or (HIGH_ORDER_COUNTS if method.order > 3 else LOW_ORDER_COUNTS)
    errors = []
    for count in numbers:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count, watch=False)
        errors.append(float(np.linalg.norm(run.x[-1] - case.exact)))
    floor = [roundoff(count, float(np.linalg.norm(case.x0))) for count in numbers]
    return fit_order([case.end / count for count in numbers], errors, floor)


def fitted_drift(
    case: ReferenceProblem, method: Method, invariant: str, counts: Sequence[int] = HIGH_ORDER_COUNTS
) -> OrderFit:
    """Fit the order of the largest drift of an invariant ("energy" or a Casimir) along a trial."""
    drifts, floor = [], []
    for count in counts:
        run = integrate(case.system, case.x0, (0.0, case.end), case.end / count, method, save_every=count)
        drift = run.drift(relative=False)[invariant]
        drifts.append(float(drift))
        floor.append(roundoff(count, abs(float(drift.initial))))
    return fit_order([case.end / count for count in counts], drifts, floor)


def within(measured: float, expected: float) -> bool:
    """Return whether a slope agrees with the expected order.

    Examples
    --------
    >>> within(1.93, 2), within(2.5, 2)
    (True, False)
    """
    return abs(measured - expected) <= SLOPE_TOLERANCE


def stage_iterates(system: LiePoissonSystem, stages: int, h: float, x: Floats, count: int) -> list[Floats]:
    """Return the function iterates X^0 = x, ..., X^count of equation (6), each (s, n), for s Gauss stages."""
    _, weights, mu = gauss_legendre(stages)
    iterates = [np.tile(x, (stages, 1))]
    for _ in range(count):
        slopes = np.array([system.vector_field(X) for X in iterates[-1]])
        iterates.append(x + h * (mu * weights) @ slopes)
    return iterates


def step_matrix(system: LiePoissonSystem, frozen: Floats, h: float, freeze: str) -> Floats:
    """Return B of the Gauss step for x' = W_j x, W_j frozen at given stages (s, n) (equations (7), (8)); H = x.Mx/2."""
    # `freeze`: "structure", W_j = sign J(X_j) M, gives M-orthogonal B; "gradient", W_j = sign D_u with u = M X_j,
    # orthogonal B on so(3).
    stages, n = frozen.shape
    _, weights, mu = gauss_legendre(stages)
    M = system.hamiltonian.hessian(frozen[0])
    if freeze == "structure":
        W = np.array([system.sign * system.structure_matrix(X) @ M for X in frozen])
    else:
        W = np.array([system.sign * system.algebra.coadjoint(M @ X) for X in frozen])
    coupled = np.einsum("ij,jab->iajb", h * mu * weights, W).reshape(stages * n, stages * n)
    right = np.tile(np.eye(n), (stages, 1))
    points = np.linalg.solve(np.eye(stages * n) - coupled, right).reshape(stages, n, n)
    return np.asarray(np.eye(n) + h * np.einsum("j,jab,jbc->ac", weights, W, points))
