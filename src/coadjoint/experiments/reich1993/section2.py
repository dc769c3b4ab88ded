"""Section 2 of Reich (1993): invariants of the exact motion."""

from __future__ import annotations

import numpy as np

from coadjoint.analysis.poisson_defect import poisson_defect
from coadjoint.experiments.reich1993.statements import (
    CALM_START,
    SPIRAL_START,
    Statement,
    judge,
    stage_iterates,
    step_matrix,
)
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.stepper import stepper
from coadjoint.systems.examples.paper_examples import paper_a37, paper_rigid_body

TIME = 0.1  # one step of the example
STAGES = 8  # of order 16; a step of 0.1 is the exact motion to round-off
CONVERGED_ITERATIONS = 40  # each reduces the error by a factor of the step


def statements() -> list[Statement]:
    """Return the measured statements of section 2."""
    return [_poisson_flow(), _orthogonal_flow(), _remark_2_1()]


def _poisson_flow() -> Statement:
    defects, printed, bounds = [], [], []
    for system, start in ((paper_rigid_body(), CALM_START), (paper_a37(), SPIRAL_START)):
        flow, x = stepper(system, GaussLegendre(STAGES), TIME), np.array(start)
        defect, P = poisson_defect(flow, x), flow.tangent(x)
        defects.append(defect.defect)
        bounds.append(defect.bound)
        printed.append(float(np.linalg.norm(P.T @ system.structure_matrix(x) @ P - system.structure_matrix(flow(x)))))
    return judge(
        "flow_poisson",
        "section 2 (i)",
        "the exact flow keeps the Poisson bracket",
        paper="(phi')^T J(x) phi' = J(phi(x))",
        criterion="defect below 64 u operations |P|^2 |J|; so(3) and A3,7, exact tangent P, t = 0.1",
        measured=f"phi' J phi'^T - J(phi): {max(defects):.1e} (bound {min(bounds):.1e}); "
        f"with the printed transpose: {max(printed):.2g}, so that is a misprint",
        holds=all(defect <= bound for defect, bound in zip(defects, bounds, strict=True)),
        limited=any(defect > bound for defect, bound in zip(printed, bounds, strict=True)),
    )


def _flow_matrix() -> tuple[np.ndarray, np.ndarray, float]:
    body, x = paper_rigid_body(), np.array(CALM_START)
    stages = stage_iterates(body, STAGES, TIME, x, CONVERGED_ITERATIONS)[-1]
    B = step_matrix(body, stages, TIME, "structure")
    return B, body.hamiltonian.hessian(x), float(np.linalg.norm(B @ x - body.exact(x, TIME)))


def _bound(B: np.ndarray) -> float:
    # Elimination of 8 x 3 unknowns, then three products.
    return 64 * UNIT_ROUNDOFF * 3 * STAGES * float(np.linalg.norm(B) ** 2)


def _orthogonal_flow() -> Statement:
    B, M, error = _flow_matrix()
    defect = float(np.linalg.norm(B.T @ M @ B - M))
    return judge(
        "flow_m_orthogonal",
        "section 2 (ii)",
        "the exact flow is phi_t(x) = B_t(x) x with an M-orthogonal B_t",
        paper="B_t^T M B_t = M, hence T(phi_t) = T",
        criterion=f"below {_bound(B):.0e} = 64 u (24 unknowns) |B|^2; rigid body, t = 0.1",
        measured=f"|B^T M B - M| = {defect:.1e}; |B x - exact| = {error:.1e}",
        holds=defect <= _bound(B) and error <= _bound(B),
    )


def _remark_2_1() -> Statement:
    B, M, _ = _flow_matrix()
    root = np.diag(np.sqrt(np.diag(M)))
    turned = root @ B @ np.linalg.inv(root)
    defect, determinant = float(np.linalg.norm(turned.T @ turned - np.eye(3))), float(np.linalg.det(turned))
    return judge(
        "remark_2_1",
        "remark 2.1",
        "M^(1/2) x moves by rotations",
        paper="in the coordinates M^(1/2) x the flow has a matrix in SO(n)",
        criterion=f"below {3 * _bound(B):.0e} = 3 x 64 u (24 unknowns) |B|^2, 3 = |M| |M^-1|",
        measured=f"|R^T R - 1| = {defect:.1e}, det R - 1 = {determinant - 1:.1e}",
        holds=defect <= 3 * _bound(B) and abs(determinant - 1.0) <= 3 * _bound(B),
    )
