"""Sections 2 and 4 of Reich (1993): invariants of the exact motion, and explicit Lie-Poisson splitting."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.structure_defects import poisson_defect
from coadjoint.experiments.reich1993.statements import (
    CALM_START,
    COORDINATES,
    SLOPE_TOLERANCE,
    SPIRAL_START,
    Statement,
    body_trial,
    fitted_order,
    four_dimensional_body,
    four_dimensional_trial,
    judge,
    roundoff,
    stage_iterates,
    step_matrix,
    within,
)
from coadjoint.methods.composition import Composition
from coadjoint.methods.gauss_legendre import GaussLegendre, ModifiedGaussLegendre
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.stepper import stepper
from coadjoint.systems.examples.paper_examples import paper_a37, paper_rigid_body
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

TIME = 0.1  # one step of the example
STAGES = 8  # of order 16; a step of 0.1 is the exact motion to round-off
CONVERGED_ITERATIONS = 40  # each reduces the error by a factor of the step


def section2_statements() -> list[Statement]:
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


STEP = 0.1  # that of the figures of the paper
STEPS = 2000  # those of its figures 1 and 2


def _systems() -> dict[str, tuple[LiePoissonSystem, npt.NDArray[np.float64]]]:
    return {
        "so(3)": (paper_rigid_body(), np.array(CALM_START)),
        "A3,7": (paper_a37(), np.array(SPIRAL_START)),
        "so(4)": (four_dimensional_body(), np.array([0.9, -0.4, 0.7, 0.5, 1.1, -0.6])),
        "e(3)": (
            LiePoissonSystem(catalogue.e(3), Quadratic([1.0, 0.5, 0.4, 0.7, 1.1, 0.6])),
            np.array([0.5, 0.3, -0.6, 0.8, 0.2, 0.4]),
        ),
        "sl(2)": (LiePoissonSystem(catalogue.sl(2), Quadratic([1.0, 0.5, 0.7])), np.array([1.0, 0.3, 0.5])),
    }


def section4_statements() -> list[Statement]:
    """Return the measured statements of section 4."""
    return [
        _order(),
        _symmetric(),
        _poisson(),
        _example_flows(),
        _orthogonal_not_poisson(),
        _fourth_order(),
        _casimirs(),
    ]


def _order() -> Statement:
    slopes = {
        "so(3)": fitted_order(body_trial(), COORDINATES).order,
        "so(4)": fitted_order(four_dimensional_trial(), COORDINATES).order,
    }
    return judge(
        "lemma_4_1_order",
        "lemma 4.1",
        "order of the splitting X1(h/2) ... Xn(h) ... X1(h/2)",
        paper="second order",
        criterion=f"slopes within {SLOPE_TOLERANCE}, t = 2",
        measured=", ".join(f"{name}: {slope:.2f}" for name, slope in slopes.items()),
        holds=all(within(slope, 2) for slope in slopes.values()),
    )


def _symmetric() -> Statement:
    ratios = {}
    for name, (system, x) in _systems().items():
        forward = stepper(system, COORDINATES, STEP)(x)
        back = stepper(system, COORDINATES, -STEP)(forward)
        # Two steps of 2 n - 1 flows, each rounding every component a few times.
        bound = roundoff(2 * (2 * system.dim - 1), float(np.linalg.norm(forward)))
        ratios[name] = float(np.linalg.norm(back - x)) / bound
    return judge(
        "lemma_4_1_symmetric",
        "lemma 4.1",
        "the splitting is symmetric",
        paper="symmetric",
        criterion="a step there and back misses by at most 8 u (flows) |x|",
        measured="miss over bound, " + ", ".join(f"{name}: {ratio:.2g}" for name, ratio in ratios.items()),
        holds=max(ratios.values()) <= 1.0,
    )


def _poisson() -> Statement:
    defects = {name: poisson_defect(stepper(s, COORDINATES, STEP), x) for name, (s, x) in _systems().items()}
    return judge(
        "lemma_4_1_poisson",
        "lemma 4.1",
        "the splitting is a Poisson map",
        paper="Lie-Poisson",
        criterion="|P J(x) P^T - J(psi(x))| below 64 u operations |P|^2 |J|, exact tangent P",
        measured=", ".join(f"{name}: {value.defect:.0e} ({value.bound:.0e})" for name, value in defects.items()),
        holds=all(value.poisson for value in defects.values()),
    )


def _turn(axis: int, angle: float, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    j, k = (axis + 1) % 3, (axis + 2) % 3
    y = x.copy()
    y[j], y[k] = np.cos(angle) * x[j] - np.sin(angle) * x[k], np.sin(angle) * x[j] + np.cos(angle) * x[k]
    return y


def _example_flows() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    m = body.hamiltonian.gradient(np.ones(3))
    # The vector fields printed in example 4.1.
    printed = [
        m[0] * x[0] * np.array([0.0, -x[2], x[1]]),
        m[1] * x[1] * np.array([x[2], 0.0, -x[0]]),
        m[2] * x[2] * np.array([-x[1], x[0], 0.0]),
    ]
    field = float(np.linalg.norm(np.sum(printed, axis=0) - body.vector_field(x)))
    y = x
    for axis, share in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        y = _turn(axis, share * STEP * m[axis] * y[axis], y)
    difference = float(np.linalg.norm(stepper(body, COORDINATES, STEP)(x) - y))
    run = integrate(body, x, (0.0, STEPS * STEP), STEP, COORDINATES, save_every=STEPS)
    drift, bound = float(run.drift(relative=False)["|x|^2"]), roundoff(5 * STEPS, float(x @ x))
    small = roundoff(5, float(np.linalg.norm(x)))
    return judge(
        "example_4_1",
        "example 4.1",
        "on so(3) the splitting is five rotations, hence I-orthogonal",
        paper="X1 X2 X3 X2 X1 with the printed fields; B_h in SO(3)",
        criterion=f"step against the printed closed forms: 8 u (5 flows) |x| = {small:.0e}; |x|^2 over {STEPS} "
        f"steps: {bound:.0e}",
        measured=f"|sum X_i - J M x| = {field:.0e}, |step - rotations| = {difference:.0e}, max |d|x|^2| = {drift:.0e}",
        holds=field <= small and difference <= small and drift <= bound,
    )


def _orthogonal_not_poisson() -> Statement:
    body, x = paper_rigid_body(), np.array(CALM_START)
    method = ModifiedGaussLegendre(1, freeze="gradient")
    defect = poisson_defect(stepper(body, method, STEP), x)
    drift = float(integrate(body, x, (0.0, 100.0), STEP, method, save_every=1000).drift(relative=False)["|x|^2"])
    bound = roundoff(1000, float(x @ x))
    return judge(
        "orthogonal_not_poisson",
        "example 4.1",
        "I-orthogonality does not imply the Lie-Poisson structure",
        paper="does not imply",
        criterion=f"a scheme with |x|^2 kept to {bound:.0e} and a Poisson defect above its bound {defect.bound:.0e}",
        measured=f"modified midpoint rule, -J(M x) x: max |d|x|^2| = {drift:.0e}, Poisson defect {defect.defect:.1e}",
        holds=drift <= bound and not defect.poisson,
    )


def _fourth_order() -> Statement:
    c1 = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    c2 = 1.0 - 2.0 * c1
    method = Composition(COORDINATES, (c1, c2, c1))
    counts = (16, 32, 64, 128, 256)
    slopes = {
        "so(3)": fitted_order(body_trial(), method, counts).order,
        "so(4)": fitted_order(four_dimensional_trial(), method, counts).order,
    }
    condition = abs(2 * c1**3 + c2**3)
    defect = poisson_defect(stepper(paper_a37(), method, STEP), np.array(SPIRAL_START))
    return judge(
        "fourth_order",
        "section 4",
        "composition with 2 c1 + c2 = 1, 2 c1^3 + c2^3 = 0",
        paper="of fourth order, Lie-Poisson",
        criterion=f"slopes within {SLOPE_TOLERANCE}, t = 2; Poisson defect on A3,7 below {defect.bound:.0e}",
        measured=", ".join(f"{name}: {slope:.2f}" for name, slope in slopes.items())
        + f"; 2 c1^3 + c2^3 = {condition:.0e}; Poisson defect {defect.defect:.0e}",
        holds=all(within(slope, 4) for slope in slopes.values())
        and defect.poisson
        and condition <= 16 * UNIT_ROUNDOFF * c1**3,
    )


def _casimirs() -> Statement:
    worst = {}
    for name, (system, x) in _systems().items():
        # On A3,7 the motion has decayed by t = 20.
        step = 0.01 if name == "A3,7" else STEP
        run = integrate(system, x, (0.0, STEPS * step), step, COORDINATES)
        bound = {
            casimir: roundoff((2 * system.dim - 1) * STEPS, _size(system.casimirs[casimir], run.x))
            for casimir in run.casimirs
        }
        drift = run.drift(relative=False)
        worst[name] = max(float(drift[casimir]) / bound[casimir] for casimir in bound)
    return judge(
        "lemma_4_2",
        "lemma 4.2",
        "the splitting keeps every Casimir",
        paper="any Casimir function is preserved",
        criterion=f"drift over {STEPS} steps at most 8 u (flows) (sum of the absolute monomials)",
        measured="largest drift over bound, " + ", ".join(f"{name}: {ratio:.1g}" for name, ratio in worst.items()),
        holds=max(worst.values()) <= 1.0,
    )


def _size(casimir: object, x: npt.NDArray[np.float64]) -> float:
    """Return the size of the terms of a Casimir along a run; 1 for a logarithm, whose error is relative."""
    if not isinstance(casimir, Polynomial):
        return 1.0
    largest = np.max(np.abs(x), axis=0)
    return sum(abs(float(c)) * float(np.prod(largest ** np.array(e))) for e, c in casimir.monomials.items())
