"""The double spherical pendulum: two massless rods in space, one hanging from the other, with a mass at each end."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.systems.bodies.inertia import check_products, read_in_range, read_vector
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made


def _swinging() -> npt.NDArray[np.float64]:
    """Return the state with both rods horizontal at a right angle, the lower one moving sideways."""
    return np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.0, -0.3, 0.0, 0.2, 1.0])


@ready_made(
    unit="z",
    coordinates={"q": ("direction", "1"), "p": ("momentum", "mass length^2/time"), "z": ("constant", "1")},
    gallery_entry=GalleryEntry(
        x0=_swinging,
        t_span=(0.0, 20.0),
        step=0.02,
        caption="Two pendulums, one at the end of the other, pulled aside and pushed sideways. The picture shows the "
        "directions of both rods on one sphere. The motion is chaotic, and the vertical angular momentum is "
        "constant.",
        pictures=(
            Picture(
                "directions",
                vectors={"upper rod": (0, 1, 2), "lower rod": (3, 4, 5)},
                axes_named=("$X$", "$Y$", "$Z$"),
                title="directions of the rods in space",
                view=(35.0, -20.0),
            ),
        ),
        components=Picture("components", chosen=(2, 5), quantity="height of the rods' ends"),
        coordinates=("q1", "q2", "q3", "q4", "q5", "q6", "p1", "p2", "p3", "p4", "p5", "p6", "z"),
        quantity="state",
    ),
)
def double_spherical_pendulum(
    masses: npt.ArrayLike = (1.0, 1.0), lengths: npt.ArrayLike = (1.0, 1.0), gravity: float = 1.0
) -> LiePoissonSystem:
    """Return a spherical pendulum that hangs from another one, in terms of two directions in space and their momenta.

    With unit vectors u_1 (from the pivot to the first mass) and u_2 (from there to the second), the Lagrangian is ``a
    |u_1'|^2/2 + b |u_2'|^2/2 + c u_1' . u_2' - gravity ((m_1 + m_2) l_1 u_13 + m_2 l_2 u_23)``, a = (m_1 + m_2) l_1^2,
    b = m_2 l_2^2, c = m_2 l_1 l_2; the third axis points up. H depends on the directions ``q/|q|`` and the angular
    momenta ``q cross p`` only: so q stays on its sphere, and the component of p along q has no effect. Sign +1.

    Parameters
    ----------
    masses, lengths : (2,)
        m and l, positive; the first belong to the rod at the pivot.
    gravity : float
        Acceleration (length/time^2), not negative.

    Returns
    -------
    LiePoissonSystem
        State: ``(q_1, q_2, p_1, p_2, 1)``, 13 numbers, q_1 = u_1, q_2 = u_2, and ``p_1 = a u_1' + c u_2'``, ``p_2 = b
        u_2' + c u_1'`` (angular momentum), up to components along q;
        ``co.systems.canonical_state`` assembles it. Casimir: ``"z"``, which is 1. Integrals, all
        quadratic: ``"|q1|^2"``, ``"q1.p1"``, the same of q2 and p2, and the vertical component ``"total L3"`` of the
        angular momentum, or all three components without gravity.

    Raises
    ------
    TypeError, ValueError
        Not two positive masses and two positive lengths, or negative gravity.

    Notes
    -----
    Marsden and Scheurle, Z. angew. Math. Phys. 44, 17 (1993). The kinetic energy does not split. The bracket is
    constant, so `GaussLegendre` is a symplectic map that preserves all quadratic integrals: McLachlan, Modin and
    Verdier, Nonlinearity 27, 1525 (2014).

    Examples
    --------
    >>> pendulum = double_spherical_pendulum()
    >>> hanging = [0, 0, -1.0, 0, 0, -1.0, 0, 0, 0, 0, 0, 0, 1]
    >>> pendulum.energy(hanging), bool(abs(pendulum.vector_field(hanging)).max() == 0)
    (-3.0, True)
    """
    first, second = (_pair(argument, what) for argument, what in ((masses, "masses"), (lengths, "lengths")))
    g = read_in_range(gravity, "gravity", zero=True)
    (m1, m2), (l1, l2) = first, second
    weights = [g * ((m1 + m2) * l1), g * (m2 * l2)] if g else []
    check_products("masses, lengths and gravity", lambda: [m1 * m2 * l1 * l1 * l2 * l2, *weights])
    H = pendulum_energy(first, second, g)
    return LiePoissonSystem(
        heisenberg(6),
        H,
        sign=+1,
        name="double_spherical_pendulum",
        parameters={"masses": first, "lengths": second, "gravity": g},
        integrals=_integrals(g),
    )


def _pair(argument: Any, what: str) -> tuple[float, float]:
    numbers = read_vector(argument, what, 2).tolist()
    first, second = (read_in_range(value, f"{what}[{k}]") for k, value in enumerate(numbers))
    return first, second


def _integrals(gravity: float) -> dict[str, Quadratic]:
    """Return the squares of q_1 and q_2, their products with the momenta, and the angular momentum."""

    def form(*entries: tuple[int, int, float]) -> Quadratic:
        M = np.zeros((13, 13))
        for i, j, value in entries:
            M[i, j] += value
            M[j, i] += value
        return Quadratic(M)

    integrals = {}
    for k in (0, 1):
        q, p = 3 * k, 6 + 3 * k
        integrals[f"|q{k + 1}|^2"] = form(*((q + i, q + i, 1.0) for i in range(3)))
        integrals[f"q{k + 1}.p{k + 1}"] = form(*((q + i, p + i, 1.0) for i in range(3)))
    for axis in range(3) if gravity == 0.0 else (2,):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        pairs = [(3 * k + i, 6 + 3 * k + j, 1.0) for k in (0, 1)] + [(3 * k + j, 6 + 3 * k + i, -1.0) for k in (0, 1)]
        integrals[f"total L{axis + 1}"] = form(*pairs)
    return integrals


@lru_cache(maxsize=64)
def pendulum_energy(masses: tuple[float, float], lengths: tuple[float, float], gravity: float) -> Hamiltonian:
    """Return H of a double spherical pendulum, of (q_1, q_2, p_1, p_2, z); cached, so that it is compiled once."""
    # Apart from gravity, H depends on the scalar products of Y = (q_1, q_2, p_1, p_2). With r = |q_1| |q_2|, f =
    # q_1.q_2, s_ij = q_i.p_j, t_1 = |q_1|^2 s_21 - f s_11, t_2 = f s_22 - |q_2|^2 s_12 and d = a b - c^2 the inverse of
    # the inertia gives ``2 d T = b |L_1|^2 + a |L_2|^2 - 2 c (r p_1.p_2 - E/r) - c^2 W/Z``, where ``E = |q_2|^2 s_11
    # s_12 + |q_1|^2 s_21 s_22 - f s_11 s_22``, ``W = b t_1^2 + a t_2^2 - 2 c f t_1 t_2 / r``, ``Z = d r^2 + c^2 (r^2 -
    # f^2)``.
    (m1, m2), (l1, l2) = masses, lengths
    a, b, c, d = (m1 + m2) * l1 * l1, m2 * l2 * l2, m2 * l1 * l2, m1 * m2 * l1 * l1 * l2 * l2
    weight1, weight2 = gravity * (m1 + m2) * l1, gravity * m2 * l2
    half = 0.5 / d

    def scalar_products(x: Any, y: Any) -> Any:
        result = np.zeros((4, 4), dtype=x.dtype)
        for i in range(4):
            for j in range(4):
                for k in range(3):
                    result[i, j] += x[3 * i + k] * y[3 * j + k]
        return result

    def value(x: Any) -> Any:
        D = scalar_products(x, x)
        A1, A2, f, s11, s12, s21, s22 = D[0, 0], D[1, 1], D[0, 1], D[0, 2], D[0, 3], D[1, 2], D[1, 3]
        r = np.sqrt(A1 * A2)
        t1, t2, E = A1 * s21 - f * s11, f * s22 - A2 * s12, A2 * s11 * s12 + A1 * s21 * s22 - f * s11 * s22
        W, Z = b * t1 * t1 + a * t2 * t2 - 2 * c * f * t1 * t2 / r, d * r * r + c * c * (r * r - f * f)
        squares = b * (A1 * D[2, 2] - s11 * s11) + a * (A2 * D[3, 3] - s22 * s22)
        moving = squares - 2 * c * (r * D[2, 3] - E / r) - c * c * W / Z
        return half * moving + weight1 * x[2] / np.sqrt(A1) + weight2 * x[5] / np.sqrt(A2)

    def shared_terms(D: Any) -> Any:
        """Return subexpressions shared by the derivatives: 1 / r, f / r, w_1, w_2 (c^2 W/Z by t_1, t_2), ..."""
        A1, A2, f, s11, s12, s21, s22 = D[0, 0], D[1, 1], D[0, 1], D[0, 2], D[0, 3], D[1, 2], D[1, 3]
        r = np.sqrt(A1 * A2)
        e, t1, t2 = f / r, A1 * s21 - f * s11, f * s22 - A2 * s12
        u = (A2 * s11 * s12 + A1 * s21 * s22 - f * s11 * s22) / (r * r)
        Z = d * r * r + c * c * (r * r - f * f)
        X, V = c * c / Z, (b * t1 * t1 + a * t2 * t2 - 2 * c * e * t1 * t2) / Z
        w1, w2 = 2 * X * (b * t1 - c * e * t2), 2 * X * (a * t2 - c * e * t1)
        by_r = -2 * c * (D[2, 3] + u) - 2 * X * (c * e * t1 * t2 / r - (d + c * c) * r * V)
        return r, e, t1, t2, u, Z, X, V, w1, w2, by_r

    def sums(D: Any) -> Any:
        """Return twice the derivative of 2 d T by each square, and the derivative by each other product."""
        A1, A2, f, s11, s12, s21, s22 = D[0, 0], D[1, 1], D[0, 1], D[0, 2], D[0, 3], D[1, 2], D[1, 3]
        r, _, t1, t2, _, _, X, V, w1, w2, by_r = shared_terms(D)
        S, g = 0 * D, 2 * c / r
        S[0, 0] = 2 * b * D[2, 2] + 2 * (g * s22 - w1) * s21 + by_r * r / A1
        S[1, 1] = 2 * a * D[3, 3] + 2 * (g * s11 + w2) * s12 + by_r * r / A2
        S[0, 1] = X * (g * t1 * t2 - 2 * c * c * f * V) - g * s11 * s22 + w1 * s11 - w2 * s22
        S[0, 2], S[1, 3] = g * (A2 * s12 - f * s22) - 2 * b * s11 + w1 * f, g * t1 - 2 * a * s22 - w2 * f
        S[0, 3], S[1, 2] = (g * s11 + w2) * A2, (g * s22 - w1) * A1
        S[2, 2], S[3, 3], S[2, 3] = 2 * b * A1, 2 * a * A2, -2 * c * r
        return S

    def apply_derivatives(S: Any, x: Any) -> Any:
        result = 0 * x
        for i in range(4):
            for j in range(4):
                for k in range(3):
                    result[3 * i + k] += half * S[min(i, j), max(i, j)] * x[3 * j + k]
        return result

    def gradient(x: Any) -> Any:
        D = scalar_products(x, x)
        result = apply_derivatives(sums(D), x)
        for i in range(2):
            up, A = 3 * i + 2, D[i, i]
            weight = (weight1, weight2)[i] / np.sqrt(A)
            out = weight * x[up] / A
            for k in range(3):
                result[3 * i + k] -= out * x[3 * i + k]
            result[up] += weight
        return result

    def gradient_derivative(x: Any, v: Any) -> Any:
        """Return the derivative of the gradient along v; the prefix d marks derivatives along v."""
        D, dD = scalar_products(x, x), scalar_products(v, x)
        dD = dD + dD.T
        A1, A2, f, s11, s12, s21, s22 = D[0, 0], D[1, 1], D[0, 1], D[0, 2], D[0, 3], D[1, 2], D[1, 3]
        dA1, dA2, df, ds11, ds12, ds21, ds22 = dD[0, 0], dD[1, 1], dD[0, 1], dD[0, 2], dD[0, 3], dD[1, 2], dD[1, 3]
        r, e, t1, t2, u, Z, X, V, w1, w2, by_r = shared_terms(D)
        dr = (dA1 * A2 + A1 * dA2) / (2 * r)
        de, g, dg = (df - e * dr) / r, 2 * c / r, -2 * c * dr / (r * r)
        dt1 = dA1 * s21 + A1 * ds21 - df * s11 - f * ds11
        dt2 = df * s22 + f * ds22 - dA2 * s12 - A2 * ds12
        tt, dtt = t1 * t2, dt1 * t2 + t1 * dt2
        du = dA2 * s11 * s12 + A2 * (ds11 * s12 + s11 * ds12) + dA1 * s21 * s22 + A1 * (ds21 * s22 + s21 * ds22)
        du = (du - df * s11 * s22 - f * (ds11 * s22 + s11 * ds22) - 2 * u * r * dr) / (r * r)
        dZ = 2 * (d + c * c) * r * dr - 2 * c * c * f * df
        dX = -X * dZ / Z
        dV = (2 * b * t1 * dt1 + 2 * a * t2 * dt2 - 2 * c * (de * tt + e * dtt) - V * dZ) / Z
        dw1 = w1 * dX / X + 2 * X * (b * dt1 - c * (de * t2 + e * dt2))
        dw2 = w2 * dX / X + 2 * X * (a * dt2 - c * (de * t1 + e * dt1))
        dby_r = -2 * c * (dD[2, 3] + du) - dX * (g * e * tt - 2 * (d + c * c) * r * V)
        dby_r -= X * (dg * e * tt + g * (de * tt + e * dtt) - 2 * (d + c * c) * (dr * V + r * dV))
        S, dS = sums(D), 0 * D
        dS[0, 0] = 2 * b * dD[2, 2] + 2 * (dg * s22 + g * ds22 - dw1) * s21 + 2 * (g * s22 - w1) * ds21
        dS[0, 0] += (dby_r * r + by_r * dr - by_r * r / A1 * dA1) / A1
        dS[1, 1] = 2 * a * dD[3, 3] + 2 * (dg * s11 + g * ds11 + dw2) * s12 + 2 * (g * s11 + w2) * ds12
        dS[1, 1] += (dby_r * r + by_r * dr - by_r * r / A2 * dA2) / A2
        dS[0, 1] = dX * (g * tt - 2 * c * c * f * V) + X * (dg * tt + g * dtt - 2 * c * c * (df * V + f * dV))
        dS[0, 1] += dw1 * s11 + w1 * ds11 - dw2 * s22 - w2 * ds22 - dg * s11 * s22 - g * (ds11 * s22 + s11 * ds22)
        dS[0, 2] = dg * (A2 * s12 - f * s22) + g * (dA2 * s12 + A2 * ds12 - df * s22 - f * ds22)
        dS[0, 2] += dw1 * f + w1 * df - 2 * b * ds11
        dS[1, 3] = dg * (A1 * s21 - f * s11) + g * (dA1 * s21 + A1 * ds21 - df * s11 - f * ds11)
        dS[1, 3] -= dw2 * f + w2 * df + 2 * a * ds22
        dS[0, 3] = (dg * s11 + g * ds11 + dw2) * A2 + (g * s11 + w2) * dA2
        dS[1, 2] = (dg * s22 + g * ds22 - dw1) * A1 + (g * s22 - w1) * dA1
        dS[2, 2], dS[3, 3], dS[2, 3] = 2 * b * dA1, 2 * a * dA2, -2 * c * dr
        result = apply_derivatives(dS, x) + apply_derivatives(S, v)
        for i in range(2):
            up, A, dA = 3 * i + 2, D[i, i], dD[i, i]
            weight = (weight1, weight2)[i] / np.sqrt(A)
            out = weight * x[up] / A
            dout = weight * v[up] / A - 1.5 * out * dA / A
            for k in range(3):
                result[3 * i + k] -= dout * x[3 * i + k] + out * v[3 * i + k]
            result[up] -= 0.5 * weight * dA / A
        return result

    def hessian(x: Any) -> Any:
        result = np.zeros((len(x), len(x)), dtype=x.dtype)
        for i in range(12):
            unit = 0 * x
            unit[i] += 1
            result[:, i] = gradient_derivative(x, unit)
        return result

    return Hamiltonian(value, gradient, hessian)
