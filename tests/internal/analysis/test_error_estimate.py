"""Estimated errors: how near they are, whose they are, and when there is none."""

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


@pytest.mark.thinned(4)
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


def test_a_perfect_drift_does_not_hide_the_error():
    sol = co.integrate(BODY, (0.3, 1.0, 0.2), (0, 100), 2.0, co.Taylor(order=4))
    error = np.linalg.norm(sol.x[-1] - BODY.exact((0.3, 1.0, 0.2), 100.0)) / np.linalg.norm((0.3, 1.0, 0.2))
    assert sol.drift()["energy"] < 1e-14 and error > 5e-3
    assert error / 10 < sol.error_estimate() < 10 * error


def test_of_batches_by_their_own_systems():
    bodies = [co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (1.5, 2.0, 2.5)]
    sol = co.integrate(co.batch(bodies), X0, (0, 20), 0.1)
    errors = [np.linalg.norm(sol.x[-1, m] - body.exact(X0, 20.0)) / np.linalg.norm(X0) for m, body in enumerate(bodies)]
    assert sol.error_estimate() == pytest.approx(errors, rel=0.1)


def test_of_matrices_and_forces():
    fluid = co.systems.sphere_euler(N=5)
    numbers = np.random.default_rng(1).normal(size=fluid.dim)
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    for system, x0, step in ((damped, np.array(X0), 0.1), (fluid, fluid.matrices(numbers), 0.05)):
        sol = co.integrate(system, x0, (0, 5), step, save_every=10)
        better = co.integrate(system, x0, (0, 5), step / 16, save_every=160)
        size = np.max(np.linalg.norm(better.x.reshape(len(better.t), -1), axis=1))
        error = np.linalg.norm(sol.x[-1] - better.x[-1]) / size
        assert sol.error_estimate() == pytest.approx(error, rel=0.1)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("span", [(0.0, 60.0), (2.0, -58.0)])
@pytest.mark.parametrize("method", [None, co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(2)])
@pytest.mark.parametrize("accuracy", [1e-2, 1e-5])
def test_truncation_is_told_to_a_few_percent(accuracy, method, span):
    """The error of the finer run is known by the order, of which the next term is a fraction of the error."""
    sol = co.integrate(BODY, X0, span, accuracy=accuracy, method=method, save_every=7)
    error = np.linalg.norm(sol.x[-1] - BODY.exact(X0, span[1] - span[0])) / np.linalg.norm(X0)
    assert sol.error_estimate() == pytest.approx(error, rel=0.1)
    assert sol.error_estimate() <= accuracy and 0.25 * error < sol.choice.error < 4.0 * error


@pytest.mark.parametrize("time", [20.0, -20.0])
def test_relative_to_the_largest_momentum_on_the_way(time):
    """x2 = exp(-t): of what dies the error is told in parts of the start, of what grows in parts of the end."""
    dying = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), co.Quadratic([0.0, 0.0], linear=[1.0, 0.0]), sign=1
    )
    assert dying.vector_field((0.0, 1.0))[1] == -1.0
    sol = co.integrate(dying, (0.0, 1.0), (0, time), accuracy=1e-6, method=co.GaussLegendre(2))
    error = abs(sol.x[-1, 1] - np.exp(-time)) / max(1.0, np.exp(-time))
    assert sol.error_estimate() == pytest.approx(max(error, UNIT_ROUNDOFF), rel=0.1)
    assert np.ptp(sol.x) > 0.99


def test_of_driven_systems_at_their_own_times():
    spin = co.systems.spin_lattice("chain", 1, field=lambda t: (0.9 * np.cos(2.0 * t), 0.9 * np.sin(2.0 * t), -1.0))
    span = (4.0, -2.0)
    driven = co.integrate(spin, (0.6, 0.0, 0.8), span, accuracy=1e-5, method=co.Splitting(order=2), save_every=9)
    better = co.integrate(spin, (0.6, 0.0, 0.8), span, 6.0 / 1024, co.GaussLegendre(4), save_every=64)
    assert driven.error_estimate() == pytest.approx(np.linalg.norm(driven.x[-1] - better.x[-1]), rel=0.1)


def test_of_members_by_their_own_sizes_in_any_order():
    states = np.array([[1.0, 0.2, 0.5], [0.002, 0.001, 0.003], [2.0, 1.0, -1.5], [0.3, -0.2, 0.6]])[::-1]
    sol = co.integrate(BODY, states, (4.0, 14.0), accuracy=1e-4, method=co.Splitting(order=2))
    exact = np.array([BODY.exact(x, 10.0) for x in states])
    errors = np.linalg.norm(sol.x[-1] - exact, axis=1) / np.linalg.norm(states, axis=1)
    assert errors.max() > 1e3 * errors.min()
    assert sol.error_estimate() == pytest.approx(errors, rel=0.1)


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


def test_the_worst_group_counts():
    """Molecules that collide are far larger in position and momentum than in attitude, which is lost."""
    pair, run = co.systems.rigid_molecules(count=2), ((0, 0.4), 0.002, co.Splitting(2))
    x0 = pair.state([[0, 0, 0], [0.6, 0.02, 0.01]], [[2.5, 0, 0], [-2.5, 0, 0]])
    sol, fine = co.integrate(pair, x0, *run), co.integrate(pair, x0, run[0], 1e-4, co.Splitting(4), save_every=20)
    rotations = np.linalg.norm((sol.x[-1] - fine.x[-1])[:24].reshape(-1, 3), axis=1)
    sizes = np.linalg.norm(fine.x[:, :24].reshape(len(fine.t), -1, 3), axis=2).max(axis=0)
    assert sol.error_estimate() == pytest.approx((rotations / sizes).max(), rel=0.2)


@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e20])
def test_coordinates_that_are_zero_but_for_rounding_do_not_count(unit):
    """Of an orbit in a plane to which a third coordinate of 1e-17 is normal."""
    pair = co.systems.gravitating_bodies([np.zeros(3)] * 2, (unit, 1e-3 * unit), 1.0 / unit)
    run = (0, 5), 0.01, co.Splitting(order=4)
    flat, tilted = (
        co.integrate(pair, pair.state([[0, 0, 0], [1.1, 0, z]], velocities=[[0, 0, 0], [0, 0.9, -z]]), *run)
        for z in (0.0, 1e-17)
    )
    assert tilted.error_estimate() == pytest.approx(flat.error_estimate(), rel=0.01)
    assert flat.error_estimate() < 1e-5
