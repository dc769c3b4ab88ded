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

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.closed_form import (
    check_finite_states,
    initial_group_element,
    reject_attitude,
    start_and_times,
    with_group_element,
)
from coadjoint.systems.closed_forms.elliptic_integrals import across_integral, amplitude, first_kind
from coadjoint.systems.closed_forms.phase_reduction import (
    ball,
    components_along,
    exact_principal_axes,
    fraction_of,
    remainders,
    working_bits,
)
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = npt.NDArray[np.float64]

PRINCIPAL_BITS = 256  # for principal axes of a tensor beside those of the phase; nearly equal moments lose bits


def _cross_matrix(w: Floats) -> Floats:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def fixed_axis(w: Sequence[Any] | Floats, t: Floats) -> Floats:
    """Return exp(t hat(w)), shape (k, 3, 3), by Rodrigues' formula, accurate for large angles."""
    from flint import arb, ctx

    exact = [Fraction(float(v) if isinstance(v, np.floating) else v) for v in w]
    square = sum((v * v for v in exact), Fraction(0))
    if square == 0:
        return np.broadcast_to(np.eye(3), (t.size, 3, 3)).copy()
    bits = working_bits(t, _root(square), 6.0)
    with ctx.workprec(2 * bits):
        speed = ball(square).sqrt()
        direction = np.array([float(fraction_of(ball(v) / speed)) for v in exact])
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


def free_rigid_body(m: Floats, x0: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return momentum (k, 3) and attitude (k, 3, 3) of a free rigid body with inverse moments m at t; A(0) = 1."""
    # T, L^2 and differences of 2T and m L^2 are rational: they cancel near the separatrix and permanent rotations.
    return _along_principal_axes([Fraction(v) for v in m.tolist()], [Fraction(v) for v in x0.tolist()], t)


def _along_principal_axes(m: list[Fraction], x0: list[Fraction], t: Floats) -> tuple[Floats, Floats]:
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
    phases = _Phases(length2, (ma, mc), (mb - mc) * under_a, exact_complement, exact_nu, t)
    if complement == 0.0:
        u0 = math.asinh(sine / cosine)
        u = np.append(u0 + phases.u, u0)
        sn, cn = np.tanh(u), 2.0 * np.exp(-np.abs(u)) / (1.0 + np.exp(-2.0 * np.abs(u)))
        dn = cn
        root = math.sqrt(-nu)
        third = root * np.arctan(root * sn) / (1.0 - nu)
    else:
        u0 = first_kind(sine, cosine, complement)
        u = np.append(u0 + phases.u, u0)
        phi = amplitude(u, complement)
        sn, cn = np.sin(phi), np.cos(phi)
        dn = np.sqrt(complement + (1.0 - complement) * cn**2)
        third = -nu / (1.0 - nu) * across_integral(nu, phi, complement)
    x = np.empty((t.size + 1, 3))
    x[:, a], x[:, b], x[:, c] = size_a * cn, size_b * sn, size_c * dn
    # The phases contain the term u/(1 - nu) of the integral of the third kind: near the separatrix phi does not fix u.
    psi = phases.psi + phases.factor * (third[:-1] - third[-1])
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


class _Phases:
    """Phases of a body: `u` is lam t modulo 4 K, (k,); `factor` multiplies the integral of the third kind."""

    # `psi` is the rotation of the moving frame besides the integral over u, modulo 2 pi: its part linear in time, and
    # the gain of the integral over the whole periods.

    def __init__(
        self,
        length2: Fraction,
        masses: tuple[Fraction, Fraction],
        lam2: Fraction,
        complement: Fraction,
        nu: Fraction,
        t: Floats,
    ) -> None:
        from flint import acb, arb, ctx

        ma, mc = masses
        period = 6.0 + 4.0 * abs(math.log(max(float(complement), 1e-300)))
        size = max(_root(lam2), abs(float(ma)), abs(float(mc)))
        bits = working_bits(t, size, min(1.0, _root(lam2) or 1.0))
        with ctx.workprec(4 * bits + abs(math.frexp(period)[1])):
            L, lam = ball(length2).sqrt(), ball(lam2).sqrt()
            factor = L * ball(ma - mc) / lam
            self.factor = float(factor)
            linear = L * ball(mc) + L * ball(ma - mc) / ball(1 - nu)
            gain = arb(0)
            counts = [0] * t.size
            if complement == 0:
                self.u = np.array([float(fraction_of(lam * arb(time))) for time in t.tolist()])
            else:
                square, one = ball(complement), acb(1)
                quarter = arb.pi() / (2 * arb(1).agm(square.sqrt()))
                counts, self.u = remainders(lam, 4 * quarter, t, bits)
                rest = square / ball(1 - nu)
                over = rest / 3 * acb.elliptic_rj(acb(0), acb(square), one, acb(rest)).real
                gain = -4 * factor * ball(nu / (1 - nu)) * over
            _, self.psi = remainders(linear, 2 * arb.pi(), t, bits, gain, counts)


def exact_solution(M: Floats, sign: int, x0: Any, t: Any, attitude: Any = False) -> Any:
    """Return the closed form of ``x' = sign * J(x) M x`` on so(3), M (3,) or (3, 3), at one or several times."""
    start, times = start_and_times(x0, t, 3)
    first = initial_group_element(attitude, 3)
    exact, rotation = [Fraction(v) for v in start.tolist()], np.eye(3)
    if M.ndim == 2 and not np.array_equal(M, np.diag(np.diag(M))):
        bits = PRINCIPAL_BITS + 2 * working_bits(times, float(np.abs(M).max()) * float(np.abs(start).max()), 1.0)
        moments, axes = exact_principal_axes(M, bits)
        exact, rotation = components_along(axes, exact), np.array([[float(v) for v in row] for row in axes])
    else:
        moments = [Fraction(v) for v in (M if M.ndim == 1 else np.diag(M)).tolist()]
    with np.errstate(over="ignore", invalid="ignore"):
        x, A = _along_principal_axes(moments, exact, -sign * np.atleast_1d(times))
        x, A = x @ rotation.T, first @ (rotation @ A @ rotation.T)
    x, A = (check_finite_states(part, start, times) for part in (x, A))
    if times.ndim == 0:
        x, A = x[0], A[0]
    return with_group_element(x, A, attitude)


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
        exact=partial(_exact, np.array(constants), np.array(masses), name),
    )


def _exact(constants: Floats, masses: Floats, name: str, x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Return the closed form: y_i = x_i sqrt(c_i / c_1) is a rigid body with masses M_i c_1 / c_i in scaled time."""
    reject_attitude(attitude, name)
    start, times = start_and_times(x0, t, 3)
    ratios = constants / constants[0]
    units = np.sqrt(ratios)
    rate = constants[0] * math.sqrt(ratios[1] * ratios[2])
    x: Floats = exact_solution(masses / ratios, -1, start * units, rate * times) / units
    return x
