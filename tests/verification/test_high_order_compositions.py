"""Orders 4 to 10: order conditions in the free associative algebra, independent of the library, and slopes.

A symmetric second-order step is exp(h Y1 + h^3 Y3 + ...) with free Y's, a first-order step exp(h Y1 + h^2 Y2 + ...),
its adjoint the inverse of the step over -h.
"""

from itertools import pairwise

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.numerics.splitting_schemes import DEFAULT_SCHEMES, SCHEMES
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.table import build_program
from long import long_between, long_beyond, long_where

from .measures import U

DIGITS = 60
PROCESSED = [name for name, scheme in SCHEMES.items() if scheme.processed]


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
    undone = [sweep._replace(forward=not sweep.forward, coefficient=-sweep.coefficient) for sweep in processor[::-1]]
    sweeps = [*undone, *kernel, *processor]
    if SCHEMES[name].of_second_order:
        pairs = list(zip(sweeps[::2], sweeps[1::2], strict=True))
        # Forward and back over the same time: a symmetric step of order 2 over both.
        assert all(a.forward and not b.forward and a.coefficient == b.coefficient for a, b in pairs)
        steps = [a.coefficient + b.coefficient for a, b in pairs]
        return [{k: c**k for k in range(1, highest + 1, 2)} for c in steps]
    assert not processor
    assert [sweep.forward for sweep in sweeps] == [k % 2 == 0 for k in range(len(sweeps))]
    letters = range(1, highest + 1)
    return [{k: s.coefficient**k if s.forward else -((-s.coefficient) ** k) for k in letters} for s in sweeps]


def defects(name, highest, number=mpmath.mpf):
    """Return the largest difference from exp(Y1) for each weight, and the effect of rounded coefficients."""
    factors = factors_of(name, highest, number)
    product = product_of(factors, highest)
    exact = exponential({k: mpmath.mpf(k == 1) for k in factors[0]}, highest)
    found = [max(abs(product[w] - exact[w]) for w in product if sum(w) == g) for g in range(1, highest + 1)]
    # A condition of weight g sums products of g coefficients, each of which is known to 39 or 49 decimals.
    sizes = product_of([{k: abs(c) for k, c in letters.items()} for letters in factors], highest)
    known = mpmath.mpf(10) ** (-39 if SCHEMES[name].processed else -49) / min(abs(letters[1]) for letters in factors)
    return found, [g * known * max(sizes[w] for w in product if sum(w) == g) for g in range(1, highest + 1)]


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", SCHEMES)
def test_order_conditions_hold(name):
    order = SCHEMES[name].order
    with mpmath.workdps(DIGITS):
        found, bounds = defects(name, order + 1)
        assert all(defect <= bound for defect, bound in zip(found[:order], bounds, strict=False)), found
        assert max(bounds[:order]) < 1e-28
        assert found[order] > 1e-7  # and not one more


@pytest.mark.parametrize("name", ["yoshida4", "blanes_moan6", "sofroniou_spaletta8"])
def test_order_conditions_detect_double_precision(name):
    """The negative control: coefficients with 16 digits instead of 49."""
    with mpmath.workdps(DIGITS):
        found, bounds = defects(name, SCHEMES[name].order, lambda v: mpmath.mpf(float(v)))
        assert any(defect > bound for defect, bound in zip(found, bounds, strict=True))


def heavy_top():
    H = co.Quadratic([1.0, 0.5, 0.375, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    return co.LiePoissonSystem(co.algebras.e(3), H, sign=-1), [1.0, -0.5, 1.5, 0.625, 0.0, 0.75]


def body_in_four_dimensions():
    H = co.Quadratic([2.0, 0.5, 0.75, 0.25, 0.5, 1.0])
    return co.LiePoissonSystem(co.algebras.so(4), H), [1.0, 0.5, -0.375, 0.75, -1.0, 0.25]


def numbers(values):
    return np.array([mpmath.mpf(v) for v in values], dtype=object)


def reading(system, name):
    return Interpreter(build_program(system, co.Splitting(scheme=name, parts="coordinates"), number=mpmath.mpf))


def distance(a, b):
    return max(abs(v) for v in a - b)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("make", long_beyond(1, [heavy_top, body_in_four_dimensions]))
@pytest.mark.parametrize("name", long_between(3, SCHEMES))
def test_local_order_in_50_digits(name, make):
    """One step against two of half the size: h^(p+1) with a relative correction O(h), h = 1/128."""
    with mpmath.workdps(50):
        system, x0 = make()
        read, x0 = reading(system, name), numbers(x0)
        errors = []
        for k in (7, 8):
            h = mpmath.mpf(2) ** -k
            errors.append(distance(read.steps(x0, h, 1), read.steps(x0, h / 2, 2)))
        assert errors[1] > 1e-38  # far above the rounding of the numbers and of the coefficients
        assert abs(mpmath.log(errors[0] / errors[1], 2) - (SCHEMES[name].order + 1)) < 0.15


@pytest.mark.parametrize("order", long_beyond(1, [4, 6, 8, 10]))
def test_global_order_in_50_digits(order):
    """n against 2 n steps over t = 1/4: h^p (1 + O(h^2)), h = 1/16 and 1/32, so within a few per cent of p."""
    with mpmath.workdps(50):
        system, x0 = body_in_four_dimensions()
        read, x0, t = reading(system, DEFAULT_SCHEMES[order]), numbers(x0), mpmath.mpf(1) / 4
        ends = [read.steps(x0, t / n, n) for n in (4, 8, 16)]
        errors = [distance(a, b) for a, b in pairwise(ends)]
        assert abs(mpmath.log(errors[0] / errors[1], 2) - order) < 0.04 * order


POISSON = ["sofroniou_spaletta6", "blanes_moan6", "sofroniou_spaletta10", *PROCESSED]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_where(["blanes_casas_murua8", "blanes_casas_murua10"], POISSON))
def test_poisson_in_40_digits(name):
    with mpmath.workdps(40):
        system, x0 = body_in_four_dimensions()
        x0 = numbers(x0)
        unit = numbers(np.eye(6).ravel()).reshape(6, 6)
        x, P = reading(system, name).steps(x0, mpmath.mpf(1) / 4, 1, tangent=unit)
        defect = P @ system.structure_matrix(x0) @ P.T - system.structure_matrix(x)
        assert np.max(np.abs(defect)) < 1e-35
        assert distance(x, x0) > 0.1
        assert abs(sum(v * v for v in x) - sum(v * v for v in x0)) < 1e-35


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", long_between(3, SCHEMES))
def test_unprocessed_schemes_are_symmetric(name):
    with mpmath.workdps(40):
        system, x0 = heavy_top()
        read, x0, h = reading(system, name), numbers(x0), mpmath.mpf(1) / 4
        defect = distance(read.steps(read.steps(x0, h, 1), -h, 1), x0)
        assert co.Splitting(scheme=name).symmetric == (defect < 1e-35) == (name not in PROCESSED)


def test_processed_scheme_is_symmetric_to_order_plus_two():
    with mpmath.workdps(50):
        system, x0 = heavy_top()
        read, x0 = reading(system, "blanes_casas_murua8"), numbers(x0)
        steps = [mpmath.mpf(2) ** -k for k in (6, 7)]
        large, small = (distance(read.steps(read.steps(x0, h, 1), -h, 1), x0) for h in steps)
        assert abs(mpmath.log(large / small, 2) - 10) < 0.15


@pytest.mark.parametrize("name", [*DEFAULT_SCHEMES.values(), "blanes_moan6", *PROCESSED])
def test_order_in_double_precision_down_to_rounding(name):
    """Rounding is unbiased: it grows like u times the root of the number of flows, and is amplified by less than 16."""
    system, x0 = body_in_four_dimensions()
    method, order, t = co.Splitting(scheme=name), SCHEMES[name].order, 2.0
    exact = co.integrate(system, x0, (0, t), t / 64, co.GaussLegendre(8), save_every=64).x[-1]
    counts, errors, floors = [4, 6, 8, 12, 16, 24, 32, 64, 128, 256], [], []
    for n in counts:
        run = co.integrate(system, x0, (0, t), t / n, method, save_every=n, watch=False)
        errors.append(np.max(np.abs(run.x[-1] - exact)))
        floors.append(16 * U * np.sqrt(run.stats.evaluations) * np.max(np.abs(x0)))
    above = sum(error > 4 * floor for error, floor in zip(errors, floors, strict=True))
    assert above >= 3 and all(error <= 4 * floor for error, floor in zip(errors[above:], floors[above:], strict=True))
    slope = np.log(errors[above - 3] / errors[above - 1]) / np.log(counts[above - 1] / counts[above - 3])
    assert slope > 0.9 * order, (slope, errors)
    if order >= 6:
        assert above < len(errors), errors  # the plateau was reached
