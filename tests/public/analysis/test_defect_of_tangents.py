"""Poisson maps are recognised, and others are not."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from refusals import refused


def _coadjoint_map(algebra: co.LieAlgebra, u: np.ndarray) -> np.ndarray:
    """exp(D_u): linear, and Poisson on every dual of a Lie algebra."""
    return expm(algebra.coadjoint(u))


@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(3)", "so(4)"])
def test_coadjoint_action_is_poisson(name: str):
    algebra = co.algebras.get(name)
    random = np.random.default_rng(3)
    u, x = random.normal(size=(2, algebra.dim))
    P = _coadjoint_map(algebra, 0.5 * u)
    found = co.analysis.defect_of_tangent(
        P, algebra.structure_matrix(x), algebra.structure_matrix(P @ x), operations=20 * algebra.dim
    )
    assert found.poisson
    assert found.bound < 1e-10


def test_transpose_on_the_other_side_is_another_condition():
    algebra = co.algebras.get("A3,7", a=2.0)
    x, u = np.array([1.0, 1.0, 1.0]), np.array([0.1, 0.2, 0.3])
    P = _coadjoint_map(algebra, u)
    before, after = algebra.structure_matrix(x), algebra.structure_matrix(P @ x)
    assert co.analysis.defect_of_tangent(P, before, after, operations=60).poisson
    assert not co.analysis.defect_of_tangent(P.T, before, after, operations=60).poisson


def test_defect_of_the_midpoint_rule_is_of_third_order_in_the_step():
    body, x = co.systems.paper_rigid_body(), (1.0, 2.0, 0.5)
    steps = [0.1 / 2**k for k in range(5)]
    defects = [co.analysis.poisson_defect(co.stepper(body, co.GaussLegendre(1), h), x).defect for h in steps]
    # A method of order 2 differs from the flow, which is Poisson, by h^3; the next terms are of relative size h.
    assert co.analysis.fit_order(steps, defects).order == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("h", [0.1, -0.07])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_defect_and_its_bound_are_those_of_their_definition(sign: int, h: float):
    system = co.LiePoissonSystem(co.algebras.get("A3,7", a=0.5), co.Quadratic([1.0, 2.0, 0.3]), sign=sign)
    x = np.array([3.0, -1.0, 2.0])
    step = co.stepper(system, co.GaussLegendre(1), h)
    P, J, after = step.tangent(x), system.structure_matrix(x), system.structure_matrix(step(x))
    entries = np.array([[P[i] @ J @ P[j] - after[i, j] for j in range(3)] for i in range(3)])
    for operations in (0, 1, 50):
        found = co.analysis.poisson_defect(step, x, operations)
        assert found.defect == pytest.approx(np.sqrt(np.sum(entries**2)), rel=1e-10)
        assert found.bound == pytest.approx(64 * 2.0**-53 * operations * np.sum(P**2) * np.sqrt(np.sum(J**2)))
    assert not found.poisson and co.analysis.poisson_defect(step, x).bound > found.bound * 3 * 4 / 50
    assert co.analysis.poisson_defect(co.stepper(system, co.Splitting(order=4), h), x).poisson
    for wrong, what in ((np.ones((2, 3)), "give one state"), (np.ones(2), "shape")):
        with pytest.raises(ValueError, match=what):
            co.analysis.poisson_defect(step, wrong)
    with refused(ValueError, "must all be (n, n)"):
        co.analysis.defect_of_tangent(np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3)), operations=1)
    with refused(ValueError, "must all be (n, n)"):
        co.analysis.defect_of_tangent(np.eye(2), np.eye(2), np.eye(3), operations=1)


@pytest.mark.parametrize(("share", "poisson"), [(0.5, True), (2.0, False)])
def test_the_bound_of_a_defect_at_its_threshold(share, poisson):
    """64 u for each operation, times |P|^2 |J|; here |P|^2 is 2."""
    J, off = np.array([[0.0, 1.0], [-1.0, 0.0]]), share * 64 * 2.0**-53 * 10 * 2
    assert co.analysis.defect_of_tangent(np.eye(2), J, (1.0 + off) * J, operations=10).poisson is poisson
