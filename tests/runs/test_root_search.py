"""Roots of many functions at once: right to round-off, each for itself, in few evaluations."""

import numpy as np
import pytest

from coadjoint.runs.root_search import lowest, roots

U = 2.0**-53
PLACES = np.array([1e-12, 1e-3, 0.1, 1 / 3, 0.5, 0.9, 1 - 1e-9])
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
def test_roots_are_found(shape, sign):
    calls = []

    def values(which, theta):
        calls.append(len(which))
        return sign * SHAPES[shape](theta - PLACES[which])

    every = np.arange(len(PLACES))
    found = roots(values, values(every, 0 * PLACES), values(every, 0 * PLACES + 1), np.full(len(PLACES), 2.0**-52))
    assert abs(found - PLACES).max() <= 2.0**-51
    assert len(calls) < 80
    # The bits of a root depend on its own function alone.
    for k in every:
        own = roots(
            lambda which, theta, k=k: sign * SHAPES[shape](theta - PLACES[k]),
            sign * SHAPES[shape](0 - PLACES[k : k + 1]),
            sign * SHAPES[shape](1 - PLACES[k : k + 1]),
            np.array([2.0**-52]),
        )
        assert own[0] == found[k]


def test_a_root_at_the_end():
    found = roots(lambda which, theta: theta - 1.0, np.array([-1.0]), np.array([0.0]), np.array([2.0**-52]))
    assert found[0] == 1.0


def test_smooth_functions_take_few_rounds():
    calls = []

    def values(which, theta):
        calls.append(len(which))
        return np.sin(theta - PLACES[which])

    every = np.arange(len(PLACES))
    roots(values, np.sin(-PLACES), np.sin(1 - PLACES), np.full(len(every), 2.0**-52))
    assert len(calls) <= 9


def test_the_lowest_point():
    theta, value = lowest(lambda which, theta: (theta - PLACES[which]) ** 2 + 1e-3, len(PLACES))
    assert abs(theta - PLACES).max() < 2.0**-20 and abs(value - 1e-3).max() < 1e-9
    theta, value = lowest(lambda which, theta: (theta - PLACES[which]) ** 2 - 0.01, len(PLACES))
    assert (value <= 0).all() and (abs(theta - PLACES) <= 0.1).all()
