"""Schemes that do not fit a system, and wrong parameters of schemes: each is refused early, and everywhere alike."""

import copy
import pickle

import numpy as np
import pytest

import coadjoint as co
from digests.schemes_under_test import EXAMPLES
from refusals import refused


def _systems():
    so3, a = co.algebras.so(3), co.algebras.get("A4_8")
    full = np.random.default_rng(7).normal(size=(6, 6))
    cosh = co.Hamiltonian(lambda x: np.cosh(x[0]) + x[1] ** 2, lambda x: np.array([np.sinh(x[0]), 2 * x[1], 0.0]))
    timed = co.Hamiltonian(lambda x, t: np.cos(t) * x[2], lambda x, t: np.array([0.0, 0.0, np.cos(t)]))
    J = lambda x: np.array([[0, x[2], -x[1]], [-x[2], 0, x[0]], [x[1], -x[0], 0]])  # noqa: E731
    damping = co.forces.LinearDamping(0.1)
    yield "coupled cubic", co.LiePoissonSystem(so3, co.Polynomial({(1, 1, 1): 1.0}))
    yield "cubic powers", co.LiePoissonSystem(so3, co.Polynomial({(3, 0, 0): 1.0, (0, 2, 0): 0.5}))
    yield "cubic and coupled quadratic", co.LiePoissonSystem(so3, co.Polynomial({(3, 0, 0): 1.0, (1, 1, 0): 0.5}))
    yield "commuting cubic", co.LiePoissonSystem(a, co.Polynomial({(1, 1, 0, 0): 1.0, (2, 1, 0, 0): 0.5}))
    yield "coupled quartic", co.LiePoissonSystem(a, co.Polynomial({(0, 2, 2, 0): 1.0, (0, 0, 0, 2): 1.0}))
    yield "full quadratic", co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full + full.T))
    yield "function", co.LiePoissonSystem(so3, cosh)
    yield "function of time", co.LiePoissonSystem(so3, timed)
    yield "separable", co.LiePoissonSystem(so3, co.Separable({0: (np.cosh, np.sinh)}))
    yield "no algebra", co.PoissonSystem(J, co.Quadratic([1.0, 2.0, 3.0]))
    yield "forces", co.systems.rigid_body((1, 2, 3)).with_forces(damping)
    yield "forces on coupled cubic", co.LiePoissonSystem(so3, co.Polynomial({(1, 1, 1): 1.0})).with_forces(damping)
    yield "matrices", co.systems.matrix_body((1.0, 2.0, 3.0))


SYSTEMS = dict(_systems())
PARTS = ("free_body", "bonds", ((0,), (1,)), ((0,), (1,), (2,)))
METHODS = [*EXAMPLES, *(co.Splitting(parts=parts) for parts in PARTS)]
BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)


def refusal(call):
    """Return the exception and the message of a refused call, and None otherwise."""
    try:
        call()
    except (TypeError, ValueError) as reason:
        return type(reason), str(reason)
    except co.IntegrationError:
        return None
    return None


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", SYSTEMS)
def test_properties_and_stepper_refuse_what_a_run_refuses(name):
    system = SYSTEMS[name]
    x0 = 0.1 + 0.05 * np.arange(system.dim)
    if name == "matrices":
        x0 = np.array([[0.0, 0.1, 0.2], [-0.1, 0.0, 0.3], [-0.2, -0.3, 0.0]])
    for method in METHODS:
        run = refusal(lambda m=method: co.integrate(system, x0, (0.0, 0.01), 0.01, m))
        scheme = co.methods.Forced(method) if "forces" in name else method
        assert run == refusal(lambda s=scheme: s.properties(system)), method
        assert run == refusal(lambda m=method: co.stepper(system, m, 0.01)), method


def test_what_does_not_split_is_named():
    for call in (co.Splitting(order=4).properties, lambda system: co.stepper(system, co.Splitting(), 0.1)):
        with refused(ValueError, "x1*x2*x3", "x1 and x2"):
            call(SYSTEMS["coupled cubic"])
    with refused(ValueError, "parts", "x3"):
        co.Splitting(parts=((0,), (1,))).properties(BODY)


GAUSS = (co.GaussLegendre(2), co.ModifiedGaussLegendre(1, freeze="gradient"))


def attitude_run(method, algebra, representation):
    H = co.Quadratic(np.linspace(1.0, 2.0, algebra.dim))
    system = co.LiePoissonSystem(algebra, H, representation=representation)
    return co.integrate(system, np.full(algebra.dim, 0.1), (0, 0.1), 0.05, method, attitude=True)


@pytest.mark.parametrize("method", GAUSS, ids=repr)
def test_gauss_accepts_turned_coadjoint_matrices_with_more_rows(method):
    """The sum of the coadjoint and the trivial representation, in another basis."""
    so4 = co.algebras.so(4)
    D = np.zeros((6, 7, 7))
    D[:, :6, :6] = [so4.coadjoint(e) for e in np.eye(6)]
    turn = np.eye(7) + np.triu(np.full((7, 7), 0.5), 1)
    sol = attitude_run(method, so4, np.linalg.inv(turn) @ D @ turn)
    kept = np.linalg.solve(turn, np.eye(7)) @ np.append(sol.x0, 0.0)
    moved = sol.attitude[-1] @ np.linalg.solve(turn, np.append(sol.x[-1], 0.0))
    assert np.abs(moved - kept).max() < 1e-14


@pytest.mark.thinned(1)
@pytest.mark.parametrize("method", GAUSS, ids=repr)
@pytest.mark.parametrize(
    ("algebra", "named"),
    [
        (co.algebras.so(4), "spatial momentum"),
        (co.algebras.so(5), "spatial momentum"),
        (co.algebras.sl(2), "spatial momentum"),
        (co.algebras.e(3), "leave the group"),
        (co.algebras.A3_7(2.0), "leave the group"),
    ],
    ids=repr,
)
def test_gauss_refuses_group_elements_that_it_would_lose(method, algebra, named):
    with refused(ValueError, named):
        attitude_run(method, algebra, algebra.representation)


def test_there_is_no_group_without_an_algebra():
    with refused(ValueError, "no Lie algebra"):
        co.integrate(SYSTEMS["no algebra"], X0, (0, 1), 0.1, co.GaussLegendre(2), attitude="coadjoint")


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ("tolerance", "rtol", "atol"))
@pytest.mark.parametrize("scheme", (co.Splitting, co.GaussLegendre, co.ExplicitRungeKutta))
def test_a_scheme_without_a_tolerance_names_what_has_one(scheme, name):
    with refused(TypeError, scheme.__name__, name, "accuracy=", "Taylor", "ReversibleSteps"):
        scheme(**{name: 1e-6})


def test_other_parameters_are_refused():
    with refused(TypeError, "Splitting", "tol", "order"):
        co.Splitting(tol=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_copies_are_equal(method):
    assert pickle.loads(pickle.dumps(method)) == copy.deepcopy(method) == method


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("make", "allowed", "excluded", "named"),
    [
        (co.GaussLegendre, (1, 256), (0, 257), ("stages",)),
        (co.IsospectralGauss, (1, 8), (0, 9), ("stages",)),
        (co.Taylor, (1, 64), (0, 65), ("order",)),
        (lambda value: co.Taylor(tolerance=value), (1.01e-18, 0.1), (0.99e-18, 0.11, np.nan, -1.0), ("tolerance",)),
    ],
    ids=["GaussLegendre", "IsospectralGauss", "Taylor", "tolerance"],
)
def test_both_sides_of_limits(make, allowed, excluded, named):
    for value in allowed:
        make(value)
    for value in excluded:
        with refused(ValueError, *named, f"{value:g}"):
            make(value)


def bent_body(off):
    """Return the J(x) of so(3) with a part of second degree, of which the largest share of J is `off`.

    The largest at the points at which Kahan's method tries whether J is linear.
    """
    draw = np.random.default_rng(1993)
    shares = []
    for size in (1.0, 1.0, 32.0):
        a, b = size * draw.standard_normal((2, 3))
        shares.append(2.0 * abs(a[2] * b[2]) / max(np.abs(point).max() for point in (a, b, a + b)))
    bent = off / max(shares)

    def J(x):
        z = x[2] + bent * x[2] ** 2
        return np.array([[0 * z, -z, x[1]], [z, 0 * z, -x[0]], [-x[1], x[0], 0 * z]])

    return co.PoissonSystem(J, co.Quadratic((1.0, 2.0, 3.0)))


def test_kahan_takes_linear_structure_matrices_to_rounding():
    """J(a + b) is J(a) + J(b) within 64 n times the unit roundoff."""
    rounding = 64 * 3 * 2.0**-53
    co.Kahan().properties(bent_body(0.5 * rounding))
    with refused(ValueError, "Kahan"):
        co.Kahan().properties(bent_body(2.0 * rounding))


def test_spins_have_equal_brackets_to_rounding():
    """Within eight times the unit roundoff."""

    def run(off):
        algebra = co.LieAlgebra.from_brackets(3, {(0, 1): {2: 1.0}, (1, 2): {0: 1.0}, (2, 0): {1: 1.0 + off}})
        system = co.LiePoissonSystem(algebra, co.Quadratic((1.0, 2.0, 3.0)))
        return co.integrate(system, (1, 2, 3), (0, 0.1), 0.1, co.SphericalMidpoint())

    run(4 * 2.0**-53)
    with refused(ValueError, "SphericalMidpoint", "spins"):
        run(16 * 2.0**-53)
