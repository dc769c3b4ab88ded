"""Jacobi's amplitude and elliptic integrals in terms of the complement k'^2 = 1 - k^2, accurate also if it is tiny."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def amplitude(u: Floats, complement: float) -> Floats:
    """Return Jacobi's amplitude am(u), u (k,), continuous over all periods, by the arithmetic-geometric mean.

    The arcsine of (c/a) sin phi (DLMF 22.20.6) is computed as an arctangent with 1 - (c/a)^2 = (b/a)^2, without
    cancellation near c = a. `complement` is k'^2 in (0, 1].
    """
    a, b = 1.0, math.sqrt(complement)
    means = []
    while abs(a - b) > 2.0**-50 * a:
        a, b, c = 0.5 * (a + b), math.sqrt(a * b), 0.5 * (a - b)
        means.append((a, b, c))
    phi = u * (a * 2.0 ** len(means))
    for a, b, c in reversed(means):
        phi = 0.5 * (phi + np.arctan2(c / a * np.sin(phi), np.hypot(np.cos(phi), b / a * np.sin(phi))))
    return phi


def first_kind(sine: float, cosine: float, complement: float) -> float:
    """Return F(phi, k), -pi < phi <= pi, from sin phi and cos phi, by Carlson's R_F; `complement` is 1 - k^2."""
    from scipy.special import elliprf

    part = sine * float(elliprf(cosine**2, cosine**2 + complement * sine**2, 1.0))
    if cosine >= 0.0:
        return part
    return math.copysign(2.0 * float(elliprf(0.0, complement, 1.0)), sine) - part


def across_integral(nu: float, phi: Floats, complement: float) -> Floats:
    """Return the integral of cos^2/((1 - nu sin^2) sqrt(1 - k^2 sin^2)) from 0 to phi, nu <= 0; bounded near k = 1."""
    # The integral of the third kind is (u - nu * this)/(1 - nu).
    from scipy.special import elliprc, elliprj

    half_turns = np.rint(phi / math.pi)
    sine, cosine = np.sin(phi), np.abs(np.cos(phi))
    sine = np.where(half_turns % 2 == 0, sine, -sine)
    delta, rest = cosine**2 + complement * sine**2, complement / (1.0 - nu)
    # DLMF 19.21.12, a sum of positive terms, avoids the cancellation of a difference of integrals.
    other = cosine**2 + rest * sine**2
    part = cosine * elliprc(delta, (1.0 - nu * sine**2) * other)
    part += rest * sine**2 / 3.0 * elliprj(cosine**2, delta, 1.0, other)
    complete = rest / 3.0 * float(elliprj(0.0, complement, 1.0, rest))
    return np.asarray(2.0 * complete * half_turns + sine * part)
