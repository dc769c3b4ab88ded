"""Rounding of systems whose parts differ in size, against the same steps in 50 digits."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from mpmath import mp

import coadjoint as co
from coadjoint.systems.canonical import canonical_state

STEPS, DIGITS = 6, 50
RATIOS = (1.0, 1e4, 1e8, 1e12)


def two_stages(f: Any, x0: Any, h: float) -> Any:
    """Take steps of the Gauss-Legendre method of two stages in 50 digits, from its textbook tableau."""
    with mp.workdps(DIGITS):
        root, step = mp.sqrt(3) / 6, mp.mpf(h)
        quarter = mp.mpf(1) / 4
        x = np.array([mp.mpf(float(value)) for value in x0], dtype=object)
        for _ in range(STEPS):
            first = second = f(x)
            for _ in range(300):
                before = first, second
                first, second = (
                    f(x + step * (quarter * first + (quarter - root) * second)),
                    f(x + step * ((quarter + root) * first + quarter * second)),
                )
                moved = itertools.chain(*(zip(a, b, strict=True) for a, b in zip((first, second), before, strict=True)))
                if all(abs(a - b) <= mp.mpf(10) ** -38 * abs(b) for a, b in moved):
                    break
            x = x + step * (first + second) / 2
        return x


def spins(ratio: float) -> Any:
    M = np.diag([1.0, 0.5, 0.3, 0.7, 0.2, 0.9])
    M[:3, 3:] = [[0.1, 0.2, 0.3], [0.2, 0.4, 0.1], [0.3, 0.1, 0.5]]
    M[3:, :3] = M[:3, 3:].T
    system = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic(M))
    return system, np.r_[np.array([0.3, -0.8, 0.5]) / ratio, 0.9, 0.2, -0.7], 0.1, ((0, 1, 2), (3, 4, 5))


def heavy_top(ratio: float) -> Any:
    x0 = np.r_[0.4, -0.3, 1.1, np.array([0.2, 0.5, -0.9]) * ratio]
    return co.systems.heavy_top(inertia=(1, 2, 2.5)), x0, 0.05 / np.sqrt(ratio), ((0, 1, 2), (3, 4, 5))


def pendulum(ratio: float) -> Any:
    q = np.array([[0.6, 0.0, -0.8], [0.0, 0.28, 0.96]])
    p = np.cross(q, [[0.3, 1.0, -0.2], [1.1, -0.4, 0.5]]) / [[1.0], [ratio]]
    system = co.systems.double_spherical_pendulum(masses=(1.0, 1 / ratio))
    return system, np.r_[q.ravel(), p.ravel(), 1.0], 0.02, tuple(tuple(range(k, k + 3)) for k in (0, 3, 6, 9))


def particles(ratio: float) -> Any:
    moments = [0.5, 0.1, 0.3, 0.2 / ratio, 0.05 / ratio, 0.1 / ratio]
    x0 = canonical_state([1.0, -0.5], [0.3, 0.1 / ratio], moments)
    system = co.systems.decorated_particles(weights=(1.0, 1 / ratio))
    return system, x0, 0.05, ((0, 1), (2,), (3,), (5, 6, 7), (8, 9, 10))


def gyrostat(ratio: float) -> Any:
    system = co.systems.gyrostat(inertia=(1, 2, 2.5), rotors=(0.3 * ratio, 0.2 * ratio, -0.5 * ratio))
    return system, np.array([0.7, -0.4, 0.9]) * ratio, 0.1 / ratio, ((0, 1, 2),)


def body_in_fluid(ratio: float) -> Any:
    system = co.systems.kirchhoff_body(inertia=(1, 2, 2.5), mass=(ratio, 1.5 * ratio, 2 * ratio))
    x0 = np.r_[0.4, -0.3, 1.1, np.array([0.2, 0.5, -0.9]) * np.sqrt(ratio)]
    return system, x0, 0.05, ((0, 1, 2), (3, 4, 5))


def satellite(ratio: float) -> Any:
    system = co.systems.satellite(inertia=(1.0, 2.0, 2.5), mass=ratio)
    x0 = np.r_[0.1, -0.2, 0.3, np.array([0.2, 0.9, -0.1]) * ratio, 1.5, -0.4, 0.3, 1.0]
    return system, x0, 0.05, ((0, 1, 2), (3, 4, 5), (6, 7, 8))


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("make", [spins, heavy_top, pendulum, particles, gyrostat, body_in_fluid, satellite])
def test_each_group_has_the_rounding_errors_of_its_own_size(make: Any, ratio: float) -> None:
    # A step is some ten products and sums of each component, each rounded once.
    system, x0, h, groups = make(ratio)
    end = co.integrate(system, x0, (0, STEPS * h), h, co.GaussLegendre(2)).x[-1]
    exact = two_stages(system.vector_field, x0, h)
    error = np.array([float(mp.mpf(a) - b) for a, b in zip(end.tolist(), exact, strict=True)])
    for group in map(list, groups):
        assert np.abs(error[group]).max() <= 8 * STEPS * 2.0**-53 * np.abs(end[group]).max()
