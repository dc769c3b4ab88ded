"""Functions of users: parts of Hamiltonians, forces, observables and events."""

from __future__ import annotations

import numpy as np


def well(y):
    return 0.5 * y * y + 0.1 * y**4


def well_slope(y):
    return y + 0.4 * y**3


def well_curvature(y):
    return 1.0 + 1.2 * y * y


def driven(y, t):
    return 0.5 * y * y + np.sin(3.0 * t) * y


def driven_slope(y, t):
    return y + np.sin(3.0 * t)


def driven_curvature(y, t):
    return 1.0 + 0.0 * y * t


def damped(x, t, tau):
    return x * np.exp(-0.1 * (2.0 * tau + np.sin(t + tau) - np.sin(t)))


def product(x):
    return x[0] * x[1]


def clock(x, t):
    return x[1] + t


def wave(x, t):
    return np.sin(3.0 * t + x[0])


def corner_product(W):
    return (W.ravel()[1] * W.ravel()[5]).real


def corner_clock(W, t):
    return W.ravel()[1].real + t


def corner_wave(W, t):
    return np.sin(3.0 * t + W.ravel()[1].real)


WELL = (well, well_slope, well_curvature)
DRIVEN = (driven, driven_slope, driven_curvature)
