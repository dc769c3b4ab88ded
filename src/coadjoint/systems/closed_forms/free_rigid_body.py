"""Closed-form solution of the free rigid body by Jacobi's elliptic functions, and systems equivalent to it.

Body convention: ``x' = x cross (m x)``, ``A' = A hat(m x)``, m the inverse moments of inertia along the principal axes.
For given L = |x| and energy T the axes are named a, b, c: c is the axis that x encircles, b the middle one, and
``x_a = A_a cn u``, ``x_b = -+A_b sn u``, ``x_c = +-A_c dn u``, ``u = u0 + lam t``. See Whittaker, "Analytical
Dynamics", 69. The attitude follows from the moving frame of e_c cross x and x, which rotates about the constant A x by
an angle that is an integral of the third kind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.numbers import ball, midpoint
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.closed_form import move_state, move_state_and_element
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]

PRINCIPAL_BITS = 256  # for principal axes of a tensor beside those of the phase; nearly equal moments lose bits
MAX_SWEEPS = 24  # of rotations; each squares the small entries, and some five suffice


def _cross_matrix(w: Floats) -> Floats:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def fixed_axis(w: Sequence[Any] | Floats, t: Floats) -> Floats:
    """Return exp(t hat(w)), shape (k, 3, 3), by Rodrigues' formula, accurate for large angles."""
    from flint import arb, ctx

    exact = [Fraction(v) for v in w]
    square = sum((v * v for v in exact), Fraction(0))
    if square == 0:
        return np.broadcast_to(np.eye(3), (t.size, 3, 3)).copy()
    bits = working_bits(t, _root(square), 6.0)
    with ctx.workprec(2 * bits):
        speed = ball(square).sqrt()
        direction = np.array([float(midpoint(ball(v) / speed)) for v in exact])
        _, angles = remainders(speed, 2 * arb.pi(), t, bits)
    K = _cross_matrix(direction)
    angle = angles[:, None, None]
    return np.eye(3) + np.sin(angle) * K + 2.0 * np.sin(0.5 * angle) ** 2 * (K @ K)


def _root(square: Fraction) -> float:
    """Return the square root of a fraction of any size; overflow and underflow only beyond float64."""
    exponent = (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    return math.ldexp(math.sqrt(square / Fraction(4) ** exponent), min(exponent, 1020))


def _frames(x: Floats, axis: int) -> Floats:
    """Return the rows (e_axis cross n, n cross that, n), n = x/|x|, shape (k, 3, 3), in body coordinates."""
    n = x / np.linalg.norm(x, axis=1, keepdims=True)
    first = np.cross(np.eye(3)[axis], n)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first), n], axis=1)


def _along_principal_axes(m: list[Fraction], x0: list[Fraction], t: Floats) -> tuple[Floats, Floats]:
    """Return momentum (k, 3) and attitude (k, 3, 3) of a free rigid body with inverse moments m at t; A(0) = 1."""
    # T, L^2 and differences of 2T and m L^2 are rational: they cancel near the separatrix and permanent rotations.
    pairs = ((0, 1), (1, 2), (0, 2))
    start = np.array([float(v) for v in x0])
    if all(m[i] == m[j] or x0[i] == 0 or x0[j] == 0 for i, j in pairs):
        w = [p * q for p, q in zip(m, x0, strict=True)]
        return np.broadcast_to(start, (t.size, 3)).copy(), fixed_axis(w, t)
    # x(t; 2^e y) = 2^e x(2^e t; y): scaling avoids overflow for momenta of any size.
    exponent = math.frexp(float(np.abs(start).max()))[1]
    y = [v / Fraction(2) ** exponent for v in x0]
    scaled = np.ldexp(t, exponent)
    if not np.isfinite(scaled).all():
        return np.full((t.size, 3), np.nan), np.full((t.size, 3, 3), np.nan)
    x, A = _general(m, y, scaled)
    return np.ldexp(x, exponent), A


def _general(masses: list[Fraction], x0: list[Fraction], t: Floats) -> tuple[Floats, Floats]:
    squares = [v**2 for v in x0]
    length2 = sum(squares, Fraction(0))
    energy2 = sum((p * q for p, q in zip(masses, squares, strict=True)), Fraction(0))
    low, b, high = sorted(range(3), key=lambda i: masses[i])
    c, a = (high, low) if energy2 > masses[b] * length2 else (low, high)
    ma, mb, mc = masses[a], masses[b], masses[c]
    over_c, under_a, under_b = energy2 - mc * length2, ma * length2 - energy2, mb * length2 - energy2
    exact_complement = (ma - mc) * under_b / ((mb - mc) * under_a)
    complement = float(exact_complement)
    exact_nu = -(ma - mb) / (mb - mc)
    nu = float(exact_nu)
    parity = 1.0 if (b - a) % 3 == 1 else -1.0
    sign_a = -1.0 if complement == 0.0 and x0[a] < 0 else 1.0
    sign_c = 1.0 if x0[c] >= 0 else -1.0
    size_a = sign_a * _root(over_c / (ma - mc))
    size_b = sign_a * parity * sign_c * (1.0 if mb > mc else -1.0) * _root(over_c / (mb - mc))
    size_c = sign_c * _root(under_a / (ma - mc))
    cosine, sine = float(x0[a]) / size_a, float(x0[b]) / size_b
    radius = math.hypot(cosine, sine)
    cosine, sine = cosine / radius, sine / radius
    if complement == 0.0:
        exact_complement = Fraction(0)
    turns, psi, factor = _phases(length2, (ma, mc), (mb - mc) * under_a, exact_complement, exact_nu, t)
    if complement == 0.0:
        u0 = math.asinh(sine / cosine)
        u = np.append(u0 + turns, u0)
        sn, cn = np.tanh(u), 2.0 * np.exp(-np.abs(u)) / (1.0 + np.exp(-2.0 * np.abs(u)))
        dn = cn
        root = math.sqrt(-nu)
        third = root * np.arctan(root * sn) / (1.0 - nu)
    else:
        u0 = first_kind(sine, cosine, complement)
        u = np.append(u0 + turns, u0)
        phi = amplitude(u, complement)
        sn, cn = np.sin(phi), np.cos(phi)
        dn = np.sqrt(complement + (1.0 - complement) * cn**2)
        third = -nu / (1.0 - nu) * across_integral(nu, phi, complement)
    x = np.empty((t.size + 1, 3))
    x[:, a], x[:, b], x[:, c] = size_a * cn, size_b * sn, size_c * dn
    # The phases contain the term u/(1 - nu) of the integral of the third kind: near the separatrix phi does not fix u.
    psi = psi + factor * (third[:-1] - third[-1])
    frames = _frames(x, c)
    rotation = np.zeros((t.size, 3, 3))
    rotation[:, 0, 0], rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 1, 1] = (
        np.cos(psi),
        -np.sin(psi),
        np.sin(psi),
        np.cos(psi),
    )
    rotation[:, 2, 2] = 1.0
    return x[:-1], frames[-1].T @ rotation @ frames[:-1]


def _phases(
    length2: Fraction,
    masses: tuple[Fraction, Fraction],
    lam2: Fraction,
    complement: Fraction,
    nu: Fraction,
    t: Floats,
) -> tuple[Floats, Floats, float]:
    """Return u = lam t modulo 4 K, (k,), the rotation psi, and the factor of the integral of the third kind."""
    # psi is the rotation of the moving frame besides the integral over u, modulo 2 pi: its part linear in time, and
    # the gain of the integral over the whole periods.
    from flint import acb, arb, ctx

    ma, mc = masses
    period = 6.0 + 4.0 * abs(math.log(max(float(complement), 1e-300)))
    size = max(_root(lam2), abs(float(ma)), abs(float(mc)))
    bits = working_bits(t, size, min(1.0, _root(lam2) or 1.0))
    with ctx.workprec(4 * bits + abs(math.frexp(period)[1])):
        L, lam = ball(length2).sqrt(), ball(lam2).sqrt()
        factor = L * ball(ma - mc) / lam
        linear = L * ball(mc) + L * ball(ma - mc) / ball(1 - nu)
        gain = arb(0)
        counts = [0] * t.size
        if complement == 0:
            u = np.array([float(midpoint(lam * arb(time))) for time in t.tolist()])
        else:
            square, one = ball(complement), acb(1)
            quarter = arb.pi() / (2 * arb(1).agm(square.sqrt()))
            counts, u = remainders(lam, 4 * quarter, t, bits)
            rest = square / ball(1 - nu)
            over = rest / 3 * acb.elliptic_rj(acb(0), acb(square), one, acb(rest)).real
            gain = -4 * factor * ball(nu / (1 - nu)) * over
        _, psi = remainders(linear, 2 * arb.pi(), t, bits, gain, counts)
        return u, psi, float(factor)


def exact_solution(M: Floats, sign: int, x0: Any, t: Any, attitude: Any = False) -> Any:
    """Return the closed form of ``x' = sign * J(x) M x`` on so(3), M (3,) or (3, 3), at one or several times."""
    return move_state_and_element(3, 3, partial(free_motion, M, sign), x0, t, attitude)


def free_motion(M: Floats, sign: int, start: Floats, times: Floats) -> tuple[Floats, Floats]:
    """Return the momenta (k, 3) of such a body, and its attitudes (k, 3, 3) relative to that at time zero."""
    exact, rotation = [Fraction(v) for v in start.tolist()], np.eye(3)
    if M.ndim == 2 and not np.array_equal(M, np.diag(np.diag(M))):
        bits = PRINCIPAL_BITS + 2 * working_bits(times, float(np.abs(M).max()) * float(np.abs(start).max()), 1.0)
        moments, axes = exact_principal_axes(M, bits)
        exact, rotation = components_along(axes, exact), np.array([[float(v) for v in row] for row in axes])
    else:
        moments = [Fraction(v) for v in (M if M.ndim == 1 else np.diag(M)).tolist()]
    x, A = _along_principal_axes(moments, exact, -sign * times)
    return x @ rotation.T, rotation @ A @ rotation.T


def rigid_body_equivalent(
    constants: tuple[float, float, float],
    masses: tuple[float, float, float],
    casimirs: dict[str, Polynomial],
    name: str,
    parameters: dict[str, Any],
) -> LiePoissonSystem:
    """Return the system ``x1' = (c2 M3 - c3 M2) x2 x3`` and cyclic, ``H = x . M x / 2``, sign -1, with closed form."""
    # `constants` are those of ``[e2, e3] = c1 e1`` and cyclic, nonzero and of one sign; `masses` are the diagonal of M.
    c1, c2, c3 = constants
    return LiePoissonSystem(
        LieAlgebra.from_brackets(3, {(1, 2): {0: c1}, (2, 0): {1: c2}, (0, 1): {2: c3}}, name=f"so(3) of {name}"),
        Quadratic(masses),
        sign=-1,
        casimirs=casimirs,
        name=name,
        parameters=parameters,
        exact=partial(move_state, name, 3, partial(_equivalent_motion, np.array(constants), np.array(masses))),
    )


def _equivalent_motion(constants: Floats, masses: Floats, start: Floats, times: Floats) -> Floats:
    """Return the motion: y_i = x_i sqrt(c_i / c_1) is a rigid body with masses M_i c_1 / c_i in scaled time."""
    ratios = constants / constants[0]
    units = np.sqrt(ratios)
    rate = constants[0] * math.sqrt(ratios[1] * ratios[2])
    moved, _ = free_motion(masses / ratios, -1, start * units, rate * times)
    return moved / units


def amplitude(u: Floats, complement: float) -> Floats:
    """Return Jacobi's amplitude am(u), u (k,), continuous over all periods; `complement` is k'^2 in (0, 1]."""
    # By the arithmetic-geometric mean. The arcsine of (c/a) sin phi (DLMF 22.20.6) is computed as an arctangent with
    # 1 - (c/a)^2 = (b/a)^2, without cancellation near c = a.
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


PHASE_BITS = 96
"""Bits of a phase below one period."""


def working_bits(t: Floats, rate: float, period: float) -> int:
    """Return the number of bits needed for phases at times t (k,), from the magnitudes of rate and period."""
    sizes = [float(np.abs(t).max(initial=0.0)), abs(rate), 1.0 / period]
    return 2 * PHASE_BITS + sum(max(0, math.frexp(size)[1]) for size in sizes if math.isfinite(size))


def remainders(
    rate: Any, period: Any, t: Floats, bits: int, jump: Any = None, jumps: Sequence[int] = ()
) -> tuple[list[int], Floats]:
    """Return the whole periods, nearest integers, in rate * t + jumps * jump for each time, and the remainders (k,)."""
    # `rate`, `jump` and `period` are `arb` of at least `working_bits`; `bits` counts fractional bits.
    rate_units, period_units = (math.floor(midpoint(value) * 2**bits) for value in (rate, period))
    jump_units = 0 if jump is None else math.floor(midpoint(jump) * 2**bits)
    counts, fractions = [], []
    for time, jump_count in zip(t.tolist(), jumps or [0] * t.size, strict=True):
        numerator, denominator = time.as_integer_ratio()
        phase = rate_units * numerator // denominator + jump_units * jump_count
        counts.append((2 * phase + period_units) // (2 * period_units))
        fractions.append((phase - counts[-1] * period_units) / 2**bits)
    return counts, np.array(fractions)


def exact_principal_axes(M: Floats, bits: int) -> tuple[list[Fraction], list[list[Fraction]]]:
    """Return principal moments and axes (columns of a rotation) of a symmetric (3, 3) matrix by Jacobi rotations."""
    # Moments that agree to three quarters of the bits are treated as equal.
    from flint import ctx

    with ctx.workprec(bits + 32):
        A = [[ball(Fraction(v)) for v in row] for row in M.tolist()]
        Q = [[ball(Fraction(int(i == j))) for j in range(3)] for i in range(3)]
        size = max((abs(midpoint(v)) for row in A for v in row), default=Fraction(0))
        for _ in range(MAX_SWEEPS):
            if all(abs(midpoint(A[p][q])) <= size / 2**bits for p, q in ((0, 1), (0, 2), (1, 2))):
                break
            for p, q in ((0, 1), (0, 2), (1, 2)):
                if midpoint(A[p][q]) != 0:
                    _jacobi_rotation(A, Q, p, q)
        moments = [midpoint(A[i][i]) for i in range(3)]
        axes = [[midpoint(v) for v in row] for row in Q]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(moments[i] - moments[j]) <= size / 2 ** (3 * bits // 4):
            moments[j] = moments[i]
    return moments, axes


def _jacobi_rotation(A: list[list[Any]], Q: list[list[Any]], p: int, q: int) -> None:
    """Make entry (p, q) zero by a Jacobi rotation; radii of balls are discarded."""
    slope = (A[q][q] - A[p][p]) / (2 * A[p][q])
    t = 1 / (abs(slope) + (slope * slope + 1).sqrt())
    t = (-t if midpoint(slope) < 0 else t).mid()
    c = (1 / (t * t + 1).sqrt()).mid()
    s, r = (t * c).mid(), 3 - p - q
    A[p][p], A[q][q] = (A[p][p] - t * A[p][q]).mid(), (A[q][q] + t * A[p][q]).mid()
    A[p][q] = A[q][p] = A[p][q] * 0
    new_pr, new_qr = (c * A[p][r] - s * A[q][r]).mid(), (s * A[p][r] + c * A[q][r]).mid()
    A[p][r], A[q][r], A[r][p], A[r][q] = new_pr, new_qr, new_pr, new_qr
    for row in Q:
        row[p], row[q] = (c * row[p] - s * row[q]).mid(), (s * row[p] + c * row[q]).mid()


def components_along(axes: Sequence[Sequence[Fraction]], x: Sequence[Fraction]) -> list[Fraction]:
    """Return the components of a vector along the axes."""
    return [sum((axes[i][c] * x[i] for i in range(3)), Fraction(0)) for c in range(3)]
