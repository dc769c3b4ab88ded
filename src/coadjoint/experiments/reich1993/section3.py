"""Section 3 of Reich (1993): orders of Gauss methods and of the modified schemes of Lemma 3.1, and orthogonal steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.powers import fit_order
from coadjoint.experiments.reich1993.statements import (
    CALM_START,
    M_ORTHOGONAL,
    SLOPE_TOLERANCE,
    ReferenceProblem,
    Statement,
    fitted_drift,
    fitted_order,
    four_dimensional_trial,
    judge,
    roundoff,
    stage_iterates,
    step_matrix,
    within,
)
from coadjoint.methods.gauss_legendre import GaussLegendre, IteratedGaussLegendre, ModifiedGaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.radau_energy import RadauEnergy
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.stepper import stepper
from coadjoint.systems.examples.paper_examples import paper_rigid_body

SLOPES = f"slopes within {SLOPE_TOLERANCE} on so(4), t = 2"
LONG_STEPS, LONG_STEP = 2000, 0.05  # steps and step of the runs that should keep an invariant to round-off


def order_statements() -> list[Statement]:
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
    run = integrate(case.system, case.x0, (0.0, LONG_STEPS * LONG_STEP), LONG_STEP, method, save_every=LONG_STEPS)
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
        criterion=f"drift over {LONG_STEPS} steps of {LONG_STEP} on so(4) at most 8 u steps |x|^2",
        measured="largest drift over bound, " + ", ".join(f"s={s}: {ratio:.2g}" for s, ratio in worst.items()),
        holds=max(worst.values()) <= 1.0,
    )


def _stages(case: ReferenceProblem) -> Statement:
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
        criterion=f"drift over {LONG_STEPS} steps of {LONG_STEP} on so(4) at most 8 u steps |x|^2, for every m",
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


STEP = 0.1  # as in the other sections
CONVERGED_ITERATIONS = 60  # at which the stages no longer change


def orthogonality_statements() -> list[Statement]:
    """Return the measured statements of section 3 about orthogonality."""
    return [
        _midpoint_formula(),
        _not_symmetric(),
        _radau(),
        _stronger_than_energy(),
        _dissipation(),
        _identity(),
        _gauss_both(),
        _modified_either(),
    ]


def _matrix_bound(B: npt.NDArray[Any], unknowns: int = 3) -> float:
    return 64 * UNIT_ROUNDOFF * unknowns * float(np.linalg.norm(B) ** 2)


def _midpoint_formula() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    M = np.diag(body.hamiltonian.gradient(np.ones(3)))
    X = x + STEP / 2 * body.structure_matrix(x) @ M @ x
    W = STEP / 2 * body.structure_matrix(X) @ M
    B = np.linalg.solve(np.eye(3) - W, np.eye(3) + W)
    difference = float(np.linalg.norm(stepper(body, M_ORTHOGONAL, STEP)(x) - B @ x))
    defect = float(np.linalg.norm(B.T @ M @ B - M))
    return judge(
        "midpoint_formula",
        "(10)-(11)",
        "the modified midpoint rule is Lemma 3.1 with s = 1, m = 2, and M-orthogonal",
        paper="x_new = (I - h/2 J(X) M)^-1 (I + h/2 J(X) M) x, X = x + h/2 J(x) M x",
        criterion=f"below {_matrix_bound(B):.0e} = 64 u (3 unknowns) |B|^2",
        measured=f"|step - formula| = {difference:.1e}, |B^T M B - M| = {defect:.1e}",
        holds=max(difference, defect) <= _matrix_bound(B),
    )


def _not_symmetric() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    steps = [0.4 / 2**k for k in range(6)]

    def returned(method: ModifiedGaussLegendre | GaussLegendre) -> list[float]:
        return [float(np.linalg.norm(stepper(body, method, -h)(stepper(body, method, h)(x)) - x)) for h in steps]

    slope = fit_order(steps, returned(M_ORTHOGONAL), 1e-14).order
    symmetric = max(returned(GaussLegendre(1)))
    bound = roundoff(2, float(np.linalg.norm(x)))
    return judge(
        "midpoint_not_symmetric",
        "after (11)",
        "the modified midpoint rule is not symmetric",
        paper="no longer symmetric",
        criterion="a step there and back misses by O(h^4): slope 4; the implicit midpoint rule misses by 16 u |x|",
        measured=f"slope {slope:.2f}; implicit midpoint rule: {symmetric:.1e} (bound {bound:.1e})",
        holds=within(slope, 4) and symmetric <= bound,
    )


def _radau() -> Statement:
    body = paper_rigid_body()
    run = integrate(body, CALM_START, (0.0, 20.0), STEP, RadauEnergy(2))
    drift = run.drift(relative=False)
    lost = float(run.casimirs["|x|^2"][-1] - run.casimirs["|x|^2"][0])
    bound = roundoff(run.stats.steps, float(drift["energy"].initial))
    return judge(
        "remark_3_1",
        "remark 3.1",
        "Radau methods on the energy surface",
        paper="T is preserved; artificial dissipation on the level set might be introduced",
        criterion=f"|dH| <= 8 u steps H = {bound:.0e}, while |x|^2 changes by more than 1000 times that; h = "
        "0.1, t = 20",
        measured=f"max |dH| = {float(drift['energy']):.1e}; |x|^2 = 5.25 changes by {lost:.2e}",
        holds=float(drift["energy"]) <= bound and abs(lost) > 1000 * bound,
    )


def _stronger_than_energy() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    y = stepper(body, RadauEnergy(2), STEP)(x)
    M = np.diag(body.hamiltonian.gradient(np.ones(3)))
    root = np.diag(np.sqrt(np.diag(M)))
    a, b = root @ x / np.linalg.norm(root @ x), root @ y / np.linalg.norm(root @ y)
    # The rotation in the plane of a and b that takes a to b.
    rotation = np.eye(3) - np.outer(a + b, a + b) / (1 + a @ b) + 2 * np.outer(b, a)
    B = np.linalg.inv(root) @ rotation @ root
    error, defect = float(np.linalg.norm(B @ x - y)), float(np.linalg.norm(B.T @ M @ B - M))
    equivalent = max(error, defect) <= _matrix_bound(B)
    return judge(
        "stronger_than_energy",
        "abstract, remark 3.1",
        "M-orthogonality is more than preservation of energy",
        paper="stronger; the Radau method keeps T but is not M-orthogonal",
        criterion=f"no M-orthogonal B(x) with B(x) x = Radau step; one that fits to {_matrix_bound(B):.0e} = 64 "
        "u (3) |B|^2 "
        "is a counterexample",
        measured=f"B = M^-1/2 (rotation from M^1/2 x to M^1/2 y) M^1/2: |B^T M B - M| = {defect:.1e}, |B x - y| "
        f"= {error:.1e}; "
        "for M > 0 both mean the same",
        holds=not equivalent,
    )


def _dissipation() -> Statement:
    body = paper_rigid_body()
    run = integrate(body, CALM_START, (0.0, 2000.0), STEP, M_ORTHOGONAL, save_every=1000)
    growth = run.casimirs["|x|^2"] - run.casimirs["|x|^2"][0]
    shown = {t: float(growth[int(t / 100)]) for t in (100, 1000, 2000)}
    energy = float(run.drift(relative=False)["energy"])
    bound = roundoff(run.stats.steps, float(np.dot(CALM_START, CALM_START)))
    return judge(
        "no_dissipation",
        "introduction",
        "M-orthogonal schemes do not drift on the level sets of the energy",
        paper="also non-dissipative on these level curves",
        criterion=f"drift of |x|^2 at most 8 u steps |x|^2 = {bound:.0e}, for (10)-(11) at h = 0.1, x0 = (1, 2, 1/2)",
        measured="|x|^2 = 5.25 grows by "
        + ", ".join(f"{value:.3f} (t = {t})" for t, value in shown.items())
        + f"; max |dH| = {energy:.1e}",
        holds=bool(np.max(np.abs(growth)) <= bound),
    )


def _identity() -> Statement:
    algebra = paper_rigid_body().algebra
    random = np.random.default_rng(1993)
    x, y = random.integers(-50, 50, size=(2, 100, 3)).astype(float)
    excess = max(
        float(np.max(np.abs(algebra.structure_matrix(p) @ q + algebra.structure_matrix(q) @ p)))
        for p, q in zip(x, y, strict=True)
    )
    return judge(
        "example_3_1_identity",
        "example 3.1",
        "J(x) y = -J(y) x on so(3)",
        paper="J(x) y = -J(y) x",
        criterion="exact in whole numbers, 100 pairs",
        measured=f"largest |J(x) y + J(y) x| = {excess:g}",
        holds=excess == 0.0,
    )


def _gauss_both() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    M = np.diag(body.hamiltonian.gradient(np.ones(3)))
    stages = stage_iterates(body, 2, STEP, x, CONVERGED_ITERATIONS)[-1]
    by_structure = step_matrix(body, stages, STEP, "structure")
    by_gradient = step_matrix(body, stages, STEP, "gradient")
    bound = _matrix_bound(by_structure, 6)
    agree = float(np.linalg.norm(by_structure @ x - by_gradient @ x))
    first = float(np.linalg.norm(by_structure.T @ M @ by_structure - M))
    second = float(np.linalg.norm(by_gradient.T @ by_gradient - np.eye(3)))
    both_defect = float(np.linalg.norm(by_structure.T @ by_structure - np.eye(3)))
    return judge(
        "example_3_1_gauss",
        "example 3.1",
        "Gauss methods on so(3) are both M- and I-orthogonal",
        paper="both M- and I-orthogonal",
        criterion=f"x_new = B x = C x, B^T M B = M, C^T C = I to {bound:.0e} = 64 u (6 unknowns) |B|^2; "
        "for one matrix, B = C",
        measured=f"|B x - C x| = {agree:.0e}, |B^T M B - M| = {first:.0e}, |C^T C - I| = {second:.0e}, "
        "but |B^T B - I| = "
        f"{both_defect:.2g}: two different matrices",
        holds=max(agree, first, second) <= bound,
        limited=both_defect > bound,
    )


def _modified_either() -> Statement:
    body = paper_rigid_body()
    drifts = {}
    for freeze in ("structure", "gradient"):
        run = integrate(body, CALM_START, (0.0, 100.0), STEP, ModifiedGaussLegendre(1, freeze=freeze), save_every=1000)
        drifts[freeze] = {name: float(value) for name, value in run.drift(relative=False).items()}
    bound = roundoff(1000, float(np.dot(CALM_START, CALM_START)))
    preserved = max(drifts["structure"]["energy"], drifts["gradient"]["|x|^2"])
    lost = min(drifts["structure"]["|x|^2"], drifts["gradient"]["energy"])
    return judge(
        "example_3_1_modified",
        "example 3.1",
        "modified Gauss methods are M- or I-orthogonal, by the formulation",
        paper="x' = J(x) M x: M-orthogonal; x' = -J(M x) x: I-orthogonal",
        criterion=f"energy resp. |x|^2 kept to 8 u steps |x|^2 = {bound:.0e}, the other lost by 1000 times "
        "that; t = 100",
        measured=f"J(x) M x: max |dH| = {drifts['structure']['energy']:.0e}, max |d|x|^2| = "
        f"{drifts['structure']['|x|^2']:.2g}; -J(M x) x: {drifts['gradient']['energy']:.2g} and "
        f"{drifts['gradient']['|x|^2']:.0e}",
        holds=preserved <= bound and lost > 1000 * bound,
    )
