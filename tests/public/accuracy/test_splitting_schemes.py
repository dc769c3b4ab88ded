"""Splitting schemes of orders 1 to 10: order conditions in the free associative algebra, symmetry, coefficients.

A symmetric second-order step is exp(h Y1 + h^3 Y3 + ...) with free Y's, a first-order step exp(h Y1 + h^2 Y2 + ...),
its adjoint the inverse of the step over -h.
"""

import re
from itertools import pairwise

import mpmath
import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

DIGITS = 60
NAMES = (
    "strang blanes_moan4 kahan_li4 mclachlan4 suzuki4 yoshida4 blanes_casas_murua6 blanes_moan6 kahan_li6a kahan_li6b"
    " sofroniou_spaletta6 sofroniou_spaletta6_s13 yoshida6 blanes_casas_murua8 kahan_li8a kahan_li8b"
    " sofroniou_spaletta8 suzuki_umeno8 blanes_casas_murua10 kahan_li10a kahan_li10d sofroniou_spaletta10"
).split()
ORDERS = {name: 2 if name == "strang" else int(re.search(r"\d+", name)[0]) for name in NAMES}
DEFAULTS = {2: "strang", 4: "suzuki4", 6: "sofroniou_spaletta6", 8: "sofroniou_spaletta8", 10: "sofroniou_spaletta10"}
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


def heavy_top():
    H = co.Quadratic([1.0, 0.5, 0.375, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    return co.LiePoissonSystem(co.algebras.e(3), H, sign=-1), [1.0, -0.5, 1.5, 0.625, 0.0, 0.75]


def numbers(values):
    return np.array([mpmath.mpf(v) for v in values], dtype=object)


def stepped(system, name, x, h, count=1):
    """Take steps in the number type of x and h."""
    for _ in range(count):
        x = co.Splitting(scheme=name, parts="coordinates").step(system, x, 0, h)
    return x


def distance(a, b):
    return max(abs(v) for v in a - b)


def test_processed_scheme_is_symmetric_to_order_plus_two():
    with mpmath.workdps(50):
        (system, x0), name = heavy_top(), "blanes_casas_murua8"
        x0 = numbers(x0)
        steps = [mpmath.mpf(2) ** -k for k in (6, 7)]
        large, small = (distance(stepped(system, name, stepped(system, name, x0, h), -h), x0) for h in steps)
        assert abs(mpmath.log(large / small, 2) - 10) < 0.15


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
        assert abs(sum(fractions) - whole) <= UNIT_ROUNDOFF * size
    with mpmath.workdps(40):
        for a, b in zip(method.sweeps(mpmath.mpf), method.sweeps(), strict=True):
            assert abs(a.coefficient - b.coefficient) <= 2 * UNIT_ROUNDOFF * abs(a.coefficient)


def test_defaults_and_equality():
    for order, name in DEFAULTS.items():
        assert co.Splitting(order=order).sweeps() == co.Splitting(scheme=name).sweeps()
    assert not co.Splitting(order=1).symmetric
    assert co.Splitting(order=4) == co.Splitting(order=4) and hash(co.Splitting(parts=[[0], [1, 2]]))


PLANE = co.PoissonSystem(
    lambda x: np.array([[0.0, 1.0 + x[0] ** 2], [-1.0 - x[0] ** 2, 0.0]]), co.Quadratic([1.0, 2.0]), name="warped plane"
)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("options", "error", "named"),
    [
        ({"order": 3}, ValueError, ("orders", "3")),
        ({"scheme": "suzuky4"}, ValueError, ("scheme", "'suzuky4'", "'suzuki4'")),
        ({"scheme": "strang", "order": 4}, ValueError, ("'strang'", "4")),
        ({"adjoint": True}, ValueError, ("adjoint", "order 1")),
        ({"rotation": "exactly"}, ValueError, ("rotation", "'exactly'", "'exact'")),
        ({"parts": "coordinate"}, ValueError, ("parts", "'coordinate'", "'coordinates'")),
        ({"parts": [0, 1, 2]}, TypeError, ("sets of coordinates",)),
        ({"parts": [[0.5], [1]]}, ValueError, ("parts", "0.5")),
    ],
)
def test_refusals(options, error, named):
    with refused(error, *named):
        co.Splitting(**options)


def test_systems_and_compositions_that_are_refused():
    with refused(ValueError, "Splitting", "Lie algebra", "warped plane"):
        co.integrate(PLANE, (1.0, 0.0), (0, 1), 0.1, co.Splitting())
    for name in PROCESSED:
        with refused(ValueError, "symmetric base", name):
            co.Composition(co.Splitting(scheme=name), (0.5, 0.5))
