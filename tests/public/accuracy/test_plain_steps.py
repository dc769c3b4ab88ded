"""Runs agree with steps of `Method.step` in 40 digits and in long steps, and sum without rounding."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from digests.schemes_under_test import EXAMPLES, schemes, serves, witnesses
from rounding import UNIT_ROUNDOFF


@pytest.mark.thinned(4)
@pytest.mark.parametrize("scheme", list(schemes()))
def test_runs_agree_with_steps_in_forty_digits(scheme):
    """On systems without Python functions, which can be evaluated in multiprecision; of matrices steps are floats."""
    method = schemes()[scheme]
    for system, x0, _ in witnesses(method, "A3,7, full", "e(3), heavy top"):
        if isinstance(system, co.MatrixSystem):
            continue
        with mpmath.workdps(40):
            x, h = np.array([mpmath.mpf(v) for v in x0], dtype=object), mpmath.mpf(0.125)
            exact = method.step(system, method.step(system, x, mpmath.mpf(0), h), h, h).astype(float)
        run = co.integrate(system, x0, (0.0, 0.25), 0.125, method)
        bound = 4 * len(x0) * UNIT_ROUNDOFF * (run.stats.evaluations + 3) * np.max(np.abs(run.x))
        assert np.max(np.abs(exact - run.x[-1])) <= bound, system.name


LINEAR = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25], linear=[0.5, -0.25, 1.0]))


@pytest.mark.thinned(4)
@pytest.mark.parametrize("scheme", [one for one in EXAMPLES if not one.explicit and serves(one, LINEAR)], ids=str)
def test_steps_in_hundreds_of_digits(scheme):
    """Iterations take as many rounds as their digits need: a step in more digits agrees in all of them."""
    case = witnesses(scheme, "so(3), diagonal")[0]
    ends = []
    for digits in (320, 330):
        with mpmath.workdps(digits):
            x = np.array([mpmath.mpf(v) for v in case.x0], dtype=object)
            ends.append(scheme.step(case.system, x, mpmath.mpf(0), mpmath.mpf(0.125)))
    with mpmath.workdps(330):
        assert max(abs(a - b) for a, b in zip(*ends, strict=True)) < mpmath.mpf(10) ** -316


def test_long_steps_of_large_states_are_those_in_numpy():
    """Of every scheme with the options of its examples, and of compositions, where no iteration is short."""
    compared = set()
    for scheme in EXAMPLES + COMPOSED:
        for system, x0, _ in witnesses(scheme, "A3,7, full", "e(3), heavy top", "so(3), diagonal"):
            for h in (0.4, -0.7):
                x = np.asarray(x0) * (0.5 if isinstance(system, co.MatrixSystem) else 2.0)
                try:
                    with np.errstate(all="ignore"):
                        wanted = scheme.step(system, x, -3.25, h)
                    found = co.stepper(system, scheme, h)(x, -3.25)
                except (co.IntegrationError, ValueError):  # too long for one of the iterations
                    continue
                # Some ten stages, of which each has some hundred operations, and grows the rounding of the last ones.
                bound = 2**14 * UNIT_ROUNDOFF * np.abs(wanted).max()
                np.testing.assert_allclose(found, wanted, rtol=0, atol=bound, err_msg=f"{scheme}, {system.name}, {h}")
                compared.add(str(scheme))
    assert compared == {str(scheme) for scheme in EXAMPLES + COMPOSED}


HEISENBERG = co.LiePoissonSystem(co.algebras.get("A3,1"), co.Quadratic(np.zeros(3), linear=[0.0, 0.3, 0.0]))
# Steps of other schemes are several increments, each of them rounded to the size of the state.
SUMMED_PLAINLY = co.Splitting, co.Projected, co.ReversibleSteps


def sums_plainly(method):
    base = method.base if isinstance(method, co.Composition) else method
    return isinstance(base, SUMMED_PLAINLY) and not getattr(base, "compensated", False)


def test_schemes_sum_their_increments_without_rounding():
    """A constant field, of which every scheme has the exact increment: 3000 of them are off by a unit of the sum."""
    x0, h, steps = np.array([1.0, 0.4, 0.7]), 0.1, 3000
    rate = HEISENBERG.vector_field(x0)[2]
    exact = Fraction(x0[2]) + steps * Fraction(h) * Fraction(rate)
    methods = schemes() | {f"example {one}": one for one in EXAMPLES if not one.own_steps}
    methods = {name: method for name, method in methods.items() if serves(method, HEISENBERG)}
    rounded = set()
    for name, method in methods.items():
        end = co.integrate(HEISENBERG, x0, (0, steps * h), h, method, save_every=steps, watch=False).x[-1]
        # Rounding of the increment in each step, once or twice, and of the sum.
        if abs((Fraction(end[2]) - exact) / exact) > 4 * UNIT_ROUNDOFF:
            rounded.add(name)
    assert rounded == {name for name, method in methods.items() if sums_plainly(method)}


def test_schemes_of_matrices_sum_their_increments_without_rounding():
    """3000 conjugations keep the sum of the squares to rounding of the last state, in a motion without order."""
    flow, rng = co.systems.torus_euler(N=5), np.random.default_rng(1)
    W = flow.algebra.projected(rng.normal(size=flow.shape) + 1j * rng.normal(size=flow.shape))
    compared = 0
    for scheme in EXAMPLES:
        if serves(scheme, flow):
            end = co.integrate(flow, W, (0, 60), 0.02, scheme, save_every=3000, watch=False).x[-1]
            change = np.sum(np.abs(end) ** 2) / np.sum(np.abs(W) ** 2) - 1.0
            assert abs(change) < 16 * UNIT_ROUNDOFF, (scheme, change / UNIT_ROUNDOFF)
            assert np.abs(end - W).max() > 0.1
            compared += 1
    assert compared >= 6
