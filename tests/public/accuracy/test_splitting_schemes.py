"""Splittings of orders 1 to 10 by words, of many coordinates, and as flows of modified Hamiltonians.

A symmetric second-order step is exp(h Y1 + h^3 Y3 + ...) with free Y's, a first-order step exp(h Y1 + h^2 Y2 + ...),
its adjoint the inverse of the step over -h.
"""

import re
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from scipy.sparse import diags_array

import coadjoint as co
from digests.explicit_systems import extrapolated
from guards import bounded_work
from long import long_beyond
from random_runs.algebras import some_algebra
from random_runs.hamiltonians import matrix, polynomial
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

DIGITS = 60
NAMES = (
    "strang blanes_moan4 kahan_li4 mclachlan4 suzuki4 yoshida4 blanes_casas_murua6 blanes_moan6 kahan_li6a kahan_li6b"
    " sofroniou_spaletta6 sofroniou_spaletta6_s13 yoshida6 blanes_casas_murua8 kahan_li8a kahan_li8b"
    " sofroniou_spaletta8 suzuki_umeno8 blanes_casas_murua10 kahan_li10a kahan_li10d sofroniou_spaletta10"
).split()
ORDERS = {name: 2 if name == "strang" else int(re.search(r"\d+", name)[0]) for name in NAMES}
PROCESSED = [name for name in ORDERS if name.startswith("blanes_casas")]


def words(letters, highest):
    """Return all words of weight at most `highest`; prefixes come first."""
    by_weight = {0: [()]}
    for weight in range(1, highest + 1):
        by_weight[weight] = [w + (k,) for k in letters if k <= weight for w in by_weight[weight - k]]
    return [word for group in by_weight.values() for word in group]


def exponential(letters, highest):
    """Return exp(sum_k letters[k] Y_k), by words."""
    result = {}
    for word in words(letters, highest):
        product = mpmath.mpf(1)
        for letter in word:
            product *= letters[letter]
        result[word] = product / mpmath.factorial(len(word))
    return result


def multiplied(left, right):
    return {word: sum(left[word[:k]] * right[word[k:]] for k in range(len(word) + 1)) for word in left}


def product_of(factors, highest):
    result = exponential(factors[0], highest)
    for letters in factors[1:]:
        result = multiplied(result, exponential(letters, highest))
    return result


def factors_of(name, highest, number=mpmath.mpf):
    """Return the exponents of a whole step P^-1, K, P, from the sweeps of the library."""
    method = co.Splitting(scheme=name)
    kernel, processor = method.sweeps(number), method.processor(number)
    undone = [(not sweep.forward, -sweep.coefficient) for sweep in processor[::-1]]
    sweeps = undone + [(sweep.forward, sweep.coefficient) for sweep in (*kernel, *processor)]
    assert [forward for forward, _ in sweeps] == [k % 2 == 0 for k in range(len(sweeps))]
    pairs = list(pairwise(c for _, c in sweeps))[::2]
    if all(a == b for a, b in pairs):
        # Forward and back over the same time: a symmetric step of order 2 over both.
        return [{k: (a + b) ** k for k in range(1, highest + 1, 2)} for a, b in pairs]
    assert not processor
    letters = range(1, highest + 1)
    return [{k: c**k if forward else -((-c) ** k) for k in letters} for forward, c in sweeps]


def defects(name, highest, number=mpmath.mpf):
    """Return the largest difference from exp(Y1) for each weight, and the effect of rounded coefficients."""
    factors = factors_of(name, highest, number)
    product = product_of(factors, highest)
    exact = exponential({k: mpmath.mpf(k == 1) for k in factors[0]}, highest)
    found = [max(abs(product[w] - exact[w]) for w in product if sum(w) == g) for g in range(1, highest + 1)]
    # A condition of weight g sums products of g coefficients, each of which is known to 39 or 49 decimals.
    sizes = product_of([{k: abs(c) for k, c in letters.items()} for letters in factors], highest)
    known = mpmath.mpf(10) ** (-39 if name in PROCESSED else -49) / min(abs(letters[1]) for letters in factors)
    return found, [g * known * max(sizes[w] for w in product if sum(w) == g) for g in range(1, highest + 1)]


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", ORDERS)
def test_order_conditions_hold(name):
    order = ORDERS[name]
    with mpmath.workdps(DIGITS):
        found, bounds = defects(name, order + 1)
        assert all(defect <= bound for defect, bound in zip(found[:order], bounds, strict=False)), found
        assert max(bounds[:order]) < 1e-28
        assert found[order] > 1e-7  # and not one more


@pytest.mark.parametrize("name", ["yoshida4", "blanes_moan6", "sofroniou_spaletta8"])
def test_order_conditions_detect_double_precision(name):
    """The negative control: coefficients with 16 digits instead of 49."""
    with mpmath.workdps(DIGITS):
        found, bounds = defects(name, ORDERS[name], lambda v: mpmath.mpf(float(v)))
        assert any(defect > bound for defect, bound in zip(found, bounds, strict=True))


def test_processed_scheme_is_symmetric_to_order_plus_two():
    method, errors = co.Splitting(scheme="blanes_casas_murua8", parts="coordinates"), []
    H = co.Quadratic([1.0, 0.5, 0.375, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    top = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)
    with mpmath.workdps(50):
        x0 = np.array([mpmath.mpf(v) for v in (1.0, -0.5, 1.5, 0.625, 0.0, 0.75)], dtype=object)
        for h in (mpmath.mpf(2) ** -6, mpmath.mpf(2) ** -7):
            back = method.step(top, method.step(top, x0, 0, h), 0, -h)
            errors.append(max(abs(v) for v in back - x0))
        assert abs(mpmath.log(errors[0] / errors[1], 2) - 10) < 0.15


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ORDERS)
def test_coefficients_fill_one_step(name):
    """Fractions add up to one in the kernel and to none in the processor; floats are the rounded 40 digits."""
    method = co.Splitting(scheme=name)
    assert (method.order, method.symmetric, method.explicit) == (ORDERS[name], name not in PROCESSED, True)
    for sweeps, whole in ((method.sweeps(), 1.0), (method.processor(), 0.0)):
        fractions = [sweep.coefficient for sweep in sweeps]
        assert whole == 0.0 or fractions == fractions[::-1]
        size = max(1, len(fractions)) * max(1.0, sum(map(abs, fractions)))
        assert abs(sum(fractions) - whole) <= U * size
    with mpmath.workdps(40):
        for a, b in zip(method.sweeps(mpmath.mpf), method.sweeps(), strict=True):
            assert abs(a.coefficient - b.coefficient) <= 2 * U * abs(a.coefficient)


SO3 = co.algebras.so(3)


def symmetric(rng, n):
    M = rng.normal(size=(n, n))
    return M + M.T + np.diag(rng.normal(size=n))


@pytest.mark.long
@pytest.mark.parametrize("order", long_beyond(1, [2, 4]))
def test_many_coupled_coordinates_move_rightly(order):
    algebra, rng = co.algebras.su(9), np.random.default_rng(2)  # 80 coordinates, above every bound of what is small
    system = co.LiePoissonSystem(algebra, co.Quadratic(symmetric(rng, algebra.dim) / 20))
    x = rng.normal(size=algebra.dim) / 3
    expected = co.integrate(system, x, (0.0, 0.25), 1 / 64, co.GaussLegendre(4)).x[-1]
    errors = [
        np.abs(co.integrate(system, x, (0.0, 0.25), h, co.Splitting(order=order)).x[-1] - expected).max()
        for h in (1 / 32, 1 / 64)
    ]
    assert 2 ** (order - 0.7) < errors[0] / errors[1] < 2 ** (order + 0.7)


@pytest.mark.parametrize(
    ("algebra", "count", "method"),
    [("su(32)", 1023, co.Splitting(order=2)), ("so(45)", 990, co.Splitting(order=4, parts="coordinates"))],
)
def test_what_takes_minutes_is_refused_at_once(algebra, count, method):
    g = co.algebras.get(algebra)
    system = co.LiePoissonSystem(g, co.Quadratic(symmetric(np.random.default_rng(7), g.dim)))
    for call in (
        lambda: method.properties(system),
        lambda: co.prepare(system, method, 0.1),
        lambda: co.integrate(system, np.ones(g.dim), (0, 1), 0.1, method),
    ):
        with bounded_work(30.0), refused(ValueError, "Splitting", f"{count} flows", "GaussLegendre"):
            call()
    assert co.GaussLegendre(2).properties(system).energy


@pytest.mark.long
def test_terms_that_would_take_days_are_refused_at_once():
    g = co.algebras.su(9)
    system = co.LiePoissonSystem(g, co.Quadratic(symmetric(np.random.default_rng(1), g.dim)))
    with bounded_work(), refused(ValueError, "products of monomials", "a lower order"):
        co.modified_hamiltonian(system, co.Splitting(order=2), order=4)
    assert list(co.modified_hamiltonian(system, co.Splitting(order=2), order=2).terms) == [0]


def test_casimirs_of_many_copies_are_followed_by_name():
    count = 3000
    bonds = np.tile((0.1, 0.1, 0.2), count)[3:]
    energy = co.Quadratic(diags_array([np.tile((1.0, 0.5, 0.25), count), bonds, bonds], offsets=[0, 3, -3]))
    first = diags_array(np.r_[np.ones(3), np.zeros(3 * count - 3)]).tocsr()
    first.eliminate_zeros()
    algebra, named = co.algebras.copies(SO3, count), {"spin 1": co.Quadratic(first), "all": co.Quadratic(1.0)}
    assert co.LiePoissonSystem(algebra, energy).casimirs == {}
    x0 = np.random.default_rng(0).standard_normal(3 * count)
    system = co.LiePoissonSystem(algebra, energy, casimirs=named)
    sol = co.integrate(system, x0, (0.0, 1.0), 0.1, observe={"half of spin 1": co.Quadratic(0.5 * first)})
    assert sol.casimirs["spin 1"][0] == pytest.approx(0.5 * x0[:3] @ x0[:3], rel=8 * U)
    # Ten steps of five rotations each may change a length by some roundings of each.
    assert sol.drift()["spin 1"] < 200 * U * (x0[:3] @ x0[:3])
    assert sol.drift()["all"] < 200 * U * (x0 @ x0)
    assert np.array_equal(2 * sol.observed["half of spin 1"], sol.casimirs["spin 1"])
    with refused(ValueError, "'x1'", "Casimir"):
        co.LiePoissonSystem(SO3, co.Quadratic(1.0), casimirs={"x1": co.Quadratic([1.0, 0.0, 0.0])})


def test_a_constant_hamiltonian_moves_nothing():
    sol = co.integrate(co.LiePoissonSystem(SO3, co.Quadratic(0.0)), (1.0, 2.0, 3.0), (0, 1), 0.1, attitude=True)
    assert np.array_equal(sol.x, np.tile([1.0, 2.0, 3.0], (11, 1)))
    assert np.array_equal(sol.attitude[-1], np.eye(3))


def some_scheme(rng):
    """Return a splitting of order 1, 2 or 4, or a composition."""
    parts = ("auto", "coordinates")[rng.integers(2)]
    rotation = ("exact", "rational")[rng.integers(2)]
    kind = rng.integers(4)
    if kind == 0:
        return co.Splitting(order=1, adjoint=bool(rng.integers(2)), parts=parts, rotation=rotation)
    if kind == 3:
        base = co.Splitting(order=2, parts=parts, rotation=rotation)
        return co.Composition(base, ((0.5, 0.5), (0.75, -0.25, 0.5))[rng.integers(2)])
    return co.Splitting(order=2 * int(kind), parts=parts, rotation=rotation)


def case_of(seed):
    """Return system, scheme, modified Hamiltonian with two terms, and a state of size one."""
    rng = np.random.default_rng([8, seed])
    while True:
        algebra, sign, scheme = some_algebra(rng), (1, -1)[seed % 2], some_scheme(rng)
        if algebra.dim > 6:
            continue
        n = algebra.dim
        H = polynomial(rng, n) if rng.random() < 0.5 else co.Quadratic(matrix(rng, n), linear=rng.standard_normal(n))
        try:
            system = co.LiePoissonSystem(algebra, H, sign=sign)
            modified = co.modified_hamiltonian(system, scheme, scheme.order + 2)
        except ValueError:
            continue  # refused by name, as the tests of refusals see: a piece that no flow is known for
        if sum(len(term.monomials) for term in modified.terms.values()) <= 200:
            return system, scheme, modified, rng.uniform(-1.0, 1.0, n)


def field_of(system, modified, x, h):
    """Return sign J grad H~ in any number type, from the structure constants."""
    slope = modified.gradient(x, h)
    found = [0 * x[0]] * system.dim
    for i, j, k, c in zip(*(np.asarray(column).tolist() for column in system.algebra.triples), strict=True):
        found[i] = found[i] + system.sign * c * (x[k] * slope[j])
        found[j] = found[j] - system.sign * c * (x[k] * slope[i])
    return np.array(found, dtype=object)


@pytest.mark.parametrize("seed", long_beyond(2, range(24)))
@pytest.mark.thinned(12)
def test_step_is_the_flow_of_the_modified_hamiltonian(seed):
    system, scheme, modified, x0 = case_of(seed)
    size = max(1.0, float(np.max(np.abs(system.jacobian(x0)))), float(np.max(np.abs(system.vector_field(x0)))))
    for direction in (1, -1):
        errors = []
        with mpmath.workdps(40):
            x = np.array([mpmath.mpf(v) for v in x0], dtype=object)
            for k in (9, 10):
                h = direction * mpmath.mpf(2) ** -k / mpmath.mpf(size)
                end, _ = extrapolated(lambda y, h=h: field_of(system, modified, y, h), x, h)
                errors.append(max(abs(end - scheme.step(system, x, mpmath.mpf(0), h))))
        # Coefficients of irrational schemes, of completed squares and of their roots are rounded to float64.
        if errors[1] > 2.0**-50 * 2.0**-10:
            slope = float(mpmath.log(errors[0] / errors[1], 2))
            assert slope > modified.order + 0.6, (str(scheme), repr(system), slope, errors)
