"""Hamiltonians of every kind against plain formulas: at several times, in exact numbers, and as sums of sparse ones."""

import functools
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse

import coadjoint as co
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.driven import Driven
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.polynomial_form import polynomial_of

U = 2.0**-53
TIMES = (0.0, 0.7, -1.3)
X = np.array([0.4, -0.7, 1.1])
FORMULAS = {  # value, slope and curvature of a function of one coordinate and the time
    "steady": (np.cosh, np.sinh, np.cosh),
    "timed": (
        lambda y, t: np.cos(y) * np.exp(t),
        lambda y, t: -np.sin(y) * np.exp(t),
        lambda y, t: -np.cos(y) * np.exp(t),
    ),
}


def of_vector(name):
    """The same function as one of a vector with one entry."""
    f, df, ddf = FORMULAS[name]
    if name == "steady":
        return co.Hamiltonian(lambda y: f(y[0]), lambda y: np.array([df(y[0])]), lambda y: np.array([[ddf(y[0])]]))
    return co.Hamiltonian(
        lambda y, t: f(y[0], t), lambda y, t: np.array([df(y[0], t)]), lambda y, t: np.array([[ddf(y[0], t)]])
    )


def on(k, name):
    """The function of coordinate k as a function of three coordinates."""
    f, df, ddf = FORMULAS[name]
    e, unit = np.eye(3)[k], np.diag(np.eye(3)[k])
    if name == "steady":
        return co.Hamiltonian(lambda x: f(x[k]), lambda x: e * df(x[k]), lambda x: unit * ddf(x[k]))
    return co.Hamiltonian(lambda x, t: f(x[k], t), lambda x, t: e * df(x[k], t), lambda x, t: unit * ddf(x[k], t))


MADE = {
    "separable": lambda names: co.Separable({k: FORMULAS[name] for k, name in enumerate(names)}),
    "split": lambda names: co.SplitHamiltonian([((k,), of_vector(name)) for k, name in enumerate(names)]),
    "split of separable ones": lambda names: co.SplitHamiltonian(
        [((k,), co.Separable({0: FORMULAS[name]})) for k, name in enumerate(names)]
    ),
    "sum": lambda names: sum(on(k, name) for k, name in enumerate(names)),
}


@pytest.mark.parametrize("timed", [(), (0,), (1,), (2,), (0, 1, 2)], ids=str)
@pytest.mark.parametrize("kind", MADE)
def test_any_part_may_depend_on_the_time(kind, timed):
    names = ["timed" if k in timed else "steady" for k in range(3)]
    H = as_hamiltonian(MADE[kind](names), 3)
    system = co.LiePoissonSystem(co.algebras.so(3), H, casimirs={})
    assert H.timed == bool(timed)
    for t in TIMES:
        value, slope, curvature = (
            [FORMULAS[name][level](y, *((t,) if name == "timed" else ())) for name, y in zip(names, X, strict=True)]
            for level in range(3)
        )
        # Three numbers of the size of e^0.7 cosh(1.1) at most, each rounded a few times.
        assert abs(H.value(X, t) - sum(value)) < 32 * U and abs(system.energy(X, t) - sum(value)) < 32 * U
        np.testing.assert_allclose(H.gradient(X, t), slope, rtol=0, atol=32 * U)
        np.testing.assert_allclose(H.hessian(X, t), np.diag(curvature), rtol=0, atol=32 * U)
        np.testing.assert_allclose((-2 * H).hessian(X, t), np.diag(curvature) * -2, rtol=0, atol=64 * U)
        np.testing.assert_allclose(system.vector_field(X, t), np.cross(slope, X), rtol=0, atol=64 * U)


def sparse_symmetric(n, seed, density=0.35):
    """Small whole numbers at drawn places, so that all sums are exact."""
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.integers(-4, 5, (n, n)) * (rng.uniform(size=(n, n)) < density)).astype(float)
    return upper + np.triu(upper, 1).T


@pytest.mark.parametrize("seed", range(12))
def test_sums_of_sparse_matrices_are_sums_of_matrices(seed):
    """Entries of the two in any order and place, also of one column in consecutive rows."""
    n = 2 + seed % 5
    A, B = sparse_symmetric(n, seed), sparse_symmetric(n, 100 + seed, density=0.6)
    a, b = np.random.default_rng(seed).integers(-3, 4, (2, n)).astype(float)
    first, second = co.Quadratic(scipy.sparse.csr_array(A), a, 0.25), co.Quadratic(B, b, -2.0)
    x = np.random.default_rng(seed + 1).integers(-5, 6, n).astype(float)
    exact = co.Quadratic(np.array([[Fraction(v) for v in row] for row in A.tolist()], dtype=object), a, 0.25)
    for H in (first + second, second + first, exact + second, 3 * first - 2 * first + second):
        np.testing.assert_array_equal(H.hessian(x), A + B)
        np.testing.assert_array_equal(H.gradient(x), (A + B) @ x + a + b)
        assert H.value(x) == x @ (A + B) @ x / 2 + (a + b) @ x - 1.75
        (term,) = H.terms()
        dense = np.zeros((n, n))
        dense[term.rows, term.indices] = term.values
        np.testing.assert_array_equal(dense, A + B)
        assert np.array_equal(term.linear, a + b) and term.constant == -1.75


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int32, np.int64])
def test_numpy_integers_among_fractions_do_not_overflow(kind):
    large, third = int(np.iinfo(kind).max), Fraction(1, 3)
    M = np.array([[third, kind(-large)], [kind(-large), kind(large)]], dtype=object)
    H = co.Quadratic(M, linear=np.array([kind(large), third], dtype=object))
    x = [Fraction(large), Fraction(-3 * large, 2)]
    point = np.array(x, dtype=object)
    slope = [third * x[0] - large * x[1] + large, -large * x[0] + large * x[1] + third]
    value = third * x[0] ** 2 / 2 - large * x[0] * x[1] + Fraction(large, 2) * x[1] ** 2 + large * x[0] + third * x[1]
    for same in (H, H + H - H, 2 * H / 2):
        assert same.exact and same.value(point) == value and same.gradient(point).tolist() == slope
        assert same.to_polynomial()(point) == value
    assert (H + H).hessian(point).tolist() == [[2 * third, -2 * large], [-2 * large, 2 * large]]


def test_constants_of_numbers_of_fractions_and_of_pieces():
    """Also where no dimension is known yet."""
    for factor in (3, -0.5, Fraction(1, 4)):
        for H in (co.Quadratic(2.0, constant=1.5), co.Quadratic([2.0, 2.0], constant=1.5)):
            assert (factor * H).bind(2).value([1.0, 2.0]) == float(factor) * 6.5
            assert (factor * H + H).bind(2).value([1.0, 2.0]) == float(factor + 1) * 6.5
    third = Fraction(1, 3)
    assert co.Quadratic([1.0, 2.0], constant=third).exact and not co.Quadratic([1.0, 2.0], constant=0.25).exact
    assert co.Quadratic(1.0, constant=third).exact and co.Quadratic([1.0, 2.0], linear=[third, 0.0]).exact
    x = np.array([third, Fraction(-2)], dtype=object)
    assert co.Quadratic([Fraction(3), 0], constant=third).value(x) == Fraction(1, 2) * third + third
    odd = co.Quadratic([[3, 1], [1, 0]]).to_polynomial()
    assert odd(x) == Fraction(3, 2) * third**2 - 2 * third
    whole = co.Quadratic(np.array([[3, 1], [1, Fraction(1, 2)]], dtype=object)).to_polynomial()
    assert whole(x) == Fraction(3, 2) * third**2 - 2 * third + 1


def test_the_polynomial_of_a_hamiltonian_has_all_of_its_parts():
    cubic = Polynomial({(1, 2): Fraction(1, 3), (0, 0): 2})
    split = co.SplitHamiltonian(
        [
            ((2, 0), co.Quadratic([[1.0, 0.5], [0.5, 3.0]], linear=[0.25, -1.0], constant=-4.0)),
            ((1, 2), cubic),
            ((0,), co.Quadratic(2.0, linear=[1.0], constant=0.5)),
        ]
    ).bind(3)
    both = as_hamiltonian(split + co.Polynomial({(1, 1, 1): 2.0, (0, 0, 0): 7.0}, dim=3), 3)
    for H in (split, both, as_hamiltonian(co.Quadratic(3.0, constant=1.0), 3)):
        polynomial = polynomial_of(H)
        for x in (np.zeros(3), X, -2 * X):
            assert polynomial(x) == pytest.approx(H.value(x), rel=1e-14)
    assert polynomial_of(as_hamiltonian(split + co.Separable({0: (np.cosh, np.sinh)}), 3)) is None


@pytest.mark.parametrize("order", [(int, float, Fraction), (float, Fraction, int)], ids=str)
def test_equal_polynomials_of_other_numbers_stay_what_they_are(order):
    """Whole numbers and fractions are exact and floats are not, whichever was converted first."""
    for kind in order:
        H = as_hamiltonian(Polynomial({(2, 0): kind(7), (1, 1): kind(3), (0, 1): kind(5), (0, 0): kind(11)}), 2)
        assert H.exact == (kind is not float), kind


def test_sums_of_split_ones_have_the_dimension_that_is_known():
    def one(k):
        return co.SplitHamiltonian([((k,), co.Quadratic(float(k + 1)))])

    for first, second in ((one(0).bind(4), one(2)), (one(0), one(2).bind(4)), (one(0).bind(4), one(2).bind(4))):
        for H in (first + second, second + first):
            assert H.dim == 4
            np.testing.assert_array_equal(H.gradient(np.ones(4)), [1.0, 0.0, 3.0, 0.0])
    assert (one(0) + one(2)).dim is None
    for wrong in (lambda: one(0).bind(4) + one(2).bind(5), lambda: one(2).bind(5) + one(0).bind(4)):
        with pytest.raises(ValueError, match=r"Hamiltonians of 4 and 5 coordinates|of 5 and 4 coordinates"):
            wrong()
    pieces = [((0,), co.Quadratic(1.0)), ((1,), co.Quadratic(1.0)), ((2,), co.Quadratic(1.0))]
    with pytest.raises(ValueError, match="piece 2 has coordinate 2; the system has coordinates 0 to 1"):
        co.SplitHamiltonian(pieces).bind(2)


def test_sparse_matrices_that_are_given_stay_as_they_are():
    """With duplicates and stored zeros, of real numbers of any type; complex ones are refused."""
    for kind in (np.float64, np.float32, np.int32):
        M = scipy.sparse.csr_array((np.array([1, 2, 3, 0, 3, 5], kind), [0, 0, 1, 2, 0, 2], [0, 4, 5, 6]), shape=(3, 3))
        parts = [part.copy() for part in (M.data, M.indices, M.indptr)]
        H = co.Quadratic(M)
        np.testing.assert_array_equal(H.hessian(X), [[3.0, 3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
        for now, before in zip((M.data, M.indices, M.indptr), parts, strict=True):
            np.testing.assert_array_equal(now, before)
        M.data[:] = 9
        np.testing.assert_array_equal(H.gradient([0.0, 0.0, 1.0]), [0.0, 0.0, 5.0])
    with pytest.raises(TypeError, match="M has numbers of type complex128; give real numbers"):
        co.Quadratic(scipy.sparse.eye_array(3, dtype=complex))


def test_wrong_linear_parts_points_and_summands_are_refused():
    H = co.Quadratic([1.0, 2.0, 3.0])
    for wrong in ([[1.0, 2.0, 3.0]], [1.0, 2.0], 1.0):
        with pytest.raises(ValueError, match=r"linear has the shape .*; give one coefficient for each of 3"):
            H.with_linear(wrong)
    some = co.Separable({1: (np.cosh, np.sinh, np.cosh), 3: (np.cosh, np.sinh, np.cosh)})
    for look in (some.value, some.gradient, some.hessian):
        with pytest.raises(ValueError, match="a function of coordinate 3, but x has only 3 entries"):
            look(X)
    with pytest.raises(TypeError, match="cannot be added to one"):
        H + type("OwnKind", (co.Quadratic,), {"__module__": "mine"})
    for divided, third in ((H / 3, Fraction(1, 3)), (co.Separable({0: (np.cosh, np.sinh)}) / 4, None)):
        assert third is None or (co.Quadratic([Fraction(1), 2]) / 3).as_given().entries.tolist() == [third, 2 * third]
        assert divided.gradient(X)[0] == pytest.approx(X[0] / 3 if third else np.sinh(X[0]) / 4, rel=1e-15)


@pytest.mark.parametrize(("sites", "axes"), [(1, 3), (3, 1), (2, 2), (2, 3)])
@pytest.mark.parametrize("uniform", [True, False])
def test_forces_in_time_on_every_site_and_axis(sites, axes, uniform):
    """H = Q(x) - sum of f_sa(t) x_sa, also a multiple of it, by the functions and by the terms."""
    n = sites * axes
    shape = (axes,) if uniform else (sites, axes)
    grid = np.arange(1.0, n + 1 if not uniform else axes + 1).reshape(shape)
    square = sparse_symmetric(n, 3)
    # A partial function is not compiled.
    drive = functools.partial(lambda grid, t: grid * np.cos(t) + 0.25 * t, grid)
    H = Driven(co.Quadratic(square), drive, sites, axes, "force")
    x = np.linspace(-1.0, 1.5, n)
    for t in TIMES:
        forces = np.broadcast_to(grid * np.cos(t) + 0.25 * t, (sites, axes)).ravel()
        for factor in (1, -2.5):
            whole = factor * H
            np.testing.assert_allclose(whole.gradient(x, t), factor * (square @ x - forces), rtol=0, atol=256 * U)
            np.testing.assert_allclose(whole.value(x, t), factor * (x @ square @ x / 2 - forces @ x), atol=512 * U)
            np.testing.assert_array_equal(whole.hessian(x, t), factor * square)
            slope, value = square @ x * factor, factor * (x @ square @ x) / 2
            for term in whole.terms()[1:]:
                y = x[term.coordinates]
                slope[term.coordinates] += term.gradient(y, t)
                value += term.value(y, t)
            np.testing.assert_allclose(slope, whole.gradient(x, t), rtol=0, atol=256 * U)
            np.testing.assert_allclose(value, whole.value(x, t), rtol=0, atol=512 * U)
    for bad in (np.inf, np.nan):
        for place in range(grid.size):
            wrong = grid.copy()
            wrong.flat[place] = bad
            with pytest.raises(ValueError, match=r"force\(0.0\) is not finite"):
                Driven(co.Quadratic(square), lambda t, wrong=wrong: wrong, sites, axes, "force")
    with pytest.raises(ValueError, match=r"force\(t\) has shape"):
        Driven(co.Quadratic(square), lambda t: np.ones(n + 1), sites, axes, "force")
