"""Statements of Reich (1993) with verdicts, and what they are measured by: systems, runs, orders, steps as matrices."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.analysis.phase_drift import ANGLES, PhaseDrift, drift_of_series
from coadjoint.analysis.phase_error import attitude_angle, precession_error
from coadjoint.analysis.powers import OrderFit, fit_order
from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta
from coadjoint.methods.gauss_legendre import GaussLegendre, ModifiedGaussLegendre
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.splitting import Splitting
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.examples.paper_examples import paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System

Floats = npt.NDArray[np.float64]
HOLDS, LIMITED, FAILS = "holds", "holds with a limit", "does not hold"
SLOPE_TOLERANCE = 0.2  # contribution of the next error term to a slope at the steps used here

# Numbers of steps for slopes: few, large steps for high orders, which soon reach round-off; small ones for low orders,
# whose slopes converge late.
LOW_ORDER_COUNTS = (32, 64, 128, 256, 512)
HIGH_ORDER_COUNTS = (12, 16, 24, 32, 48, 64, 96)

# Section 5.1: the paper gives h and a; initial state and time are chosen here to show the whole motion.
SPIRAL_START, SPIRAL_END, SPIRAL_STEP = (1.0, 1.0, 1.0), 20.0, 0.01

# Section 5.2: the state near the separatrix and the step are the paper's; [0, 5] reproduces its figures.
BODY_START, BODY_STEP, BODY_END, BODY_LATER = (1.0, 10.0, 1.0), 0.1, 5.0, 50.0

# A rigid body far from the separatrix, for long runs.
CALM_START, CALM_STEP = (1.0, 2.0, 0.5), 0.05

COORDINATES = Splitting(order=2, parts="coordinates")
"""Lemma 4.1 in the form of the paper: one coordinate at a time."""

RUNGE: Method = ExplicitRungeKutta("runge2")
MIDPOINT: Method = GaussLegendre(1)
MODIFIED: Method = ModifiedGaussLegendre(1, freeze="gradient")
M_ORTHOGONAL = ModifiedGaussLegendre(1, freeze="structure")
"""The modified midpoint rule that keeps the energy."""
SPLITTING: Method = COORDINATES


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
    """Return an upper bound of accumulated round-off: 8 roundings of 2^-53 per step, all of one sign."""
    return 8 * UNIT_ROUNDOFF * steps * size


def fitted_order(case: ReferenceProblem, method: Method, counts: Sequence[int] | None = None) -> OrderFit:
    """Fit the order of a scheme from its error at the end of a trial; default `counts` follow the declared order."""

    def error_at_end(run: Solution) -> tuple[float, float]:
        return float(np.linalg.norm(run.x[-1] - case.exact)), float(np.linalg.norm(case.x0))

    return _fitted(case, method, counts or (HIGH_ORDER_COUNTS if method.order > 3 else LOW_ORDER_COUNTS), error_at_end)


def fitted_drift(
    case: ReferenceProblem, method: Method, invariant: str, counts: Sequence[int] = HIGH_ORDER_COUNTS
) -> OrderFit:
    """Fit the order of the largest drift of an invariant ("energy" or a Casimir) along a trial."""

    def largest_drift(run: Solution) -> tuple[float, float]:
        drift = run.drift(relative=False)[invariant]
        return float(drift), abs(float(drift.initial))

    return _fitted(case, method, counts, largest_drift)


def _fitted(
    case: ReferenceProblem, method: Method, counts: Sequence[int], measure: Callable[[Solution], tuple[float, float]]
) -> OrderFit:
    """Fit the order of what is measured of runs with these numbers of steps, beside the size that is rounded."""
    steps = [case.end / count for count in counts]
    runs = [
        integrate(case.system, case.x0, (0.0, case.end), h, method, save_every=n)
        for h, n in zip(steps, counts, strict=True)
    ]
    errors, sizes = zip(*map(measure, runs), strict=True)
    return fit_order(steps, errors, [roundoff(count, size) for count, size in zip(counts, sizes, strict=True)])


def within(measured: float, expected: float) -> bool:
    """Return whether a slope agrees with the expected order.

    >>> within(1.93, 2), within(2.5, 2)
    (True, False)
    """
    return abs(measured - expected) <= SLOPE_TOLERANCE


def stage_iterates(system: System, stages: int, h: float, x: Floats, count: int) -> list[Floats]:
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


def four_dimensional_body() -> LiePoissonSystem:
    """Return a rigid body in four dimensions: so(4), six coordinates, two Casimirs, generic M."""
    return LiePoissonSystem(catalogue.so(4), Quadratic([1.0, 0.8, 0.55, 0.9, 0.35, 0.6]), name="body in 4 dimensions")


def body_trial() -> ReferenceProblem:
    """Return the trial of the rigid body far from the separatrix up to t = 2."""
    return reference_problem(paper_rigid_body(), CALM_START, 2.0)


def four_dimensional_trial() -> ReferenceProblem:
    """Return the trial of the four-dimensional body up to t = 2."""
    return reference_problem(four_dimensional_body(), np.array([0.9, -0.4, 0.7, 0.5, 1.1, -0.6]), 2.0)


def body_run(method: Method, x0: tuple[float, ...], end: float, step: float, save_every: int = 1) -> Solution:
    """Integrate the paper's rigid body from the body angular momentum x0 and attitude I."""
    return integrate(paper_rigid_body(), x0, (0.0, end), step, method, attitude=True, save_every=save_every)


def attitude_of(run: Solution) -> Floats:
    """Return the attitude (k, 3, 3) of a run that carries it."""
    assert run.attitude is not None
    return run.attitude


def exact_attitude(run: Solution) -> Floats:
    """Return the exact attitude (k, 3, 3) of the rigid body at the saved times."""
    return np.asarray(paper_rigid_body().exact(run.x[0], run.t, attitude=True)[1])


def attitude_error(run: Solution) -> Floats:
    """Return the angle between computed and exact attitude in radians, shape (k,)."""
    return np.asarray(attitude_angle(attitude_of(run), exact_attitude(run)))


def precession_lead(run: Solution) -> Floats:
    """Return the phase lead of the computed body about the constant spatial momentum, in radians, signed, (k,)."""
    return np.asarray(precession_error(attitude_of(run), exact_attitude(run), run.x[0]))


def precession_drift(run: Solution) -> PhaseDrift:
    """Return the growth of the phase of the attitude, in radians."""
    return drift_of_series(run.t, precession_lead(run), ANGLES)


def index_of_time(run: Solution, time: float) -> int:
    """Return the index of a saved time."""
    return int(np.argmin(np.abs(run.t - time)))
