"""Orders from slopes, and tangents that are Poisson maps or not."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

STEPS = 0.4 / 2.0 ** np.arange(8)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_exact_power_has_its_exponent(order):
    fit = co.analysis.fit_order(STEPS, 3.0 * STEPS**order)
    # Logarithms are rounded to u times their size, at most 40; the least squares of 8 points lose a few bits.
    assert fit.order == pytest.approx(order, abs=64 * 2.0**-53 * 40)
    assert fit.dropped == 0


def test_next_term_moves_the_slope_by_its_share():
    fit = co.analysis.fit_order(STEPS[3:], STEPS[3:] ** 2 * (1.0 + STEPS[3:]))
    # The local slope is 2 + h / (1 + h), between 2 and 2 + the largest step.
    assert 2.0 < fit.order < 2.0 + STEPS[3]


def test_plateau_is_dropped_without_a_stated_floor():
    noise = np.array([1.0, 1.3, 0.8, 1.1])
    errors = np.concatenate([STEPS[:4] ** 4, 1e-4 * noise])
    fit = co.analysis.fit_order(STEPS, errors)
    assert fit.order == pytest.approx(4.0, abs=0.4)
    assert 3 <= len(fit.steps) <= 5
    without = float(np.polyfit(np.log(STEPS), np.log(errors), 1)[0])
    assert abs(without - 4.0) > 1.0


@pytest.mark.parametrize("seed", range(4))
def test_each_point_keeps_its_own_floor_in_any_order_and_unit(seed):
    rng = np.random.default_rng(seed)
    steps = 0.5 * np.cumprod(rng.uniform(0.5, 0.8, 9))
    errors = steps**3 * rng.uniform(0.95, 1.05, 9)
    floor = np.where(np.arange(9) == 6, errors, 0.1 * errors)  # the seventh is at its floor, and no other one
    fit = co.analysis.fit_order(steps, errors, floor)
    assert fit.order == pytest.approx(np.polyfit(np.log(steps[:6]), np.log(errors[:6]), 1)[0], rel=1e-12)
    assert fit.dropped == 3 and np.array_equal(fit.steps, steps[:6]) and np.array_equal(fit.errors, errors[:6])
    mixed = rng.permutation(9)
    again = co.analysis.fit_order(1e3 * steps[mixed], 1e-5 * errors[mixed], 1e-5 * floor[mixed])
    assert again.order == pytest.approx(fit.order, rel=1e-12) and again.dropped == 3
    assert again.steps == pytest.approx(1e3 * fit.steps) and again.errors == pytest.approx(1e-5 * fit.errors)


@pytest.mark.parametrize("ratio", [1.1, 2.0, 9.0])
def test_a_plateau_is_what_falls_more_slowly_than_the_root_of_the_step(ratio):
    steps = ratio ** -np.arange(6.0)
    assert co.analysis.fit_order(steps, steps**0.51).dropped == 0
    with refused(ValueError, "only 1 of 6"):
        co.analysis.fit_order(steps, steps**0.49)


@pytest.mark.parametrize(
    ("steps", "errors", "floor", "named"),
    [
        (STEPS, np.maximum(STEPS**6, 1e-5), 1e-5, "2 of 8"),
        (STEPS[:2], STEPS[:2], None, "needs 3"),
        (STEPS[:3], np.zeros(3), None, "0 of 3"),
        (STEPS, STEPS, [1e-9] * 7, "floor"),
        ([0.1, 0.2], [1.0], None, "shapes"),
        ([0.1, 0.1, 0.2], [1.0, 1.0, 1.0], None, "distinct"),
        ([0.1, -0.1, 0.2], [1.0, 1.0, 1.0], None, "positive"),
        ([0.1, 0.2, 0.4], [1.0, np.nan, 1.0], None, "finite"),
        ([0.1, 0.2, 0.4], [1.0, -1.0, 1.0], None, "negative"),
    ],
)
def test_wrong_input_is_refused(steps, errors, floor, named):
    with refused(ValueError, named):
        co.analysis.fit_order(steps, errors, *([] if floor is None else [floor]))


@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(3)", "so(4)", "A3,7"])
def test_coadjoint_action_is_poisson_and_its_transpose_not(name: str):
    """exp(D_u) is linear, and Poisson on every dual of a Lie algebra."""
    algebra = co.algebras.get(name, **({"a": 2.0} if name == "A3,7" else {}))
    u, x = np.random.default_rng(3).normal(size=(2, algebra.dim))
    P = expm(algebra.coadjoint(0.5 * u))
    J = algebra.structure_matrix
    found = co.analysis.defect_of_tangent(P, J(x), J(P @ x), operations=20 * algebra.dim)
    assert found.poisson and found.bound < 1e-10
    assert not co.analysis.defect_of_tangent(P.T, J(x), J(P @ x), operations=20 * algebra.dim).poisson


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
    for wrong, named in ((np.ones((2, 3)), "one state"), (np.ones(2), "shape")):
        with refused(ValueError, named):
            co.analysis.poisson_defect(step, wrong)
    for matrices in ([np.ones((2, 3))] * 3, [np.eye(2), np.eye(2), np.eye(3)]):
        with refused(ValueError, "(n, n)"):
            co.analysis.defect_of_tangent(*matrices, operations=1)


@pytest.mark.parametrize(("share", "poisson"), [(0.5, True), (2.0, False)])
def test_the_bound_of_a_defect_at_its_threshold(share, poisson):
    """64 u for each operation, times |P|^2 |J|; here |P|^2 is 2."""
    J, off = np.array([[0.0, 1.0], [-1.0, 0.0]]), share * 64 * 2.0**-53 * 10 * 2
    assert co.analysis.defect_of_tangent(np.eye(2), J, (1.0 + off) * J, operations=10).poisson is poisson
