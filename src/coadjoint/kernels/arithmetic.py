"""Elementary arithmetic of the kernels: fused multiply-add, sine with cosine minus one, and their hyperbolic kin."""

from __future__ import annotations

import math
from typing import Any

from numba import types
from numba.extending import intrinsic

from coadjoint.kernels.compiling import inlined


@intrinsic
def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a*b + c rounded once; written out, so that the bits do not depend on the optimiser."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), codegen


# pi/2 in three pieces of at most 33 + 33 + 53 bits: q*P1 and q*P2 are exact for |q| < 2^20.
P1 = 1.57079632673412561417e00
P2 = 6.07710050630396597660e-11
P3 = 2.02226624879595063154e-21
TWO_OVER_PI = 0.63661977236758134308
ROUND = 6755399441055744.0  # 1.5 * 2^52: adding and subtracting it rounds to the nearest integer
LARGEST_REDUCED = 1.0e6  # |q| < 2^20


@inlined
def sine_and_cosine_minus_one(phi: float) -> tuple[float, float]:
    """Return sin(phi) and cos(phi) - 1, each within 3 units in the last place; branch-free up to |phi| = 10^6.

    Cody-Waite reduction and the minimax polynomials of fdlibm; cos - 1 in place of cos, so that a small
    rotation moves a vector by a small increment that is accurate in itself.
    """
    if not abs(phi) <= LARGEST_REDUCED:
        half = math.sin(0.5 * phi)
        return math.sin(phi), -2.0 * half * half
    shifted = fma(phi, TWO_OVER_PI, ROUND)
    q = shifted - ROUND
    quadrant = int(q)
    r = fma(-q, P1, phi)
    r = fma(-q, P2, r)
    r = fma(-q, P3, r)
    z = r * r
    s = fma(z, 1.58969099521155010221e-10, -2.50507602534068634195e-08)
    s = fma(z, s, 2.75573137070700676789e-06)
    s = fma(z, s, -1.98412698298579493134e-04)
    s = fma(z, s, 8.33333333332248946124e-03)
    s = fma(z, s, -1.66666666666666324348e-01)
    sine = fma(r * z, s, r)
    c = fma(z, -1.13596475577881948265e-11, 2.08757232129817482790e-09)
    c = fma(z, c, -2.75573143513906633035e-07)
    c = fma(z, c, 2.48015872894767294178e-05)
    c = fma(z, c, -1.38888888888741095749e-03)
    c = fma(z, c, 4.16666666666666019037e-02)
    lowered = z * fma(z, c, -0.5)  # cos(r) - 1
    odd = quadrant & 1
    flip_sine = quadrant & 2
    flip_cosine = (quadrant + 1) & 2
    cosine = 1.0 + lowered
    a = cosine if odd else sine
    b = sine if odd else cosine
    exact = lowered if quadrant & 3 == 0 else (-b if flip_cosine else b) - 1.0
    return (-a if flip_sine else a), exact


@inlined
def entire_pair(z: float) -> tuple[float, float]:
    """Return sinh(w)/w and cosh(w) - 1 for w*w = z of either sign: one smooth function, no discriminant to decide.

    Near z = 0 by the series (its first neglected term is below 2^-53 of the sum), elsewhere by sine or sinh.
    """
    if abs(z) < 0.25:
        s = 1.0
        c = 1.0
        for k in range(9, 0, -1):
            s = fma(s, z / (2.0 * k * (2.0 * k + 1.0)), 1.0)
            c = fma(c, z / ((2.0 * k + 1.0) * (2.0 * k + 2.0)), 1.0)
        return s, 0.5 * z * c
    if z < 0.0:
        w = math.sqrt(-z)
        sine, lowered = sine_and_cosine_minus_one(w)
        return sine / w, lowered
    w = math.sqrt(z)
    half = math.sinh(0.5 * w)
    return math.sinh(w) / w, 2.0 * half * half
