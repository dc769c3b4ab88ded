"""Vectorized root and minimum search: accuracy, independence and number of evaluations."""

import numpy as np
import pytest

from coadjoint.runs.crossings.root_search import minimize_each, roots

U = 2.0**-53
ROOTS = np.array([1e-12, 1e-3, 0.1, 1 / 3, 0.5, 0.9, 1 - 1e-9])
SHAPES = {
    "straight": lambda d: d,
    "cubic": lambda d: d**3 + 1e-3 * d,
    "flat": lambda d: np.sign(d) * np.abs(d) ** 0.2,
    "steep": lambda d: np.tanh(1e6 * d),
    "exponential": lambda d: np.expm1(20 * d),
    "overflowing": lambda d: np.sign(d) * np.where(np.abs(d) > 0.05, np.inf, np.abs(d)),
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shape", SHAPES)
def test_roots_are_found_independently(shape, sign):
    calls = []

    def values(which, theta):
        calls.append(len(which))
        return sign * SHAPES[shape](theta - ROOTS[which])

    every = np.arange(len(ROOTS))
    found = roots(values, values(every, 0 * ROOTS), values(every, 0 * ROOTS + 1), np.full(len(ROOTS), 2.0**-52))
    assert abs(found - ROOTS).max() <= 2.0**-51
    assert len(calls) < 80
    # The bits of a root depend on its own function alone.
    for k in every:
        own = roots(
            lambda which, theta, k=k: sign * SHAPES[shape](theta - ROOTS[k]),
            sign * SHAPES[shape](0 - ROOTS[k : k + 1]),
            sign * SHAPES[shape](1 - ROOTS[k : k + 1]),
            np.array([2.0**-52]),
        )
        assert own[0] == found[k]


def test_root_at_the_end_of_the_interval():
    found = roots(lambda which, theta: theta - 1.0, np.array([-1.0]), np.array([0.0]), np.array([2.0**-52]))
    assert found[0] == 1.0


def test_smooth_functions_take_few_iterations():
    calls = []

    def values(which, theta):
        calls.append(len(which))
        return np.sin(theta - ROOTS[which])

    every = np.arange(len(ROOTS))
    roots(values, np.sin(-ROOTS), np.sin(1 - ROOTS), np.full(len(every), 2.0**-52))
    assert len(calls) <= 9


def test_minima_are_found():
    theta, value = minimize_each(lambda which, theta: (theta - ROOTS[which]) ** 2 + 1e-3, len(ROOTS))
    assert abs(theta - ROOTS).max() < 2.0**-20 and abs(value - 1e-3).max() < 1e-9
    theta, value = minimize_each(lambda which, theta: (theta - ROOTS[which]) ** 2 - 0.01, len(ROOTS))
    assert (value <= 0).all() and (abs(theta - ROOTS) <= 0.1).all()


def test_each_root_has_its_own_resolution():
    least = np.array([0.05, 2.0**-52, 1e-6])[np.arange(len(ROOTS)) % 3]
    for order in (np.arange(len(ROOTS)), np.arange(len(ROOTS))[::-1]):
        seen = []

        def values(which, theta, order=order, seen=seen):
            seen.extend(which.tolist())
            return np.exp(3.0 * theta) - np.exp(3.0 * ROOTS[order][which])

        every = np.arange(len(ROOTS))
        before, after = (values(every, np.full(len(ROOTS), end)) for end in (0.0, 1.0))
        seen.clear()
        found = roots(values, before, after, least[order])
        assert (np.abs(found - ROOTS[order]) <= 2.0 * least[order] + 2.0**-50).all()
        calls = np.bincount(seen, minlength=len(ROOTS))
        for k in every:
            own = roots(
                lambda which, t, k=k: values(which + k, t), before[k : k + 1], after[k : k + 1], least[order[k : k + 1]]
            )
            assert own[0] == found[k]
        # Half of the digits take fewer values than all of them.
        assert calls[least[order] == 0.05].max() < calls[least[order] == 2.0**-52].max()


def test_minimizations_end_independently():
    """Some reach a value that is not positive at once, some late, some never."""
    depths, minima = np.array([0.5, -1e-6, 1e-3, 0.0, -1.0, 1e-9]), np.array([0.3, 0.4, 0.9, 0.618, 0.1, 0.02])

    def values(which, theta):
        return (theta - minima[which]) ** 2 + depths[which]

    theta, value = minimize_each(values, len(depths))
    assert np.array_equal(value, values(np.arange(len(depths)), theta))
    assert (value[depths < 0.0] <= 0.0).all() and (value[depths > 0.0] > 0.0).all()
    never = depths > 0.0
    assert np.abs(theta - minima)[never].max() < 2.0**-20
    for k in range(len(depths)):
        own, low = minimize_each(lambda which, t, k=k: values(which + k, t), 1)
        assert own[0] == theta[k] and low[0] == value[k]
