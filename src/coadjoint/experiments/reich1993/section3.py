"""Section 3 of Reich (1993), orders: Gauss methods, their iterations, and the modified schemes of Lemma 3.1."""

from __future__ import annotations

import numpy as np

from coadjoint.analysis.powers import fit_order
from coadjoint.experiments.reich1993.systems import four_dimensional_trial
from coadjoint.experiments.statements import (
    SLOPE_TOLERANCE,
    ReferenceProblem,
    Statement,
    fitted_drift,
    fitted_order,
    judge,
    roundoff,
    stage_iterates,
    within,
)
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.iterated_gauss_legendre import IteratedGaussLegendre
from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.integrate import integrate
from coadjoint.systems.lie_poisson import LiePoissonSystem

SLOPES = f"slopes within {SLOPE_TOLERANCE} on so(4), t = 2"
LONG_STEPS, STEP = 2000, 0.05  # steps and step of the runs that should keep an invariant to round-off


def statements() -> list[Statement]:
    """Return the measured statements of section 3 about order and invariants."""
    case = four_dimensional_trial()
    return [
        _gauss_order(case),
        _gauss_keeps(case),
        _stages(case),
        _iteration_order(case),
        _lemma_3_1(case),
        _lemma_3_1_energy(case),
        _remark_3_2(case),
        _iteration_energy(case),
    ]


def _text(slopes: dict[str, float]) -> str:
    return ", ".join(f"{name}: {slope:.2f}" for name, slope in slopes.items())


def _drifts(case: ReferenceProblem, method: Method) -> dict[str, float]:
    """Return the drifts over many steps in units of their round-off bound."""
    run = integrate(case.system, case.x0, (0.0, LONG_STEPS * STEP), STEP, method, save_every=LONG_STEPS)
    size = float(case.x0 @ case.x0)
    return {name: float(drift) / roundoff(LONG_STEPS, size) for name, drift in run.drift(relative=False).items()}


def _gauss_order(case: ReferenceProblem) -> Statement:
    slopes = {f"s={s}": fitted_order(case, GaussLegendre(s)).order for s in (1, 2, 3)}
    return judge(
        "gauss_order",
        "section 3, (5)",
        "Gauss-Legendre methods with s stages",
        paper="order p = 2s",
        criterion=SLOPES,
        measured=_text(slopes),
        holds=all(within(slope, 2 * s) for s, slope in enumerate(slopes.values(), 1)),
    )


def _gauss_keeps(case: ReferenceProblem) -> Statement:
    worst = {s: max(_drifts(case, GaussLegendre(s)).values()) for s in (1, 2, 3)}
    return judge(
        "gauss_quadratic",
        "remarks 3.1, 3.2",
        "Gauss-Legendre methods keep the energy and the quadratic Casimirs",
        paper="T and quadratic Casimir functions are preserved",
        criterion=f"drift over {LONG_STEPS} steps of {STEP} on so(4) at most 8 u steps |x|^2",
        measured="largest drift over bound, " + ", ".join(f"s={s}: {ratio:.2g}" for s, ratio in worst.items()),
        holds=max(worst.values()) <= 1.0,
    )


def _stages(case: ReferenceProblem) -> Statement:
    assert isinstance(case.system, LiePoissonSystem)
    steps = [0.4 / 2**k for k in range(5)]
    errors = np.empty((4, len(steps)))
    for k, h in enumerate(steps):
        iterates = stage_iterates(case.system, 2, h, case.x0, 60)
        errors[:, k] = [np.max(np.abs(iterates[count] - iterates[-1])) for count in range(1, 5)]
    slopes = {f"l={i + 1}": fit_order(steps, row, 1e-15).order for i, row in enumerate(errors)}
    return judge(
        "stage_iterates",
        "section 3, after (6)",
        "stages after l function iterations",
        paper="X_i = X_i^l + O(h^(l+1))",
        criterion=f"slopes l + 1 within {SLOPE_TOLERANCE}, s = 2, so(4)",
        measured=_text(slopes),
        holds=all(within(slope, count + 1) for count, slope in enumerate(slopes.values(), 1)),
    )


def _iteration_order(case: ReferenceProblem) -> Statement:
    slopes = {
        (s, m): fitted_order(case, IteratedGaussLegendre(s, m)).order for s in (1, 2, 3) for m in range(1, 2 * s + 1)
    }
    return judge(
        "iteration_order",
        "section 3, (6)",
        "function iteration used alone",
        paper="order p with m = p iterations",
        criterion=f"{SLOPES}: min(m + 1, p); m = p is enough, and m = p - 1 already",
        measured=_text({f"s={s} m={m}": slope for (s, m), slope in slopes.items()}),
        holds=all(within(slope, min(m + 1, 2 * s)) for (s, m), slope in slopes.items()),
    )


def _lemma_3_1(case: ReferenceProblem) -> Statement:
    slopes = {
        (s, m): fitted_order(case, ModifiedGaussLegendre(s, m)).order for s in (1, 2, 3) for m in range(1, 2 * s + 2)
    }
    return judge(
        "lemma_3_1_order",
        "lemma 3.1",
        "order of the modified Gauss methods (6)-(8)",
        paper="order p with m = p",
        criterion=f"{SLOPES}: min(m, p), so that m = p is needed and enough",
        measured=_text({f"s={s} m={m}": slope for (s, m), slope in slopes.items()}),
        holds=all(within(slope, min(m, 2 * s)) for (s, m), slope in slopes.items()),
    )


def _lemma_3_1_energy(case: ReferenceProblem) -> Statement:
    ratios = {(s, m): _drifts(case, ModifiedGaussLegendre(s, m))["energy"] for s in (1, 2) for m in range(1, 2 * s + 2)}
    return judge(
        "lemma_3_1_energy",
        "lemma 3.1",
        "the modified Gauss methods keep the energy",
        paper="M-orthogonal, hence T is preserved",
        criterion=f"drift over {LONG_STEPS} steps of {STEP} on so(4) at most 8 u steps |x|^2, for every m",
        measured="drift over bound, " + ", ".join(f"s={s} m={m}: {ratio:.1g}" for (s, m), ratio in ratios.items()),
        holds=max(ratios.values()) <= 1.0,
    )


def _remark_3_2(case: ReferenceProblem) -> Statement:
    names = tuple(case.system.casimirs)
    fits = {}
    for s, m in ((1, 2), (1, 3), (1, 4), (2, 4), (2, 5)):
        drifts = [fitted_drift(case, ModifiedGaussLegendre(s, m), name) for name in names]
        fits[s, m] = min(drifts, key=lambda fit: fit.order)
    return judge(
        "remark_3_2",
        "remark 3.2",
        "quadratic Casimirs of the modified schemes",
        paper="preserved up to terms of order m, m >= p",
        criterion=f"slope of the drift, with its uncertainty, at least m - {SLOPE_TOLERANCE}, both Casimirs of so(4), "
        "t = 2",
        measured=", ".join(f"s={s} m={m}: {fit}" for (s, m), fit in fits.items()),
        holds=all(fit.order + fit.uncertainty >= m - SLOPE_TOLERANCE for (_, m), fit in fits.items()),
    )


def _iteration_energy(case: ReferenceProblem) -> Statement:
    slopes = {
        (s, m): fitted_drift(case, IteratedGaussLegendre(s, m), "energy").order
        for s, m in ((1, 3), (1, 4), (1, 5), (2, 5))
    }
    return judge(
        "iteration_energy",
        "section 3, after remark 3.2",
        "function iteration alone with m > p",
        paper="order p in x, M-orthogonal of order m",
        criterion=f"slope of the energy drift at least m - {SLOPE_TOLERANCE} on so(4), t = 2",
        measured=_text({f"s={s} m={m}": slope for (s, m), slope in slopes.items()}),
        holds=all(slope >= m - SLOPE_TOLERANCE for (_, m), slope in slopes.items()),
    )
