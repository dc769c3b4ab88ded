"""H1 + H2 and multiples: the values, the runs and the properties of what is written out by hand."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(3)
rng = np.random.default_rng(11)
A, a = rng.normal(size=(3, 3)), rng.normal(size=3)
A = A + A.T


def test_scalars_take_the_dimension_of_the_other_summand():
    """In either order, for every kind, as the matrix 1.5 times the identity."""
    x, square = POINTS[0], 0.75 * POINTS[0] @ POINTS[0]
    for name, make in KINDS.items():
        for scalar, added in ((co.Quadratic(1.5), square), (co.Quadratic(1.5) - 2, square - 2.0), (3, 3.0)):
            expected = bound(make()).value(x) + added
            for H in (scalar + make(), make() + scalar, sum([scalar, make()]), sum([make(), scalar])):
                assert abs(bound(H).value(x) - expected) < 2.0**-46, name
                assert name in ("scalar", "functions") or H.dim in (3, None), name
    P = co.Polynomial("x1*x2*x3 - 2", dim=3)
    written = co.Polynomial("x1*x2*x3 + x1^2 + x2^2 + x3^2 - 2", dim=3)
    assert co.Quadratic(2.0) + P == P + co.Quadratic(2.0) == written and written - P == co.Quadratic(2.0) + 0 * P


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(3), co.ExplicitRungeKutta()], ids=str)
def test_properties_of_a_sum_are_those_of_what_is_written_out(method):
    parts = {0: (lambda y: 0.5 * y * y, lambda y: y), 1: (lambda y: 0.25 * y * y, lambda y: 0.5 * y)}
    cosh = {2: (np.cosh, np.sinh)}
    whole, added = co.Separable({**parts, **cosh}), co.Quadratic([1.0, 0.5, 0.0]) + co.Separable(cosh)
    found, expected = (method.properties(co.LiePoissonSystem(co.algebras.so(3), H)) for H in (added, whole))
    assert found == expected


KINDS = {
    "quadratic": lambda: co.Quadratic(A, linear=a, constant=0.25),
    "scalar": lambda: co.Quadratic(1.5, constant=0.25),
    "fractions": lambda: co.Quadratic([Fraction(1, 3), 2, Fraction(5, 7)], constant=Fraction(1, 9)),
    "polynomial": lambda: co.Polynomial("x1*x2*x3 + 0.25*x1^4 - x2 + 2", dim=3),
    "low polynomial": lambda: co.Polynomial("1/3*x1^2 - x2*x3 + x1", dim=3),
    "separable": lambda: co.Separable({0: (np.cosh, np.sinh, np.cosh), 2: (np.sin, np.cos, lambda y: -np.sin(y))}),
    "separable in time": lambda: co.Separable(
        {1: (lambda y, t: y**2 * np.cos(t), lambda y, t: 2 * y * np.cos(t), lambda y, t: 2 * np.cos(t) + 0 * y)}
    ),
    "functions": lambda: co.Hamiltonian(
        lambda x: x[0] * x[1] * x[2],
        lambda x: np.array([x[1] * x[2], x[0] * x[2], x[0] * x[1]]),
        lambda x: np.array([[0 * x[0], x[2], x[1]], [x[2], 0 * x[0], x[0]], [x[1], x[0], 0 * x[0]]]),
    ),
    "functions that return lists, in time": lambda: co.Hamiltonian(
        lambda x, t: t * x[0], lambda x, t: [t, 0.0, 0.0], lambda x, t: np.zeros((3, 3))
    ),
    "split": lambda: co.SplitHamiltonian(
        [((0,), co.Quadratic(2.0, linear=[1.0])), ((2,), co.Polynomial("x1^3 - x1", dim=1)), ((1,), cosh())]
    ),
    "split too": lambda: co.SplitHamiltonian([((1,), co.Quadratic(0.5)), ((2,), cosh())]),
}
POINTS = rng.normal(size=(3, 3))


def cosh():
    return co.Separable({0: (np.cosh, np.sinh, np.cosh)})


def bound(H):
    return co.LiePoissonSystem(co.algebras.so(3), H).hamiltonian


@pytest.mark.thinned(32)
@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_every_kind_and_every_other(first, second):
    H1, H2 = KINDS[first](), KINDS[second]()
    ways = {
        (1, 1): H1 + H2,
        (1, -1): H1 - H2,
        (2, -0.5): 2 * H1 - H2 / 2,
        (1, Fraction(1, 3)): sum([H1, H2 / 3]),
        (-1, 3): -(H1 - 3 * H2),
        (np.float64(0.5), np.int64(2)): np.float64(0.5) * H1 + H2 * np.int64(2),
    }
    one, other = bound(H1), bound(H2)
    for (p, q), H in ways.items():
        p, q, whole = float(p), float(q), bound(H)
        assert whole.timed == (one.timed or other.timed)
        for x in POINTS:
            for t in (0.0, 0.7):
                for name in ("value", "gradient", "hessian"):
                    parts = [p * getattr(one, name)(x, t), q * getattr(other, name)(x, t)]
                    # Each summand takes at most some 20 operations on numbers of the size 10.
                    size = max(10.0, *(np.abs(part).max() for part in parts))
                    np.testing.assert_allclose(getattr(whole, name)(x, t), sum(parts), rtol=0, atol=2**-53 * 40 * size)


@pytest.mark.thinned(5)
@pytest.mark.parametrize(
    "first, second",
    [
        ("quadratic", "separable"),
        ("split", "separable in time"),
        ("polynomial", "functions"),
        ("functions that return lists, in time", "fractions"),
        ("separable", "split too"),
    ],
)
def test_multiples_run_as_what_is_written_at_once(first, second):
    """The compiled steps are those of the formulas of the scheme, with the gradients that are compared above."""
    system = co.LiePoissonSystem(co.algebras.so(3), Fraction(3, 4) * KINDS[first]() - 0.5 * KINDS[second]())
    x, methods = np.array([0.3, -0.2, 0.9]), [co.GaussLegendre(4)]
    if "functions" not in first + second:
        methods.append(co.Splitting(order=4))
    for method in methods:
        for t, h in ((0.7, 0.125), (0.7, -0.125)):
            found = co.integrate(system, x, (t, t + h), 0.125, method).x[-1]
            np.testing.assert_allclose(found, method.step(system, x, t, h), rtol=0, atol=1e-14)
            assert np.abs(found - x).max() > 1e-3


def test_sums_are_saved_and_read_back(tmp_path):
    H = co.Polynomial("x1^3 + 0.1*x2*x3", dim=3) + co.SplitHamiltonian([((0,), co.Quadratic(2.0))]) / 2
    system, x = co.LiePoissonSystem(co.algebras.so(3), H), np.array([0.5, 0.25, -1.0])
    run = co.integrate(system, x, (0.0, 1.0), 0.1, co.GaussLegendre(2))
    co.integrate(system, x, (0.0, 0.5), 0.1, co.GaussLegendre(2), archive=tmp_path / "sum.zarr")
    resumed = co.resume(tmp_path / "sum.zarr", t_end=1.0)
    np.testing.assert_array_equal(resumed.x[-1], run.x[-1])
    assert resumed.system.energy(x) == system.energy(x)


@pytest.mark.thinned(7)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", [lambda H: 2 * H, lambda H: -H, lambda H: H / 4, lambda H: H + H])
def test_what_is_made_of_one_that_has_run_is_made_of_a_new_one(kind, change):
    """To the bit: nothing that a run has prepared is left in it."""
    used = KINDS[kind]()

    def run(H):
        system = co.LiePoissonSystem(co.algebras.so(3), H)
        return co.integrate(system, POINTS[0], (0.5, 1.0), 0.125, co.GaussLegendre(2)).x

    run(used)
    changed, new = change(used), change(KINDS[kind]())
    np.testing.assert_array_equal(run(changed), run(new))
    np.testing.assert_array_equal(bound(changed).gradient(POINTS[0], 0.7), bound(new).gradient(POINTS[0], 0.7))


def test_linear_terms_that_inputs_cannot_replace():
    squares = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda y: y @ y, lambda y: 2 * y), name="squares")
    with refused(TypeError, "'squares'", "inputs"):
        co.prepare(squares, co.GaussLegendre(2), 0.1, inputs=True)
