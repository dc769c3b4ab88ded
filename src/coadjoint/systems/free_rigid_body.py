"""The free rigid body in closed form, by Jacobi's elliptic functions.

Body convention: ``x' = x cross (m x)``, ``A' = A hat(m x)``, m the inverse moments of inertia along the principal axes.
For given conserved L = |x| and T the axes are named a, b, c: c is the axis that x encircles, b the middle one, and
``x_a = A_a cn u``, ``x_b = -+A_b sn u``, ``x_c = +-A_c dn u``, ``u = u0 + lam t``. See Whittaker, "Analytical
Dynamics", 69. The attitude follows from the moving frame of e_c cross x and x, which turns about the constant A x by an
angle that is an integral of the third kind.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.given import read_finite
from coadjoint.systems.closed_form import all_finite, start_and_times

Floats = npt.NDArray[np.float64]


def amplitude(u: Floats, complement: float) -> Floats:
    """Return Jacobi's amplitude am(u), continuous over all periods, by the arithmetic-geometric mean.

    Parameters
    ----------
    u : (k,)
        Arguments.
    complement : float
        k'^2 = 1 - k^2, in (0, 1]; given in place of k^2 so that it may be tiny.

    Returns
    -------
    (k,) array

    Notes
    -----
    DLMF 22.20.6. The arcsine of (c/a) sin phi is taken as an arctangent with 1 - (c/a)^2 = (b/a)^2, which does not
    lose digits where c/a is nearly one.

    Examples
    --------
    >>> amplitude(np.array([2.0]), 1.0)
    array([2.])
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
    """Return F(phi | k^2), -pi < phi <= pi, from sin phi and cos phi, by Carlson's R_F.

    Examples
    --------
    >>> round(first_kind(0.0, -1.0, 1.0), 12)
    3.14159265359
    """
    from scipy.special import elliprf

    part = sine * float(elliprf(cosine**2, cosine**2 + complement * sine**2, 1.0))
    if cosine >= 0.0:
        return part
    return math.copysign(2.0 * float(elliprf(0.0, complement, 1.0)), sine) - part


def third_kind(nu: float, phi: Floats, complement: float) -> Floats:
    """Return Legendre's Pi(nu; phi | k^2) for any amplitude and nu <= 0, by Carlson's R_F and R_J.

    Examples
    --------
    >>> third_kind(0.0, np.array([4.0]), 1.0)
    array([4.])
    """
    from scipy.special import elliprf, elliprj

    half_turns = np.rint(phi / math.pi)
    sine, cosine = np.sin(phi), np.cos(phi)
    sine = np.where(half_turns % 2 == 0, sine, -sine)
    delta = cosine**2 + complement * sine**2
    part = sine * elliprf(cosine**2, delta, 1.0)
    part += nu / 3.0 * sine**3 * elliprj(cosine**2, delta, 1.0, 1.0 - nu * sine**2)
    complete = float(elliprf(0.0, complement, 1.0)) + nu / 3.0 * float(elliprj(0.0, complement, 1.0, 1.0 - nu))
    return np.asarray(2.0 * complete * half_turns + part)


def _cross_matrix(w: Floats) -> Floats:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def fixed_axis(w: Floats, t: Floats) -> Floats:
    """Return exp(t hat(w)), shape (k, 3, 3), by Rodrigues' formula."""
    speed = math.hypot(*w)
    if speed == 0.0:
        return np.broadcast_to(np.eye(3), (t.size, 3, 3)).copy()
    K = _cross_matrix(w / speed)
    angle = (t * speed)[:, None, None]
    return np.eye(3) + np.sin(angle) * K + 2.0 * np.sin(0.5 * angle) ** 2 * (K @ K)


def _frames(x: Floats, axis: int) -> Floats:
    """Return the rows (e_axis cross n, n cross that, n), n = x/|x|, shape (k, 3, 3), in the body's coordinates."""
    n = x / np.linalg.norm(x, axis=1, keepdims=True)
    first = np.cross(np.eye(3)[axis], n)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(n, first), n], axis=1)


def free_rigid_body(m: Floats, x0: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Return body momentum and attitude of the free rigid body in the body convention, with A(0) the unit matrix.

    Parameters
    ----------
    m : (3,)
        Inverse moments of inertia; any real numbers.
    x0 : (3,)
        Body angular momentum at time zero.
    t : (k,)
        Times, of any sign.

    Returns
    -------
    x : (k, 3) array
        Body angular momentum.
    A : (k, 3, 3) array
        Attitude, from the body to space: A x is constant.

    Notes
    -----
    T, L^2 and the three differences of 2T and m L^2 are taken exactly, in rationals: they cancel near the separatrix
    and near a permanent rotation, and decide which case it is. What remains is an error of some u |lam t| in the phase.

    Examples
    --------
    >>> x, A = free_rigid_body(np.array([1.0, 0.5, 0.25]), np.array([1.0, 2.0, 0.5]), np.array([0.0, 3.0]))
    >>> np.allclose(A[1] @ x[1], x[0], rtol=0, atol=1e-14)
    True
    """
    pairs = ((0, 1), (1, 2), (0, 2))
    if all(m[i] == m[j] or x0[i] == 0.0 or x0[j] == 0.0 for i, j in pairs):
        return np.broadcast_to(x0, (t.size, 3)).copy(), fixed_axis(m * x0, t)
    # x(t; 2^e y) = 2^e x(2^e t; y): momenta of any size without overflow.
    exponent = math.frexp(float(np.abs(x0).max()))[1]
    y = np.ldexp(x0, -exponent)
    x, A = _general(m, y, np.ldexp(t, exponent))
    return np.ldexp(x, exponent), A


def _general(m: Floats, x0: Floats, t: Floats) -> tuple[Floats, Floats]:
    masses, squares = [Fraction(v) for v in m.tolist()], [Fraction(v) ** 2 for v in x0.tolist()]
    length2 = sum(squares, Fraction(0))
    energy2 = sum((p * q for p, q in zip(masses, squares, strict=True)), Fraction(0))
    low, b, high = sorted(range(3), key=lambda i: masses[i])
    c, a = (high, low) if energy2 > masses[b] * length2 else (low, high)
    ma, mb, mc = masses[a], masses[b], masses[c]
    over_c, under_a, under_b = energy2 - mc * length2, ma * length2 - energy2, mb * length2 - energy2
    L = math.sqrt(length2)
    lam = math.sqrt((mb - mc) * under_a)
    complement = float((ma - mc) * under_b / ((mb - mc) * under_a))
    nu = -float((ma - mb) / (mb - mc))
    parity = 1.0 if (b - a) % 3 == 1 else -1.0
    sign_a = -1.0 if complement == 0.0 and x0[a] < 0.0 else 1.0
    size_a = sign_a * math.sqrt(over_c / (ma - mc))
    size_b = sign_a * parity * math.copysign(1.0, x0[c]) * (1.0 if mb > mc else -1.0) * math.sqrt(over_c / (mb - mc))
    size_c = math.copysign(math.sqrt(under_a / (ma - mc)), x0[c])
    cosine, sine = float(x0[a]) / size_a, float(x0[b]) / size_b
    radius = math.hypot(cosine, sine)
    cosine, sine = cosine / radius, sine / radius
    if complement == 0.0:
        u0 = math.asinh(sine / cosine)
        u = np.append(u0 + lam * t, u0)
        sn, cn = np.tanh(u), 2.0 * np.exp(-np.abs(u)) / (1.0 + np.exp(-2.0 * np.abs(u)))
        dn = cn
        root = math.sqrt(-nu)
        third = (u + root * np.arctan(root * sn)) / (1.0 - nu)
    else:
        u0 = first_kind(sine, cosine, complement)
        phi = amplitude(np.append(u0 + lam * t, u0), complement)
        sn, cn = np.sin(phi), np.cos(phi)
        dn = np.sqrt(complement + (1.0 - complement) * cn**2)
        third = third_kind(nu, phi, complement)
    x = np.empty((t.size + 1, 3))
    x[:, a], x[:, b], x[:, c] = size_a * cn, size_b * sn, size_c * dn
    psi = L * float(mc) * t + L * float(ma - mc) / lam * (third[:-1] - third[-1])
    frames = _frames(x, c)
    turn = np.zeros((t.size, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = np.cos(psi), -np.sin(psi), np.sin(psi), np.cos(psi)
    turn[:, 2, 2] = 1.0
    return x[:-1], frames[-1].T @ turn @ frames[:-1]


def exact_solution(M: Floats, sign: int, x0: Any, t: Any, attitude: Any = False) -> Any:
    """Return the closed form of ``x' = sign * J(x) M x`` on so(3) for a diagonal or full M.

    Parameters
    ----------
    M : (3,) or symmetric (3, 3)
        Inverse inertia.
    sign : {-1, +1}
        -1: the body equations; +1: the same motion backwards in time.
    x0 : (3,)
        Body angular momentum at time zero.
    t : float or (k,)
        One time, or several.
    attitude : bool or (3, 3)
        Also return the attitude; an array is the initial one (True: the unit matrix).

    Returns
    -------
    (3,) or (k, 3) array
        With attitude the pair of this and the attitudes, shape (3, 3) or (k, 3, 3).

    Raises
    ------
    ValueError
        A shape is wrong or a number is not finite.

    Examples
    --------
    >>> exact_solution(np.array([1.0, 0.5, 0.25]), -1, [0.0, 0.0, 2.0], 7.0)
    array([0., 0., 2.])
    """
    start, times = start_and_times(x0, t, 3)
    first = np.eye(3)
    if not isinstance(attitude, bool | np.bool_):
        first = read_finite(attitude, "attitude")
        if first.shape != (3, 3):
            raise ValueError(f"attitude has shape {first.shape}; give True or a finite (3, 3)")
    axes, m = np.eye(3), M
    if M.ndim == 2 and np.array_equal(M, np.diag(np.diag(M))):
        m = np.diag(M)
    elif M.ndim == 2:
        m, axes = np.linalg.eigh(M)
        axes *= round(float(np.linalg.det(axes)))
    with np.errstate(over="ignore", invalid="ignore"):
        x, A = free_rigid_body(m, start @ axes, -sign * np.atleast_1d(times))
        x, A = x @ axes.T, first @ (axes @ A @ axes.T)
    x, A = (all_finite(part, start, times) for part in (x, A))
    if times.ndim == 0:
        x, A = x[0], A[0]
    return x if isinstance(attitude, bool | np.bool_) and not attitude else (x, A)
