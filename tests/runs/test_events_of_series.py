"""Crossings that the Taylor series of a step tells: as many as there are, however many lie in one step."""

import numpy as np
import pytest

import coadjoint as co

U = 2.0**-53
PLANE = co.LieAlgebra.from_brackets(3, {(2, 0): {1: 1.0}, (2, 1): {0: -1.0}})
TURNING = co.LiePoissonSystem(PLANE, co.Quadratic(0.0, linear=[0.0, 0.0, 1.0]), sign=1)
START = np.array([np.cos(-0.7), np.sin(-0.7), 0.0])  # x1 = cos(t - 0.7), x2 = sin(t - 0.7)
METHOD = co.Taylor(order=30, projected=False)


def angles(h, event, end, method=METHOD, **options):
    """Return the angles t - 0.7 at which an event is found with steps h."""
    assert np.allclose(TURNING.vector_field(START), [-START[1], START[0], 0.0])
    found = co.integrate(TURNING, START, (0, end), h, method, events=event, **options).events
    return found.t - 0.7, found.direction


@pytest.mark.parametrize("h", [0.5, 1.5, 3.0])
def test_every_crossing_of_a_product_is_found(h):
    """sin(4 a) as a polynomial: with h = 3 four zeros lie in a step."""
    x, y = (co.Polynomial.variable(i, 3) for i in range(2))
    quartic = 4 * x * y * (x * x - y * y)
    a, direction = angles(h, co.Event(quartic), 9.0)
    want = np.arange(np.ceil(-0.7 / (np.pi / 4)), 8.3 / (np.pi / 4)) * np.pi / 4
    assert len(a) == len(want)
    # Steps of the series round some thirty sums, and times have the round-off of 9.
    assert abs(a - want).max() < 512 * U * 9
    assert (direction == np.where(np.rint(want / (np.pi / 4)) % 2 == 0, 1, -1)).all()


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("h", [0.5, 2.0])
def test_pairs_are_told_apart(width, h):
    event = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -np.cos(width)}))
    a, direction = angles(h, event, 8.0)
    want = np.array([-width, width, 2 * np.pi - width, 2 * np.pi + width])
    assert len(a) == 4 and direction.tolist() == [1, -1, 1, -1]
    assert abs(a - want).max() < 256 * U * 8 / np.sin(width)
    missed = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -1.0 - 1e-12}))
    assert len(angles(h, missed, 8.0)[0]) == 0


def test_neighbours_do_not_tell_as_much():
    """The same steps by a scheme without a series miss what its bound does not promise."""
    x, y = (co.Polynomial.variable(i, 3) for i in range(2))
    quartic = 4 * x * y * (x * x - y * y)
    assert len(angles(3.0, co.Event(quartic), 9.0, co.GaussLegendre(12))[0]) < 11


def test_terminal_within_a_step_of_many():
    x, y = (co.Polynomial.variable(i, 3) for i in range(2))
    quartic = 4 * x * y * (x * x - y * y)
    every, _ = angles(3.0, co.Event(quartic), 9.0)
    for count in (1, 2, 3, 5):
        sol = co.integrate(TURNING, START, (0, 9), 3.0, METHOD, events=co.Event(quartic, count=count, terminal=True))
        assert sol.t[-1] - 0.7 == every[count - 1] and len(sol.events) == count
        several = co.integrate(
            TURNING, [START, -START], (0, 9), 3.0, METHOD, events=co.Event(quartic, count=count, terminal=True)
        )
        assert np.array_equal(several.events.of(0).t, sol.events.t)


def test_other_systems_find_what_short_steps_find():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        g = (co.algebras.so(3), co.algebras.se(3), co.algebras.so(4), co.algebras.get("A4,8"))[seed]
        M = rng.standard_normal((g.dim, g.dim))
        system = co.LiePoissonSystem(g, co.Quadratic(0.2 * (M @ M.T) + np.eye(g.dim)), sign=1)
        x0 = 0.5 * rng.standard_normal(g.dim)
        A = rng.standard_normal((g.dim, g.dim))
        event = co.Event(co.Quadratic(A + A.T, linear=rng.standard_normal(g.dim)))
        long, short = (
            co.integrate(system, x0, (0, 4), h, co.Taylor(order=order), events=event).events
            for h, order in ((0.25, 40), (1 / 256, 16))
        )
        assert len(long) == len(short)
        assert abs(long.t - short.t).max(initial=0.0) < 1e-9
