"""Section 5.1 of Reich (1993): the Euler equations on A3,7."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from coadjoint.experiments.reich1993.systems import COORDINATES, SPIRAL_END, SPIRAL_START, SPIRAL_STEP
from coadjoint.experiments.statements import Statement, judge, roundoff
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.examples.paper_examples import paper_a37

MASSES = (1.0, 2.0, 0.01)
A = 2.0
MODIFIED = ModifiedGaussLegendre(stages=1, freeze="structure")


def spiral_run(method: Method, a: float = A) -> Solution:
    """Return the run of figure 1 or 2, with every step saved."""
    return integrate(paper_a37(a), SPIRAL_START, (0.0, SPIRAL_END), SPIRAL_STEP, method)


def statements() -> list[Statement]:
    """Return the measured statements of section 5.1."""
    return [_flows(), _parameter(), _printed_casimir(), _figure_1(), _figure_2()]


def _printed_flow(i: int, t: float, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    x1, x2, x3 = x
    if i == 0:
        return np.array([x1, x2, x3 + t * MASSES[0] * x1 * (-A * x1 + x2)])
    if i == 1:
        return np.array([x1, x2, x3 - t * MASSES[1] * x2 * (x1 + A * x2)])
    gamma, omega = A * MASSES[2] * x3, MASSES[2] * x3
    growth, cosine, sine = math.exp(gamma * t), math.cos(omega * t), math.sin(omega * t)
    return np.array([growth * (cosine * x1 - sine * x2), growth * (sine * x1 + cosine * x2), x3])


def _flows() -> Statement:
    x, time = np.array([1.0, -0.7, 3.0]), 0.4
    errors = []
    for i in range(3):
        single_term = paper_a37(A, np.where(np.arange(3) == i, MASSES, 0.0))
        run = integrate(single_term, x, (0.0, time), time / 4, GaussLegendre(8), save_every=4)
        errors.append(float(np.linalg.norm(run.x[-1] - _printed_flow(i, time, x))))
    y = x
    for i, share in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        y = _printed_flow(i, share * time, y)
    step = integrate(paper_a37(A), x, (0.0, time), time, COORDINATES).x[-1]
    composed = float(np.linalg.norm(step - y))
    bound = roundoff(5, float(np.linalg.norm(x)))
    return judge(
        "spiral_flows",
        "section 5.1",
        "the three printed flows on A3,7",
        paper="X_t^1, X_t^2 shears of x3; X_t^3 a spiral with gamma = a m33 x3, omega = m33 x3",
        criterion="against 8 Gauss stages on T_i alone, t = 0.4, and composed against the splitting: 8 u (5 "
        f"flows) |x| = {bound:.0e}",
        measured="errors "
        + ", ".join(f"X{i + 1}: {error:.0e}" for i, error in enumerate(errors))
        + f"; step: {composed:.0e}",
        holds=max(*errors, composed) <= bound,
    )


def _parameter() -> Statement:
    drifts = {a: float(spiral_run(COORDINATES, a).drift(relative=False)["log C"]) for a in (2.0, 1.0, 0.5, -1.5)}
    bound = roundoff(5 * SPIRAL_END / SPIRAL_STEP, 1.0)
    return judge(
        "spiral_parameter",
        "section 5.1",
        "the parameter a of A3,7",
        paper="a > 1",
        criterion="Jacobi identity (checked when the algebra is made) and Casimir kept to 8 u (5 flows) steps "
        f"= {bound:.0e}",
        measured="max |d log C| "
        + ", ".join(f"a = {a:g}: {drift:.0e}" for a, drift in drifts.items())
        + "; the condition a > 1 is not needed",
        holds=drifts[A] <= bound,
        limited=max(drifts.values()) <= bound,
    )


def _printed_casimir() -> Statement:
    run = spiral_run(COORDINATES)
    x1, x2 = run.x[:, 0], run.x[:, 1]
    printed = np.log((x1**2 + x2**2) * np.exp(-2 * A * np.arctan(x2 / x1)))
    jumps = np.diff(printed)
    size = float(np.max(np.abs(jumps)))
    bound = roundoff(5 * run.stats.steps, 1.0)
    unwrapped = float(run.drift(relative=False)["log C"])
    crossings = np.flatnonzero(np.diff(np.sign(x1)) != 0)
    return judge(
        "spiral_casimir",
        "section 5.1",
        "the printed Casimir C = (x1^2 + x2^2) exp(-2 a arctan(x2/x1))",
        paper="C is the Casimir function",
        criterion=f"constant along the splitting to 8 u (5 flows) steps = {bound:.0e}, with the angle unwrapped",
        measured=f"unwrapped: max |d log C| = {unwrapped:.0e}; with the principal arctan log C jumps by "
        f"{size / math.pi:.3f} pi "
        f"where x1 changes sign ({len(crossings)} times)",
        holds=unwrapped <= bound,
        limited=size > 1.0,
    )


def _figure_1() -> Statement:
    run = spiral_run(COORDINATES)
    half = integrate(paper_a37(A), SPIRAL_START, (0.0, SPIRAL_END), SPIRAL_STEP / 2, COORDINATES, save_every=100)
    energy, casimir = float(run.drift(relative=False)["energy"]), float(run.drift(relative=False)["log C"])
    ratio = energy / float(half.drift(relative=False)["energy"])
    bound = roundoff(5 * run.stats.steps, 1.0)
    return judge(
        "figure_1",
        "figure 1",
        "drift of the Lie-Poisson integrator on A3,7",
        paper="Casimir kept; the energy is not, but does not run away",
        criterion=f"max |d log C| <= 8 u (5 flows) steps = {bound:.0e}; max |dH| of order h^2: falls 4 times at "
        "h/2, within 5 %",
        measured=f"max |d log C| = {casimir:.1e}, max |dH| = {energy:.1e}, {ratio:.2f} times that at h/2",
        holds=casimir <= bound and abs(ratio - 4.0) <= 0.2,
    )


def _figure_2() -> Statement:
    run = spiral_run(MODIFIED)
    half = integrate(paper_a37(A), SPIRAL_START, (0.0, SPIRAL_END), SPIRAL_STEP / 2, MODIFIED, save_every=100)
    energy, casimir = float(run.drift(relative=False)["energy"]), float(run.drift(relative=False)["log C"])
    ratio = casimir / float(half.drift(relative=False)["log C"])
    bound = roundoff(run.stats.steps, float(run.drift(relative=False)["energy"].initial))
    return judge(
        "figure_2",
        "figure 2",
        "drift of the M-orthogonal modified midpoint rule on A3,7",
        paper="energy kept; the Casimir is not",
        criterion=f"max |dH| <= 8 u steps H = {bound:.0e}; max |d log C| of order h^2: falls 4 times at h/2, "
        "within 5 %",
        measured=f"max |dH| = {energy:.1e}, max |d log C| = {casimir:.1e}, {ratio:.2f} times that at h/2",
        holds=energy <= bound and abs(ratio - 4.0) <= 0.2,
    )
