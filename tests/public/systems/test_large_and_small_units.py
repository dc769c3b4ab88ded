"""Physical numbers of any units: the Sun in kilograms, atoms in kilograms, and what leaves float64."""

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond

S = co.systems
SUN, EARTH, G, AU = 1.98892e30, 5.9722e24, 6.6743e-11, 1.495978707e11  # in SI units


def test_the_earth_around_the_sun_in_si_units():
    """A Kepler orbit of two point masses in closed form: a quarter of a year, on a circle."""
    pair = S.gravitating_bodies(inertias=((0, 0, 0), (0, 0, 0)), masses=(SUN, EARTH), G=G, order=0)
    total, rate = SUN + EARTH, np.sqrt(G * (SUN + EARTH) / AU**3)
    places = np.array([[-EARTH / total * AU, 0, 0], [SUN / total * AU, 0, 0]])
    x0 = pair.state(places, rate * places[:, [1, 0, 2]])
    quarter = np.pi / 2 / rate
    sol = co.integrate(pair, x0, (0.0, quarter), quarter / 200, co.Splitting(order=4))
    # The order of the scheme: 4 in the angle of a step, 0.008 radians.
    assert np.abs(pair.positions(sol.x[-1]) - places[:, [1, 0, 2]]).max() < 1e-8 * AU
    assert sol.drift()["energy"] < 1e-9


@pytest.mark.parametrize("unit", long_beyond(1, [1e30, 1e-7]))
def test_units_do_not_change_a_pendulum(unit):
    """Masses and lengths in other units, with gravity in those of length: the same angles, to the rounding of steps."""
    states = []
    for factor in (1.0, unit):
        pendulum = S.double_spherical_pendulum((factor, 0.5 * factor), (1.0, 0.7), 9.81)
        q, p = np.array([0.6, 0.0, -0.8, 0.0, 0.42, -0.56]), factor * np.array([0.0, 0.3, 0.0, 0.2, 0.0, 0.0])
        x = co.integrate(pendulum, np.array([*q, *p, 1.0]), (0.0, 1.0), 0.01, co.GaussLegendre(2)).x[-1]
        states.append(x / np.array([*np.ones(6), *np.full(6, factor), 1.0]))
    assert np.abs(states[0] - states[1]).max() < 1e-11
