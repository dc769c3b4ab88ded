"""Choice for an accuracy: it is reached without waste by a cheap scheme, or refused with an attainable value."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from digests.explicit_systems import many_digits, written_out
from random_runs.algebras import some_algebra
from refusals import refused

pytestmark = pytest.mark.thinned(3)

ACCURACIES = (1e-3, 1e-6, 1e-9, 1e-12)
SPLITTINGS = tuple(co.Splitting(order=p) for p in (2, 4, 6, 8, 10))
# The error is aimed at a third of the accuracy or more, at its largest in the last eighth or half of the run; at the
# end it may be a tenth of that, where the motion is slow, and another tenth is left to steps that follow from an order
# not yet reached.
WASTE = 300.0
# A few roundings of a state and of its reference.
ROUNDING = 32 * 2.0**-53


@cache
def reference(name: str, member: int) -> tuple[np.ndarray, float]:
    case = written_out()[name]
    return many_digits(case.field, case.starts[member], case.time)


def is_wasteful(error: float, choice: co.Choice, span: float) -> bool:
    """Return whether far fewer steps would have sufficed, and rounding does not explain the small error."""
    count = round(abs(span) / choice.step)
    coarser = error * (count / (count - 1)) ** choice.method.order if count > 1 else math.inf
    explained = error <= max(ROUNDING, choice.roundoff)
    far_below = error < choice.accuracy / max(WASTE, 2.0**choice.method.order)
    return far_below and coarser < choice.accuracy / 3 and not explained


@pytest.mark.thinned(24)
@pytest.mark.parametrize("accuracy", ACCURACIES)
@pytest.mark.parametrize("name", written_out())
def test_accuracy_is_reached_without_waste(name, accuracy):
    case = written_out()[name]
    for member, x0 in enumerate(case.starts):
        exact, largest = reference(name, member)
        choice = co.choose(case.system, x0, (0, case.time), accuracy)
        run = co.integrate(case.system, x0, (0, case.time), choice.step, choice.method, watch=False)
        error = np.linalg.norm(run.x[-1] - exact) / largest
        assert error <= accuracy, str(choice)
        assert not is_wasteful(error, choice, case.time), f"{error:.1e} by {choice}"


@pytest.mark.thinned(8)
@pytest.mark.parametrize("accuracy", (1e-3, 1e-6, 1e-9))
@pytest.mark.parametrize("methods", (None, SPLITTINGS), ids=("any", "splittings"))
@pytest.mark.parametrize("x0", ((1.0, 0.2, 0.5), (0.05, 1.0, 0.02), (0.3, -0.4, 1.5)))
def test_accuracy_far_beyond_the_pilot_window(x0, methods, accuracy):
    """Thousands of turns, of which the pilot computes hundreds; waste is seen in the largest error of the last half."""
    body, span = co.systems.rigid_body(inertia=(1, 2, 3)), (0.0, 20000.0)
    choice = co.choose(body, x0, span, accuracy, methods=methods)
    run = co.integrate(body, x0, span, choice.step, choice.method, watch=False, save_every=16)
    late = run.t >= span[1] / 2.0
    errors = np.linalg.norm(run.x[late] - body.exact(x0, run.t[late]), axis=1) / np.linalg.norm(x0)
    assert errors[-1] <= accuracy, str(choice)
    assert not is_wasteful(errors.max(), choice, span[1]), f"{errors.max():.1e} by {choice}"


def test_accuracy_near_a_separatrix_is_refused():
    """The period depends on the logarithm of an energy gap of 1e-16, a rounding of the energy itself."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    with refused(ValueError, "accuracy"):
        co.choose(body, (1e-8, 1.0, 0.0), (0, 200), 1e-6)


DRIVEN = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Separable(
        dict.fromkeys((0, 1), (lambda y, t: 0.5 * y * y + math.sin(3.0 * t) * y, lambda y, t: y + math.sin(3.0 * t)))
    ),
)
CURVED = co.PoissonSystem(
    lambda x: np.array([[0.0, x[2] * x[2], -x[1]], [-x[2] * x[2], 0.0, x[0]], [x[1], -x[0], 0.0]]),
    co.Quadratic([1.0, 2.0, 3.0]),
    name="curved",
)
COUPLED = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Hamiltonian(
        lambda x: 0.5 * (x[0] ** 2 + x[1] ** 2 * x[2] ** 2) + math.cos(x[2]),
        lambda x: np.array([x[0], x[1] * x[2] ** 2, x[1] ** 2 * x[2] - math.sin(x[2])]),
    ),
)
HEISENBERG = co.LiePoissonSystem(co.algebras.heisenberg(1), co.Quadratic([1.0, 0.5, 0.25]))
EXPANDING = co.LiePoissonSystem(co.LieAlgebra.from_brackets(2, {(0, 1): {0: 1.0}}), co.Quadratic([1.0, 0.25]))
ODD = {
    "driven": (DRIVEN, (1.0, 0.2, 0.5), (1.0, 21.0)),
    "driven, backward": (DRIVEN, (1.0, 0.2, 0.5), (1.0, -14.0)),
    "nonlinear J": (CURVED, (1.0, 0.2, 0.5), (0.0, 15.0)),
    "does not split": (COUPLED, (1.0, 0.2, 0.5), (0.0, 15.0)),
    "nilpotent": (HEISENBERG, (0.5, 1.0, 0.7), (0.0, 30.0)),
    "solvable": (EXPANDING, (0.5, 0.9), (0.0, 8.0)),
    "solvable, backward": (EXPANDING, (0.5, 0.9), (0.0, -8.0)),
}


@pytest.mark.thinned(7)
@pytest.mark.parametrize("accuracy", (1e-4, 1e-9))
@pytest.mark.parametrize("name", ODD)
def test_accuracy_is_reached_on_every_kind_of_system(name, accuracy):
    """Against DOP853, which keeps its error per step below 1e-13."""
    system, x0, span = ODD[name]
    found = solve_ivp(lambda t, x: system.vector_field(x, t), span, x0, method="DOP853", rtol=1e-13, atol=1e-15)
    largest = np.max(np.linalg.norm(found.y, axis=0))
    run = co.integrate(system, x0, span, accuracy=accuracy, watch=False)
    assert np.linalg.norm(run.x[-1] - found.y[:, -1]) <= (accuracy + 1e-13 * len(found.t)) * largest


@pytest.mark.parametrize("accuracy", (1e-2, 1e-5, 1e-9))
@pytest.mark.parametrize("name", ("so(3)", "e(3)", "spin ring"))
def test_schemes_left_out_are_not_cheaper(name, accuracy):
    """Each scheme alone, with its cost at its own step, confirmed by its own error."""
    case = written_out()[name]
    x0, span = case.starts[0], (0, case.time)
    exact, largest = reference(name, 0)
    best = co.choose(case.system, x0, span, accuracy)
    for method in (*SPLITTINGS, *(co.GaussLegendre(s) for s in (2, 4, 6, 8, 12))):
        alone = co.choose(case.system, x0, span, accuracy, methods=method)
        run = co.integrate(case.system, x0, span, alone.step, method, watch=False)
        assert np.linalg.norm(run.x[-1] - exact) <= accuracy * largest
        # Alone it is confirmed, and its step corrected by a fraction; in company only where it wins.
        assert best.cost <= 1.25 * alone.cost, f"{alone} against {best}"


def dying_motion(seed, spans):
    """Return a random quadratic H on a random algebra; on some of them all motion dies out."""
    rng = np.random.default_rng(seed)
    algebra = some_algebra(rng)
    n = algebra.dim
    M = rng.standard_normal((n, n))
    M = M @ M.T / n + 0.3 * np.eye(n) if seed % 3 else np.diag(rng.uniform(0.3, 2.0, n))
    H = co.Quadratic(M)
    if seed % 3 == 2:
        H += co.Polynomial({tuple(rng.permutation([3] + [0] * (n - 1)).tolist()): 0.3}, dim=n)
    system = co.LiePoissonSystem(algebra, H, sign=int(rng.choice([-1, 1])))
    x0 = rng.standard_normal(n)
    speed = float(np.linalg.norm(system.vector_field(x0)) / np.linalg.norm(x0))
    return system, x0, float(rng.choice(spans)) / max(speed, 0.1) * int(rng.choice([-1, 1]))


SPANS, LONGER = (5, 50, 500), (3, 15, 100, 250, 1000, 3000)


@pytest.mark.thinned(8)
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6, 1e-10])
@pytest.mark.parametrize(
    ("seed", "spans"),
    [(324, SPANS), (395, SPANS), *((seed, LONGER) for seed in (585, 641, 656, 663))],
)
def test_steps_at_the_stability_limit_are_not_chosen(seed, spans, accuracy):
    """Where a motion dies out, a step slightly too long overflows, and a slightly shorter one ends in zero."""
    system, x0, span = dying_motion(seed, spans)
    run = co.integrate(system, x0, (0.0, span), accuracy=accuracy, watch=False)
    fine = co.integrate(system, x0, (0.0, span), run.step / 8, co.GaussLegendre(6), watch=False, save_every=8)
    largest = np.max(np.linalg.norm(fine.x, axis=1))
    assert np.linalg.norm(run.x[-1] - fine.x[-1]) <= (accuracy + 1e-11) * largest
