"""Section 5.2 of Reich (1993): the rigid body with its attitude."""

from __future__ import annotations

import numpy as np

from coadjoint.analysis.phase_drift import PhaseDrift, phase_drift
from coadjoint.analysis.powers import fit_order
from coadjoint.experiments.reich1993.systems import (
    BODY_END,
    BODY_LATER,
    BODY_START,
    BODY_STEP,
    CALM_START,
    CALM_STEP,
    MIDPOINT,
    MODIFIED,
    RUNGE,
    SPLITTING,
    BodyRun,
    body_run,
)
from coadjoint.experiments.statements import SLOPE_TOLERANCE, Statement, judge, roundoff, within
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method

CONSERVING_SCHEMES: dict[str, Method] = {
    "modified midpoint": MODIFIED,
    "splitting": SPLITTING,
    "implicit midpoint": MIDPOINT,
}
SMALL_ANGLE = 0.2  # rad, 11 degrees; just visible in the figures


def statements(long_time: float = 500.0) -> list[Statement]:
    """Return the measured statements of section 5.2; `long_time` is the end of the runs for phase errors."""
    calm = {name: body_run(method, CALM_START, long_time, CALM_STEP, 20) for name, method in CONSERVING_SCHEMES.items()}
    return [
        _attitude_update(),
        _attitude_order(),
        _energy_by_gauss(),
        _reference(),
        _runge(),
        _small_phase_errors(),
        _growing_phase(calm),
        _oscillating_phase(calm),
    ]


def _momentum_defect(run: BodyRun) -> float:
    attitude = run.solution.attitude
    assert attitude is not None
    momentum = np.einsum("kij,kj->ki", attitude, run.solution.x)
    return float(np.max(np.linalg.norm(momentum - momentum[0], axis=1)))


def _orthogonality_defect(run: BodyRun) -> float:
    attitude = run.solution.attitude
    assert attitude is not None
    products = np.swapaxes(attitude, 1, 2) @ attitude
    return float(np.max(np.linalg.norm(products - np.eye(3), axis=(1, 2))))


def _attitude_update() -> Statement:
    runs = {name: body_run(method, BODY_START, BODY_LATER, BODY_STEP) for name, method in CONSERVING_SCHEMES.items()}
    size = float(np.linalg.norm(BODY_START))
    # The splitting makes five rotations per step.
    bound = roundoff(5 * BODY_LATER / BODY_STEP, 1.0)
    worst = {name: (_momentum_defect(run) / size, _orthogonality_defect(run)) for name, run in runs.items()}
    return judge(
        "attitude_update",
        "(16)",
        "A_new = A B^T keeps A x and keeps A in SO(3)",
        paper="preserves pi = A x; A_k in SO(3) gives A_(k+1) in SO(3)",
        criterion=f"relative change of A x and |A^T A - I| at most 8 u (5 rotations) steps = {bound:.0e}; t = 50",
        measured="; ".join(f"{name}: {a:.0e}, {b:.0e}" for name, (a, b) in worst.items()),
        holds=max(max(pair) for pair in worst.values()) <= bound,
    )


def _attitude_order() -> Statement:
    slopes = {}
    methods = {**CONSERVING_SCHEMES, "Gauss, 2 stages": GaussLegendre(2)}
    for name, method in methods.items():
        steps = [2.0 / count for count in (32, 64, 128, 256, 512)]
        errors = [float(body_run(method, CALM_START, 2.0, h).angle[-1]) for h in steps]
        slopes[name] = fit_order(steps, errors, [roundoff(2.0 / h, 1.0) for h in steps]).order
    return judge(
        "attitude_order",
        "after (16)",
        "order of the attitude",
        paper="the same as the order of the method applied to (14)",
        criterion=f"slope of the attitude error at t = 2 within {SLOPE_TOLERANCE} of the declared order",
        measured=", ".join(f"{name}: {slope:.2f}" for name, slope in slopes.items()),
        holds=all(within(slopes[name], method.order) for name, method in methods.items()),
    )


def _energy_by_gauss() -> Statement:
    gauss, modified = (
        body_run(m, BODY_START, BODY_LATER, BODY_STEP).solution.drift(relative=False) for m in (MIDPOINT, MODIFIED)
    )
    bound = roundoff(BODY_LATER / BODY_STEP, float(gauss["energy"].initial))
    return judge(
        "energy_by_gauss",
        "after (16)",
        "energy of the I-orthogonal modified scheme and of Gauss methods",
        paper="not preserved by the modified scheme; a Gauss method preserves it",
        criterion=f"Gauss: max |dH| <= 8 u steps H = {bound:.0e}; modified: above 1000 times that; t = 50",
        measured=f"implicit midpoint: {float(gauss['energy']):.0e}, modified midpoint: {float(modified['energy']):.2g} "
        "(the separatrix is 0.167 away)",
        holds=float(gauss["energy"]) <= bound and float(modified["energy"]) > 1000 * bound,
    )


def _reference() -> Statement:
    run = body_run(GaussLegendre(2), BODY_START, BODY_LATER, 0.001, 100)
    error = float(np.max(run.angle))
    return judge(
        "reference_solution",
        "section 5.2",
        'the "exact" solution by the fourth-order Gauss method with h = 0.001',
        paper="used as exact",
        criterion="attitude within 1e-3 rad, the width of a line in the figures, of the closed form; t = 50",
        measured=f"largest attitude error {error:.1e} rad",
        holds=error < 1e-3,
    )


def _runge() -> Statement:
    runs = {
        name: body_run(m, BODY_START, BODY_END, BODY_STEP) for name, m in {"Runge": RUNGE, **CONSERVING_SCHEMES}.items()
    }

    def error(run: BodyRun) -> float:
        attitude = run.solution.attitude
        assert attitude is not None
        return float(np.max(np.abs(attitude[:, 0, 0] - run.exact[:, 0, 0])))

    errors = {name: error(run) for name, run in runs.items()}
    orthogonality = _orthogonality_defect(runs["Runge"])
    return judge(
        "runge_unacceptable",
        "figure 3",
        "the explicit Runge method of order 2",
        paper="unacceptable results",
        criterion="A(1,1) wrong by more than 1, the size of a cosine, within the figure (t = 5), and A no "
        "rotation (off by more than 1)",
        measured="max error of A(1,1): "
        + ", ".join(f"{name}: {value:.2f}" for name, value in errors.items())
        + f"; Runge: |A^T A - I| = {orthogonality:.1f}",
        holds=errors["Runge"] > 1.0 and orthogonality > 1.0,
    )


def _small_phase_errors() -> Statement:
    runs = {
        name: body_run(CONSERVING_SCHEMES[name], BODY_START, 20.0, BODY_STEP)
        for name in ("modified midpoint", "splitting")
    }
    times = (1.0, 2.0, 5.0, 10.0, 20.0)
    shown = {name: [float(run.angle[run.at(t)]) for t in times] for name, run in runs.items()}
    early = all(float(np.max(run.angle[: run.at(2.0) + 1])) <= SMALL_ANGLE for run in runs.values())
    later = all(float(np.max(run.angle[: run.at(BODY_END) + 1])) <= SMALL_ANGLE for run in runs.values())
    return judge(
        "small_phase_errors",
        "figures 4, 5",
        "modified midpoint rule and splitting",
        paper="both yield only small phase errors",
        criterion=f"attitude error at most {SMALL_ANGLE} rad (11 degrees); to t = 2 it holds, to t = 5 (the figures) "
        "it is the limit",
        measured="rad at t = 1, 2, 5, 10, 20: "
        + "; ".join(f"{name} " + ", ".join(f"{v:.3f}" for v in values) for name, values in shown.items()),
        holds=early,
        limited=not later,
    )


def _growing_phase(calm: dict[str, BodyRun]) -> Statement:
    drifts = {name: calm[name].drift for name in ("implicit midpoint", "modified midpoint")}
    end = calm["implicit midpoint"].solution.t[-1]
    return judge(
        "growing_phase",
        "section 5.2",
        "phase error of the modified and the implicit midpoint rule",
        paper="a constantly growing phase error",
        criterion="signed angle about A x, and the line through it: its slope is more than four uncertainties, or "
        "what is not the line grows at least like time; x0 = (1, 2, 1/2), h = 0.05",
        measured="; ".join(
            f"{name}: {_slope(drift)}, {drift.lead[-1]:.3g} rad at t = {end:g}" for name, drift in drifts.items()
        ),
        holds=all(drift.growth in ("linear", "faster") for drift in drifts.values()),
    )


def _slope(drift: PhaseDrift) -> str:
    return f"{drift.growth}, slope {drift.slope:.3g} +- {drift.uncertainty:.1g} rad per unit of time"


def _oscillating_phase(calm: dict[str, BodyRun]) -> Statement:
    run, midpoint = calm["splitting"], calm["implicit midpoint"]
    drift, momentum = run.drift, phase_drift(run.solution)
    late = run.solution.t >= run.solution.t[-1] / 30
    changes = int(np.sum(np.diff(np.sign(run.phase[late])) != 0))
    end = run.solution.t[-1]
    ratio = float(midpoint.angle[-1] / run.angle[-1])
    return judge(
        "oscillating_phase",
        "section 5.2",
        "phase drift of the Lie-Poisson integrator",
        paper='"oscillates" around the zero value',
        criterion="signed angle about A x keeps changing sign and does not grow: no slope beyond four uncertainties; "
        "x0 = (1, 2, 1/2), h = 0.05",
        measured=f"{changes} changes of sign from t = {end / 30:.0f} on; {_slope(drift)}; the momentum on its orbit is "
        f"{momentum.growth} too, {momentum.slope:.3g} +- {momentum.uncertainty:.1g}; attitude error {ratio:.0f} times "
        "smaller than that of the implicit midpoint rule",
        holds=changes > 0 and drift.growth == "bounded",
    )
