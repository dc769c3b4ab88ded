"""Section 7 of Reich (1993): other brackets and other Hamiltonians."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coadjoint.algebra import catalogue
from coadjoint.analysis.poisson_defect import poisson_defect
from coadjoint.experiments.reich1993.systems import CALM_START, COORDINATES
from coadjoint.experiments.statements import (
    SLOPE_TOLERANCE,
    Statement,
    fitted_drift,
    fitted_order,
    judge,
    reference_problem,
    roundoff,
    within,
)
from coadjoint.methods.modified_gauss_legendre import ModifiedGaussLegendre
from coadjoint.runs.integrate import integrate
from coadjoint.runs.stepper import stepper
from coadjoint.systems.examples.paper_examples import paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import Separable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem

STEP_COUNTS = (32, 64, 128, 256)  # few, since every run compiles the functions again


def curved_structure(x: Any) -> Any:
    """Return (1 + x1^2) times the structure matrix of so(3): a Poisson bracket that is not linear."""
    f = 1.0 + x[0] * x[0]
    return np.array([[0.0, f * x[2], -f * x[1]], [-f * x[2], 0.0, f * x[0]], [f * x[1], -f * x[0], 0.0]])


def statements() -> list[Statement]:
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
