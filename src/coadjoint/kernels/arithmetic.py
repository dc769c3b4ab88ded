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


# pi/2 in three doubles. For |q| < 2^20 the fused phi - q*P1 is exact; P2 and P3 correct it.
P1 = 1.5707963267948966
P2 = 6.123233995736766e-17
P3 = -1.4973849048591698e-33
TWO_OVER_PI = 0.63661977236758134308
ROUND = 6755399441055744.0  # 1.5 * 2^52: adding and subtracting it rounds to the nearest integer
UNREDUCED = 0.785  # just below pi/4: q is 0
LARGEST_REDUCED = 1.0e6  # |q| < 2^20


@inlined
def _series(r: float) -> tuple[float, float, float]:
    """Return z = r^2, (sin(r)/r - 1)/z and (cos(r) - 1)/z for |r| <= pi/4.

    The minimax polynomials of fdlibm in Estrin's order: every step of a splitting waits for this chain.
    """
    z = r * r
    zz = z * z
    s = fma(z, 8.33333333332248946124e-03, -1.66666666666666324348e-01)
    s = fma(zz, fma(z, 2.75573137070700676789e-06, -1.98412698298579493134e-04), s)
    s = fma(zz * zz, fma(z, 1.58969099521155010221e-10, -2.50507602534068634195e-08), s)
    c = fma(z, 4.16666666666666019037e-02, -0.5)
    c = fma(zz, fma(z, 2.48015872894767294178e-05, -1.38888888888741095749e-03), c)
    high = fma(z, 2.08757232129817482790e-09, -2.75573143513906633035e-07)
    return z, s, fma(zz * zz, fma(zz, -1.13596475577881948265e-11, high), c)


@inlined
def sine_and_cosine_minus_one(phi: float) -> tuple[float, float]:
    """Return sin(phi) and cos(phi) - 1, each within 3 units in the last place up to |phi| = 10^6.

    Cody-Waite reduction; cos - 1 in place of cos, so that a small rotation moves a vector by a small increment that is
    accurate in itself. The branch for small angles only skips what would change no bit of them.
    """
    if abs(phi) <= UNREDUCED:
        z, s, c = _series(phi)
        return fma(phi * z, s, phi), z * c
    if not abs(phi) <= LARGEST_REDUCED:
        half = math.sin(0.5 * phi)
        return math.sin(phi), -2.0 * half * half
    shifted = fma(phi, TWO_OVER_PI, ROUND)
    q = shifted - ROUND
    large, small = fma(-q, P1, phi), -q * P2
    r = large + small
    kept = r - large
    lost = (large - (r - kept)) + (small - kept) + fma(-q, P2, -small)  # by rounding the sum and the product
    tail = fma(-q, P3, lost)
    z, s, c = _series(r)
    sine, lowered = fma(r * z, s, r + tail), fma(-r, tail, z * c)
    quadrant = int(q)
    odd, second, third = quadrant & 1 != 0, quadrant & 2 != 0, (quadrant + 1) & 2 != 0
    sign, turned = -1.0 if second else 1.0, -1.0 if third else 1.0
    below = -1.0 if odd else (-2.0 if second else 0.0)
    return fma(sign, lowered if odd else sine, sign if odd else 0.0), fma(turned, sine if odd else lowered, below)


@inlined
def rational_rotation(phi: float) -> tuple[float, float]:
    """Return sine and cosine minus one of the angle 2 atan(phi/2): a rotation, and rational in phi."""
    half = 0.5 * phi
    sine = phi / fma(half, half, 1.0)
    return sine, -(half * sine)


@inlined
def rational_angle(phi: float, frequency: float) -> float:
    """Return the angle of the generator that a rational rotation of this frequency stands for; phi itself for 0."""
    return 2.0 * math.atan(0.5 * frequency * phi) / frequency if frequency > 0.0 else phi


@inlined
def shortfall(s: float, c: float, square: float) -> float:
    """Return d such that 1 + s D + (c + d) D^2 keeps lengths, for a rounded rotation with D^3 = -square D.

    It is (s^2 - 2 c + c^2 square)/2: rounding, but of one sign where an angle keeps its size, and lengths would then
    drift linearly in time.
    """
    curved = c * square
    power = c * curved
    return 0.5 * (fma(s, s, -2.0 * c) + power + fma(c, curved, -power))


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
