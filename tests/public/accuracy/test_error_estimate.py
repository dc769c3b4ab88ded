"""Estimated errors are within a factor of 10 or at the level of rounding, and those at a given step within percents."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from digests.explicit_systems import LONG, many_digits, written_out
from digests.schemes_under_test import schemes, serves
from digests.systems_under_test import matrices

pytestmark = pytest.mark.thinned(3)

ACCURACIES = (1e-3, 1e-6, 1e-9, 1e-12)
FACTOR = 10.0


def check_estimate(sol: co.Solution, exact: np.ndarray, largest: float) -> None:
    """Compare an estimate with the error; both may lie below the expected rounding."""
    error, estimate = np.linalg.norm(sol.x[-1] - exact) / largest, sol.error_estimate()
    assert error / FACTOR <= estimate <= FACTOR * max(error, sol.choice.roundoff), (
        f"{estimate:.1e} for {error:.1e}: {sol.choice}"
    )


@pytest.mark.thinned(18)
@pytest.mark.parametrize("methods", [None, co.Splitting(order=6), co.GaussLegendre(3)], ids=str)
@pytest.mark.parametrize("name", written_out())
def test_estimate_on_explicit_systems(name, methods):
    case = written_out()[name]
    for x0 in case.starts:
        exact, largest = many_digits(case.field, x0, case.time)
        for accuracy in ACCURACIES[: 3 if methods else 4]:
            check_estimate(
                co.integrate(case.system, x0, (0, case.time), accuracy=accuracy, method=methods), exact, largest
            )


def plain_field(system: co.LiePoissonSystem):
    """Return x' = sign J(x) grad H(x) in any number type, from the structure constants and a quadratic H."""
    n = system.dim
    M = [[LONG(float(v)) for v in row] for row in system.hamiltonian.hessian(np.zeros(n))]
    linear = [LONG(float(v)) for v in system.hamiltonian.gradient(np.zeros(n))]
    rows = [(int(i), int(j), int(k), LONG(float(c))) for i, j, k, c in zip(*system.algebra.triples, strict=True)]

    def field(x):
        u = [sum((m * v for m, v in zip(row, x, strict=True)), start=b) for row, b in zip(M, linear, strict=True)]
        out = [LONG(0.0)] * n
        for i, j, k, c in rows:
            out[i], out[j] = out[i] + c * x[k] * u[j], out[j] - c * x[k] * u[i]
        return system.sign * np.array(out)

    return field


# With representations that the algebra has itself, unimodular and not; none is symmetric under an exchange of axes.


@pytest.mark.parametrize("time", [30.0, -12.0])
@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_estimate_on_growing_and_decaying_motions(rate, time):
    """x1' = -rate x1 beside a turn of x2 and x3 that x1 drives, by 13 orders of magnitude up or down."""
    brackets = {(0, 1): {1: rate, 2: 1.0}, (0, 2): {2: rate, 1: -1.0}}
    system = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(3, brackets), co.Quadratic([0.5, 0.1, 0.0], linear=[1.0, 0.0, 0.0])
    )
    x0 = np.array([0.1, 1e-3, 2e-3])
    exact, largest = many_digits(plain_field(system), x0, time)
    for accuracy in (1e-3, 1e-6, 1e-9):
        check_estimate(co.integrate(system, x0, (0, time), accuracy=accuracy), exact, largest)
    # A splitting takes a single step here, of which the error does not follow the order.
    check_estimate(co.integrate(system, x0, (0, time), accuracy=1e-2, method="Splitting"), exact, largest)


SPLITTING, GAUSS = co.Splitting(order=2), co.GaussLegendre
STEPS = {1: 384, 2: 192, 3: 96, 4: 64}  # of constant steps, by their order; so many that the error follows the order
MORE_STEPS = 32
ABOVE_ROUNDING = 1e-12  # error below which a run is not counted


@cache
def schemes_of_own_steps() -> dict[str, co.methods.Method]:
    """Return the schemes that choose their steps: the examples and candidates, and others of more orders."""
    found = [each for name in co.methods.names() for each in getattr(co, name).examples() if each.own_steps]
    bases = [(SPLITTING, 0.05), (GAUSS(1), 0.1), (co.Splitting(order=4), 0.1), (co.Kahan(), 0.1), (GAUSS(3), 0.4)]
    found += [co.ReversibleSteps(base, stride) for base, stride in bases]
    found += [co.Taylor(order, tolerance=size) for order in (6, 12) for size in (1e-3, 1e-6, 1e-8)]
    return {str(each): each for each in found}


@cache
def references() -> list[tuple[object, np.ndarray, float, np.ndarray, float]]:
    """Return systems with a state, a time of either sign, the state then, and the largest momentum on the way."""
    found = []
    for k, case in enumerate(written_out().values()):
        time = (-1) ** k * min(3.0, 0.25 * case.time)
        found += [(case.system, x0, time, *many_digits(case.field, x0, time)) for x0 in case.starts[:2]]
    for case in matrices().values():
        field = case.system.vector_field
        run = solve_ivp(lambda t, x, f=field: f(x), (0, case.time), case.x0, "DOP853", rtol=1e-13, atol=1e-14)
        largest = float(np.max(np.linalg.norm(run.y, axis=0)))
        found.append((case.system, case.x0, case.time, run.y[:, -1], largest))
    return found


def ratios_of_estimates(method: co.methods.Method) -> np.ndarray:
    """Return the estimated error over the error of each run above rounding, on every system that the scheme serves."""
    found = []
    for system, x0, time, exact, largest in references():
        if not serves(method, system):
            continue
        step = abs(time) if method.own_steps else abs(time) / STEPS.get(method.order, MORE_STEPS)
        sol = co.integrate(system, x0, (0.0, time), step, method, watch=False)
        error = np.linalg.norm(sol.x[-1] - exact) / largest
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
