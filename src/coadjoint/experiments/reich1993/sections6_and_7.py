"""Sections 6 and 7 of Reich (1993): backward error analysis, other brackets and other Hamiltonians."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coadjoint.algebra import catalogue
from coadjoint.analysis.backward_error.modified_hamiltonian import ModifiedHamiltonian, modified_hamiltonian
from coadjoint.analysis.powers import fit_order, fit_power
from coadjoint.analysis.structure_defects import poisson_defect
from coadjoint.experiments.reich1993.statements import (
    CALM_START,
    COORDINATES,
    SLOPE_TOLERANCE,
    Statement,
    body_trial,
    fitted_drift,
    fitted_order,
    judge,
    reference_problem,
    roundoff,
    within,
)
from coadjoint.methods.explicit_runge_kutta import ExplicitRungeKutta
from coadjoint.methods.gauss_legendre import ModifiedGaussLegendre
from coadjoint.methods.splitting import Splitting
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.stepper import stepper
from coadjoint.systems.examples.paper_examples import paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import Separable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem


def section6_statements() -> list[Statement]:
    """Return the measured statements of section 6."""
    return [_perturbed_hamiltonian(), _lemma_6_1(), _bracket(), _remark_6_1()]


def _perturbed_hamiltonian() -> Statement:
    body = paper_rigid_body()
    modified = modified_hamiltonian(body, COORDINATES, order=4)
    assert isinstance(modified, ModifiedHamiltonian)
    second = modified.terms[2]
    steps = [10.0 / count for count in (40, 60, 80, 120, 160, 240)]
    plain, perturbed = [], []
    for h in steps:
        run = integrate(body, CALM_START, (0.0, 10.0), h, COORDINATES, observe={"H2": second})
        perturbed_energy = run.energy + h**2 * run.observed["H2"]
        plain.append(float(np.max(np.abs(run.energy - run.energy[0]))))
        perturbed.append(float(np.max(np.abs(perturbed_energy - perturbed_energy[0]))))
    floor = [roundoff(10.0 / h, float(body.energy(CALM_START))) for h in steps]
    slopes = fit_order(steps, plain, floor).order, fit_order(steps, perturbed, floor).order
    return judge(
        "perturbed_hamiltonian",
        "section 6",
        "the splitting is the flow of a perturbed Hamiltonian",
        paper="T~ = T + O(h^p), no longer quadratic",
        criterion="H + h^2 H2, H2 from brackets, of degree 4, is kept to O(h^4) where H is to O(h^2): slopes "
        f"within {SLOPE_TOLERANCE}",
        measured=f"slope of max |dH|: {slopes[0]:.2f}, of max |d(H + h^2 H2)|: {slopes[1]:.2f}; degree of H2: "
        f"{second.degree}",
        holds=within(slopes[0], 2) and within(slopes[1], 4) and second.degree == 4,
    )


def _lemma_6_1() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    gradients = {"T": body.hamiltonian.gradient(x), "|x|^2": 2 * x}
    cases = {
        "M-orthogonal, T": (ModifiedGaussLegendre(1, freeze="structure"), "T"),
        "I-orthogonal, |x|^2": (ModifiedGaussLegendre(1, freeze="gradient"), "|x|^2"),
        "splitting, |x|^2": (COORDINATES, "|x|^2"),
        "Runge, T": (ExplicitRungeKutta("runge2"), "T"),
    }
    steps = [0.1 / 2**k for k in range(5)]
    slopes = {}
    for name, (method, invariant) in cases.items():
        # Y^[3] is the limit of (psi_h - phi_h) / h^3; the field of the subgroup is tangent to the level set.
        leading_errors = [
            abs(float(gradients[invariant] @ (stepper(body, method, h)(x) - body.exact(x, h)))) / h**3 for h in steps
        ]
        slopes[name] = fit_power(steps, leading_errors)
    preserving_slopes = [slope for name, slope in slopes.items() if name != "Runge, T"]
    return judge(
        "lemma_6_1",
        "lemma 6.1",
        "the leading error Y of a scheme lies in the Lie algebra of its group of maps",
        paper="Y^[p+1] is in g",
        criterion="grad I . (psi_h - phi_h)/h^3 falls at least like h for the invariant I kept (slope 1 - "
        f"{SLOPE_TOLERANCE} or more), "
        "and tends to a constant where it is not kept (slope 0)",
        measured=", ".join(f"{name}: slope {slope:.2f}" for name, slope in slopes.items()),
        holds=min(preserving_slopes) >= 1 - SLOPE_TOLERANCE and within(slopes["Runge, T"], 0),
    )


def _bracket() -> Statement:
    random = np.random.default_rng(6)
    n = 5
    skew = [r - r.T for r in random.integers(-9, 9, size=(2, n, n)).astype(float)]
    M = np.diag(random.integers(1, 9, size=n).astype(float))
    x = random.integers(-9, 9, size=n).astype(float)
    first, second = skew[0] @ M, skew[1] @ M
    X, Y = first @ x, second @ x
    # sum_i (Y_i dX_j/dx_i - X_i dY_j/dx_i); derivatives of linear fields are their matrices.
    bracket = first @ Y - second @ X
    J3 = skew[0] @ M @ skew[1] - skew[1] @ M @ skew[0]
    excess = float(np.max(np.abs(bracket - J3 @ M @ x)) + np.max(np.abs(J3 + J3.T)))
    return judge(
        "bracket_of_fields",
        "section 6",
        "M-orthogonal fields with constant J are closed under the bracket",
        paper="[X, Y]_i = sum_i (Y_i dX_j/dx_i - X_i dY_j/dx_i); J3 = J1 M J2 - J2 M J1 is skew",
        criterion="exact in whole numbers, n = 5",
        measured=f"|[X, Y] - J3 M x| + |J3 + J3^T| = {excess:g}, with [X, Y]_j on the left (the printed index i "
        "is also summed over)",
        holds=excess == 0.0,
    )


def _remark_6_1() -> Statement:
    case = body_trial()
    sweep, adjoint = (Splitting(order=1, parts="coordinates", adjoint=back) for back in (False, True))
    c1 = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    fractions = (c1, 1.0 - 2.0 * c1, c1)
    counts = (64, 128, 256, 512)

    def slope(pieces: list[tuple[Splitting, float]]) -> float:
        errors = []
        for count in counts:
            steps = [stepper(case.system, method, share * case.end / count) for method, share in pieces]
            x = case.x0
            for _ in range(count):
                for step in steps:
                    x = step(x)
            errors.append(float(np.linalg.norm(x - case.exact)))
        return fit_order([case.end / count for count in counts], errors, 1e4 * UNIT_ROUNDOFF).order

    sweeps_alone = slope([(sweep, share) for share in fractions])
    paired = slope([(method, share / 2) for share in fractions for method in (sweep, adjoint)])
    return judge(
        "remark_6_1",
        "remark 6.1",
        "higher orders by composition of a first-order splitting",
        paper="from a first order integrator, any order by the method of [25]",
        criterion="order 4 from (c1, c2, c1): slopes within 0.2 of 4",
        measured=f"first-order sweeps alone: slope {sweeps_alone:.2f}; each with its adjoint, psi(h/2) psi*(h/2): "
        f"slope {paired:.2f}; "
        "the adjoint is needed",
        holds=within(paired, 4),
        limited=not within(sweeps_alone, 4),
    )


STEP_COUNTS = (32, 64, 128, 256)  # few, since every run compiles the functions again


def curved_structure(x: Any) -> Any:
    """Return (1 + x1^2) times the structure matrix of so(3): a Poisson bracket that is not linear."""
    f = 1.0 + x[0] * x[0]
    return np.array([[0.0, f * x[2], -f * x[1]], [-f * x[2], 0.0, f * x[0]], [f * x[1], -f * x[0], 0.0]])


def section7_statements() -> list[Statement]:
    """Return the measured statements of section 7."""
    return [_other_bracket(), _separable()]


def _other_bracket() -> Statement:
    system = PoissonSystem(curved_structure, Quadratic([1.0, 0.5, 1.0 / 3.0]), casimirs=paper_rigid_body().casimirs)
    case = reference_problem(system, CALM_START, 0.5)
    method = ModifiedGaussLegendre(1, freeze="structure")
    slope, lost = fitted_order(case, method, STEP_COUNTS).order, fitted_drift(case, method, "|x|^2", STEP_COUNTS).order
    run = integrate(system, CALM_START, (0.0, 50.0), 0.05, method, save_every=1000)
    drift, bound = float(run.drift(relative=False)["energy"]), roundoff(1000, 5.25)
    return judge(
        "other_bracket",
        "(17)",
        "M-orthogonal schemes for a bracket that is not linear in x",
        paper="the results can be generalized to x' = J(x) grad T(x), T quadratic",
        criterion=f"J = (1 + x1^2) J of so(3): slope 2 within {SLOPE_TOLERANCE}, |dH| over 1000 steps at most 8 "
        f"u steps |x|^2 = {bound:.0e}",
        measured=f"slope {slope:.2f}, max |dH| = {drift:.0e}; the Casimir |x|^2 is kept to O(h^{lost:.1f}) only",
        holds=within(slope, 2) and drift <= bound,
    )


def _separable() -> Statement:
    functions: dict[int, Any] = {
        0: (lambda y: math.cosh(y), lambda y: math.sinh(y), lambda y: math.cosh(y)),
        1: (lambda y: 0.25 * y * y, lambda y: 0.5 * y, lambda y: 0.5),
        2: (lambda y: math.sin(y), lambda y: math.cos(y), lambda y: -math.sin(y)),
    }
    system = LiePoissonSystem(catalogue.so(3), Separable(functions), name="separable")
    slope = fitted_order(reference_problem(system, CALM_START, 1.0), COORDINATES, STEP_COUNTS).order
    run = integrate(system, CALM_START, (0.0, 100.0), 0.05, COORDINATES, save_every=2000)
    drift, bound = float(run.drift(relative=False)["|x|^2"]), roundoff(5 * 2000, 5.25)
    defect = poisson_defect(stepper(system, COORDINATES, 0.05), CALM_START)
    return judge(
        "separable",
        "section 7",
        "the splitting for a Hamiltonian that is a sum of functions of one coordinate",
        paper="the results can be generalized to H = sum H_i(x_i)",
        criterion=f"H = cosh x1 + x2^2/4 + sin x3 on so(3): slope 2 within {SLOPE_TOLERANCE}; |x|^2 over 2000 "
        "steps kept to "
        f"8 u (5 flows) steps |x|^2 = {bound:.0e}; Poisson defect below {defect.bound:.0e} = 64 u operations |P|^2 |J|",
        measured=f"slope {slope:.2f}, max |d|x|^2| = {drift:.0e}, Poisson defect {defect.defect:.0e}",
        holds=within(slope, 2) and drift <= bound and defect.poisson,
    )
