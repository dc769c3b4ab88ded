"""Estimated errors: how near they are over explicit systems and every scheme, with samples, and at rest."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.systems.coordinates import CoordinateGroups
from digests.explicit_systems import LONG, many_digits, written_out
from digests.schemes_under_test import EXAMPLES, schemes, serves
from digests.systems_under_test import matrices
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(1)

ACCURACIES = (1e-3, 1e-6, 1e-9, 1e-12)
FACTOR = 10.0


def sizes_of_groups(system: object, x0: np.ndarray, time: float) -> np.ndarray:
    """Return the largest norms of the groups of coordinates in a motion."""
    path = np.asarray(co.integrate(system, x0, (0.0, time), abs(time) / 1000).x)
    return CoordinateGroups(system).sizes(path.reshape(len(path), -1))


def largest_error(system: object, errors: np.ndarray, sizes: np.ndarray) -> float:
    """Return the error of the worst group, relative to its size."""
    return float(CoordinateGroups(system).ratios(np.asarray(errors, dtype=float).ravel(), sizes))


def check_estimate(sol: co.Solution, exact: np.ndarray) -> None:
    """Compare an estimate with the error; both may lie below the expected rounding."""
    sizes = sizes_of_groups(sol.system, sol.x0, sol.t_span[1])
    error, estimate = largest_error(sol.system, sol.x[-1] - exact, sizes), sol.error_estimate()
    assert error / FACTOR <= estimate <= FACTOR * max(error, sol.choice.roundoff), (
        f"{estimate:.1e} for {error:.1e}: {sol.choice}"
    )


@pytest.mark.thinned(18)
@pytest.mark.parametrize("methods", [None, co.Splitting(order=6), co.GaussLegendre(3)], ids=str)
@pytest.mark.parametrize("name", written_out())
def test_estimate_on_explicit_systems(name, methods):
    case = written_out()[name]
    for x0 in case.starts:
        exact, _ = many_digits(case.field, x0, case.time)
        for accuracy in ACCURACIES[: 3 if methods else 4]:
            check_estimate(co.integrate(case.system, x0, (0, case.time), accuracy=accuracy, method=methods), exact)


# With representations that the algebra has itself, unimodular and not; none is symmetric under an exchange of axes.


@pytest.mark.thinned(3)
@pytest.mark.parametrize("time", [30.0, -12.0])
@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_estimate_on_growing_and_decaying_motions(rate, time):
    """x1' = -rate x1 beside a turn of x2 and x3 that x1 drives, by 13 orders of magnitude up or down."""
    brackets = {(0, 1): {1: rate, 2: 1.0}, (0, 2): {2: rate, 1: -1.0}}
    system = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(3, brackets), co.Quadratic([0.5, 0.1, 0.0], linear=[1.0, 0.0, 0.0])
    )
    x0 = np.array([0.1, 1e-3, 2e-3])

    def field(x):
        first, second, speed = rate * x[1] + x[2], rate * x[2] - x[1], 1 + LONG(0.5) * x[0]
        return np.array([LONG(0.1) * x[1] * first, -speed * first, -speed * second])

    exact, _ = many_digits(field, x0, time)
    for accuracy in (1e-3, 1e-6, 1e-9):
        check_estimate(co.integrate(system, x0, (0, time), accuracy=accuracy), exact)
    # A splitting takes a single step here, of which the error does not follow the order.
    check_estimate(co.integrate(system, x0, (0, time), accuracy=1e-2, method="Splitting"), exact)


SPLITTING, GAUSS = co.Splitting(order=2), co.GaussLegendre
STEPS = {1: 384, 2: 192, 3: 96, 4: 64}  # of constant steps, by their order; so many that the error follows the order
MORE_STEPS = 32
ABOVE_ROUNDING = 1e-12  # error below which a run is not counted


@cache
def schemes_of_own_steps() -> dict[str, co.methods.Method]:
    """Return the schemes that choose their steps: the examples and candidates, and others of more orders."""
    found = [each for each in EXAMPLES if each.own_steps]
    bases = [(SPLITTING, 0.05), (GAUSS(1), 0.1), (co.Splitting(order=4), 0.1), (co.Kahan(), 0.1), (GAUSS(3), 0.4)]
    found += [co.ReversibleSteps(base, stride) for base, stride in bases]
    found += [co.Taylor(order, tolerance=size) for order in (6, 12) for size in (1e-3, 1e-6, 1e-8)]
    return {str(each): each for each in found}


@cache
def references() -> list[tuple[object, np.ndarray, float, np.ndarray, np.ndarray]]:
    """Return systems with a state, a time of either sign, the state then, and the sizes of groups on the way."""
    found = []
    for k, case in enumerate(written_out().values()):
        time = (-1) ** k * min(3.0, 0.25 * case.time)
        for x0 in case.starts[:2]:
            exact, _ = many_digits(case.field, x0, time)
            found.append((case.system, x0, time, exact, sizes_of_groups(case.system, x0, time)))
    for case in matrices().values():
        field = case.system.vector_field
        run = solve_ivp(lambda t, x, f=field: f(x), (0, case.time), case.x0, "DOP853", rtol=1e-13, atol=1e-14)
        found.append((case.system, case.x0, case.time, run.y[:, -1], sizes_of_groups(case.system, case.x0, case.time)))
    return found


def ratios_of_estimates(method: co.methods.Method) -> np.ndarray:
    """Return the estimated error over the error of each run above rounding, on every system that the scheme serves."""
    found = []
    for system, x0, time, exact, sizes in references():
        if not serves(method, system):
            continue
        step = abs(time) if method.own_steps else abs(time) / STEPS.get(method.order, MORE_STEPS)
        sol = co.integrate(system, x0, (0.0, time), step, method, watch=False)
        error = largest_error(system, sol.x[-1] - exact, sizes)
        if error > ABOVE_ROUNDING:
            found.append(sol.error_estimate() / error)
    assert found, method
    return np.array(found)


def band_of_estimates(method: co.methods.Method) -> float:
    """Return half of the relative change of an estimate by twice the power of the step, and at least one percent.

    The finer run has the fraction r of the error, and 1 / (1 - r) is corrected to 1 / (1 - r^2).
    """
    if isinstance(method, co.Taylor) and method.own_steps:
        return 0.1  # the error is proportional to the tolerance up to the choice of each step
    steps = STEPS.get(method.order, MORE_STEPS)
    ratio = 1.0 / 1.5 if method.own_steps else steps / math.ceil(1.5 * (steps + 20))
    remaining = ratio**method.order
    return max(0.01, 0.5 * remaining / (1.0 + remaining))


def check_estimates(method: co.methods.Method) -> None:
    ratios = ratios_of_estimates(method)
    assert np.median(ratios) == pytest.approx(1.0, rel=band_of_estimates(method)), ratios
    assert 1.0 / FACTOR < ratios.min() and ratios.max() < FACTOR, ratios  # a single error may be small by chance


@pytest.mark.thinned(16)
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("name", schemes())
def test_estimate_follows_the_order_of_every_scheme(name):
    """Neither too small nor too large: a correction by another power of the step is outside of the band."""
    check_estimates(schemes()[name])


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", schemes_of_own_steps())
def test_estimate_follows_the_order_of_schemes_with_their_own_steps(name):
    check_estimates(schemes_of_own_steps()[name])


BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (1.0, 0.2, 0.5)


def test_round_off_is_said_and_not_zero():
    """At rest, and where every step is exact, at least the rounding of a state is left."""
    for x0 in ((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)):
        assert co.integrate(BODY, x0, (0, 40), accuracy=1e-6).error_estimate() == UNIT_ROUNDOFF
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.0, 0.0, 0.0], linear=[0.0, 0.0, 1.0]))
    assert UNIT_ROUNDOFF <= co.integrate(spinning, X0, (0, 40), accuracy=1e-9).error_estimate() < 1e-13
    assert co.integrate(BODY, X0, (3, 3), accuracy=1e-6).error_estimate() == 0.0


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", [None, GAUSS(2)], ids=str)
@pytest.mark.parametrize("end", ["end", "t_eval", "event"])
@pytest.mark.parametrize("count", [1, 80])
def test_estimate_with_samples(count, end, method):
    """Other steps must divide the period too; against 16 times finer ones, also where a run ends between steps."""
    law = co.forces.Sampled(co.forces.Pointing(0.5, 2.4), period=0.5)
    body = co.systems.body((4.0, 5.5, 7.2)).with_forces(co.forces.Torque((0.012, -0.02, 0.009)), law)
    x0, h = body.state([0.48, -0.36, 0.0, 0.8], angular_velocity=(0.1, 0.2, -0.1)), 0.25
    span = (3.0, 3.0 + count * h)
    given = {"end": {}, "t_eval": {"t_eval": [3.0, 3.0 + 0.61 * count * h]}}
    given["event"] = {"events": co.Event(lambda x, t: x[0] - 0.3, terminal=True)}
    sol = co.integrate(body, x0, span, h, method, **given[end])
    exact = co.integrate(body, x0, span, h / 16, method, t_eval=[sol.t[-1]]).x[-1]
    vectors = np.linalg.norm(sol.x.reshape(len(sol.t), -1, 3), axis=2).max(axis=0)
    error = (np.linalg.norm((sol.x[-1] - exact).reshape(-1, 3), axis=1) / vectors)[:4].max()
    assert error / 2 <= sol.error_estimate() <= 2 * error
    assert np.all(co.integrate(body, np.array([x0, x0]), span, h, method).error_estimate() > 0.0)
