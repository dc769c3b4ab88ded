"""Steps of the Runge-Kutta schemes in any number type: derivatives, invariants, refusals."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)

GAUSS, ITERATED, MODIFIED, EXPLICIT = (
    co.GaussLegendre,
    co.IteratedGaussLegendre,
    co.ModifiedGaussLegendre,
    co.ExplicitRungeKutta,
)
FULL = np.diag([1.0, 0.5, 1.25, 0.75, 1.5, 0.25]) + 0.125 * (np.ones((6, 6)) - np.eye(6))


def quadratic_field(x):
    """J = hat(grad F), F = x1 x2 x3 + x3^2: a Poisson structure that is quadratic in x, with the Casimir F."""
    g = [x[1] * x[2], x[0] * x[2], x[0] * x[1] + 2 * x[2]]
    return np.array([[0 * x[0], -g[2], g[1]], [g[2], 0 * x[0], -g[0]], [-g[1], g[0], 0 * x[0]]])


def quadratic_field_derivative(x):
    H = [[0 * x[0], x[2], x[1]], [x[2], 0 * x[0], x[0]], [x[1], x[0], 2 + 0 * x[0]]]
    result = np.zeros((3, 3, 3))
    for i, j, k, sign in ((0, 1, 2, -1.0), (0, 2, 1, 1.0), (1, 2, 0, -1.0)):
        result[i, j], result[j, i] = sign * np.array(H[k]), -sign * np.array(H[k])
    return result


def driven(x, t):
    return x[0] * x[0] * (1 + t) / 2 + x[1] * x[2] * t * t + x[2] * x[2]


def driven_gradient(x, t):
    return np.array([x[0] * (1 + t), x[2] * t * t, x[1] * t * t + 2 * x[2]])


def driven_hessian(x, t):
    return np.array([[1.0 + t, 0.0, 0.0], [0.0, 0.0, t * t], [0.0, t * t, 2.0]])


def systems():
    e3, so4 = co.algebras.e(3), co.algebras.so(4)
    top = co.Quadratic([1.0, 0.5, 0.25, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    cubic = co.Polynomial(
        {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    )
    return {
        "top": (co.LiePoissonSystem(e3, top, sign=-1), [1.0, -0.5, 1.5, 0.625, 0.25, 0.75]),
        "cubic": (co.LiePoissonSystem(e3, cubic, sign=-1), [1.0, -0.5, 0.75, 0.625, 0.25, 0.75]),
        "so(4)": (co.LiePoissonSystem(so4, co.Quadratic(FULL)), [1.0, 0.5, -0.25, 0.75, -1.0, 0.375]),
        "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0])), [1.0, 0.5, -0.25]),
        "A3,7": (co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic([1.0, 2.0, 0.25])), [0.75, 0.5, 0.625]),
        "driven": (
            co.LiePoissonSystem(co.algebras.sl(2), co.Hamiltonian(driven, driven_gradient, driven_hessian)),
            [1.0, 0.5, -0.25],
        ),
        "quadratic J": (
            co.PoissonSystem(
                quadratic_field, co.Quadratic([1.0, 0.5, 0.25], linear=[0, 0, 1]), derivative=quadratic_field_derivative
            ),
            [0.75, 0.5, -0.625],
        ),
    }


def multiprecision(x):
    return np.array([mpmath.mpf(v) for v in x], dtype=object)


def test_orders():
    assert [GAUSS(s).order for s in (1, 3, 6)] == [2, 6, 12]
    assert ITERATED(3).order == 6 and ITERATED(3).function_iterations == 5
    assert MODIFIED(2).order == 4 and MODIFIED(2).function_iterations == 3


def test_runge2_is_exact_in_fractions():
    system, _ = systems()["sl(2)"]
    x = np.array([Fraction(1), Fraction(1, 2), Fraction(-1, 3)], dtype=object)
    h = Fraction(1, 10)
    middle = x + h / 2 * system.vector_field(x)
    assert list(EXPLICIT("runge2").step(system, x, 0, h)) == list(x + h * system.vector_field(middle))


def test_exact_fractions_are_refused_where_no_step_is_rational():
    system, _ = systems()["sl(2)"]
    x = np.array([Fraction(1), Fraction(1, 2), Fraction(-1, 3)], dtype=object)
    with refused(TypeError, "irrational"):
        ITERATED(2).step(system, x, 0, Fraction(1, 10))
    with refused(TypeError, "floats"):
        GAUSS(1).step(system, x, 0, Fraction(1, 10))
    # one stage is rational, and so is its linear system: the energy is kept exactly
    new = MODIFIED(1).step(system, x, 0, Fraction(1, 10))
    assert all(isinstance(v, Fraction) for v in new)
    assert system.energy(new) == system.energy(x)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "method", [EXPLICIT("runge2"), EXPLICIT("rk4"), GAUSS(2), ITERATED(2), MODIFIED(2, freeze="gradient")]
)
def test_each_stage_takes_the_derivative_at_its_own_time(method):
    """x2' = r(t) x2 is linear: its derivative is the step from x2 = 1; r differs from stage to stage."""
    line = co.LieAlgebra([(0, 1, 1, 1.0)], dim=2)

    def rate(t):
        return 0.5 + t - 3 * t * t

    H = co.Hamiltonian(
        lambda x, t: rate(t) * x[0],
        lambda x, t: np.array([rate(t), 0 * x[0]]),
        lambda x, t: np.zeros((2, 2)),
    )
    system = co.LiePoissonSystem(line, H)
    _, P = method.tangent(system, np.array([0.25, 2.0]), 0.25, 0.5)
    assert abs(P[1, 1] - method.step(system, [0.25, 1.0], 0.25, 0.5)[1]) <= 64 * 2.0**-53
    assert P[0].tolist() == [1.0, 0.0] and abs(P[1, 0]) <= 64 * 2.0**-53
    assert abs(method.step(system, [0.25, 1.0], 0.5, 0.5)[1] - P[1, 1]) > 1e-2


def test_tangent_needs_the_second_derivatives():
    H = co.Hamiltonian(driven, driven_gradient)
    system = co.LiePoissonSystem(co.algebras.sl(2), H)
    with refused(TypeError, "second derivatives"):
        GAUSS(2).tangent(system, [1.0, 0.5, 0.25], 0.0, 0.1)


def test_quadratic_invariants_in_multiprecision():
    """To 45 of 50 digits in one large step; the paper's claim and its two halves."""
    system, x0 = systems()["so(4)"]
    x = multiprecision(x0)
    with mpmath.workdps(50):
        h = mpmath.mpf("0.25")
        casimirs = list(system.casimirs.values())
        changes = {}
        for key, method in {
            "gauss": GAUSS(3),
            "structure": MODIFIED(2, iterations=2),
            "gradient": MODIFIED(2, iterations=2, freeze="gradient"),
            "iterated": ITERATED(2),
        }.items():
            new = method.step(system, x, 0, h)
            changes[key] = (
                abs(system.energy(new) - system.energy(x)),
                max(abs(C(new) - C(x)) for C in casimirs),
            )
    kept, lost = 1e-45, 1e-9
    assert changes["gauss"][0] < kept and changes["gauss"][1] < kept
    assert changes["structure"][0] < kept and changes["structure"][1] > lost
    assert changes["gradient"][0] > lost and changes["gradient"][1] < kept
    assert min(changes["iterated"]) > lost


@pytest.mark.parametrize(
    ("method", "name", "said"),
    [
        (MODIFIED(1), "cubic", "quadratic Hamiltonian"),
        (MODIFIED(1), "driven", "quadratic Hamiltonian"),
        (MODIFIED(1, freeze="gradient"), "quadratic J", "Lie algebra"),
        (co.RadauEnergy(2), "driven", "depends on time"),
    ],
)
def test_systems_that_cannot_be_served_are_refused(method, name, said):
    system, x0 = systems()[name]
    with refused(ValueError, said):
        method.properties(system)
    with refused(ValueError, said):
        method.step(system, x0, 0.0, 0.1)


def test_no_convergence_says_so():
    system, x0 = systems()["so(4)"]
    with refused(co.IntegrationError, "converge") as caught:
        GAUSS(2).step(system, x0, 0.0, 10.0)
    assert caught.value.residual > 1.0
