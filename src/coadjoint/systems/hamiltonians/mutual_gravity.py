"""The mutual gravity of extended bodies to second and fourth order in their sizes, with its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.user_functions import ALL_SHARES, bodies_of_shares, number_of_shares

Numbers = npt.NDArray[Any]


def mutual_gravity(
    coordinates: Any, masses: Numbers, anisotropic: Numbers, gravity: Any, order: int, multipoles: Any = None
) -> FunctionOfConstants:
    """Return ``V = -G sum of (m_i m_j/s - 3 (m_j w_i.D_i w_i + m_i w_j.D_j w_j)/(2 s^5))`` over pairs of bodies."""
    # s is the distance of the centres and w_i their difference in the frame of body i; D = I - tr(I)/3, (k, 3, 3), is
    # the anisotropic part of the inertia. ``tr(I) - 3 u.Iu = -3 u.Du`` for a unit vector u: this is MacCullagh's
    # formula without the difference of large terms. Coordinates: attitudes, (k, 3, 3), then positions, (k, 3).
    # Constants: G, masses, D, the sums of the squares of the entries of each D, and the multipoles of third and fourth
    # order, (k, 27) and (k, 81), if the bodies are no ellipsoids.
    higher = () if multipoles is None else multipoles
    constants = np.concatenate([constants_of_gravity(masses, anisotropic, gravity), *map(np.ravel, higher)])
    value, gradient, hessian = gravity_functions(len(masses), order, multipoles is not None)
    return FunctionOfConstants(coordinates, constants, value, gradient, hessian, number_of_shares(len(masses)))


def constants_of_gravity(masses: Numbers, anisotropic: Numbers, gravity: Any) -> Numbers:
    """Return G, the masses, the anisotropic parts of the inertias, and the sums of the squares of their entries."""
    squares = np.array([(one * one).sum() for one in anisotropic])
    return np.concatenate([np.ravel(gravity), masses, np.ravel(anisotropic), squares])


@lru_cache(maxsize=64)
def gravity_functions(count: int, order: int, multipoles: bool) -> tuple[Callable[..., Any], ...]:
    """Return V and its first and second derivatives as functions of y and of the constants; compiled code is reused."""
    axes, D_at, squares_at = 9 * count, 1 + count, 1 + 10 * count
    bodies_of = bodies_of_shares(count)

    def value(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        G, m, D = constants[0], constants[1:D_at], constants[D_at:squares_at].reshape(count, 3, 3)
        total, R, w = 0.0 * y[0], 0.0 * y[:3], 0.0 * y[:3]
        for i in range(begin, count, step):
            for j in range(i):
                square = 0.0 * y[0]
                for a in range(3):
                    R[a] = y[axes + 3 * i + a] - y[axes + 3 * j + a]
                    square += R[a] * R[a]
                s = np.sqrt(square)
                total -= G * m[i] * m[j] / s
                for one, other in ((i, j), (j, i)):
                    form = 0.0 * y[0]
                    for b in range(3):
                        w[b] = 0.0
                        for a in range(3):
                            w[b] += y[9 * one + 3 * a + b] * R[a]
                    for b in range(3):
                        form += w[b] * (D[one, b, 0] * w[0] + D[one, b, 1] * w[1] + D[one, b, 2] * w[2])
                    total += 1.5 * G * m[other] * form / (square * square * s)
        return total

    def gradient(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        G, m, D = constants[0], constants[1:D_at], constants[D_at:squares_at].reshape(count, 3, 3)
        result, R, w, e = 0.0 * y, 0.0 * y[:3], 0.0 * y[:3], 0.0 * y[:3]
        for i in range(begin, count, step):
            for j in range(i):
                square = 0.0 * y[0]
                for a in range(3):
                    R[a] = y[axes + 3 * i + a] - y[axes + 3 * j + a]
                    square += R[a] * R[a]
                s = np.sqrt(square)
                fifth = 1.0 / (square * square * s)
                along = G * m[i] * m[j] / (square * s)
                for one, other in ((i, j), (j, i)):
                    c = 1.5 * G * m[other] * fifth
                    for b in range(3):
                        w[b] = 0.0
                        for a in range(3):
                            w[b] += y[9 * one + 3 * a + b] * R[a]
                    form = 0.0 * y[0]
                    for b in range(3):
                        e[b] = D[one, b, 0] * w[0] + D[one, b, 1] * w[1] + D[one, b, 2] * w[2]
                        form += e[b] * w[b]
                    along -= 5.0 * c * form / square
                    for a in range(3):
                        push = 0.0 * y[0]
                        for b in range(3):
                            push += y[9 * one + 3 * a + b] * e[b]
                            result[9 * one + 3 * a + b] += 2.0 * c * R[a] * e[b]
                        result[axes + 3 * i + a] += 2.0 * c * push
                        result[axes + 3 * j + a] -= 2.0 * c * push
                for a in range(3):
                    result[axes + 3 * i + a] += along * R[a]
                    result[axes + 3 * j + a] -= along * R[a]
        return result

    def hessian(y: Any, constants: Any) -> Any:
        G, m, D = constants[0], constants[1:D_at], constants[D_at:squares_at].reshape(count, 3, 3)
        result = np.outer(0.0 * y, y)
        R, w, e, g = 0.0 * y[:3], 0.0 * y[:3], 0.0 * y[:3], 0.0 * y[:3]
        DA, S, block = np.outer(R, R), np.outer(R, R), np.outer(R, R)
        for i in range(count):
            for j in range(i):
                square = 0.0 * y[0]
                for a in range(3):
                    R[a] = y[axes + 3 * i + a] - y[axes + 3 * j + a]
                    square += R[a] * R[a]
                s = np.sqrt(square)
                fifth = 1.0 / (square * square * s)
                for a in range(3):
                    for b in range(3):
                        block[a, b] = -3.0 * G * m[i] * m[j] * R[a] * R[b] * fifth
                    block[a, a] += G * m[i] * m[j] / (square * s)
                for one, other in ((i, j), (j, i)):
                    c = 1.5 * G * m[other] * fifth
                    for b in range(3):
                        w[b] = 0.0
                        for a in range(3):
                            w[b] += y[9 * one + 3 * a + b] * R[a]
                    form = 0.0 * y[0]
                    for b in range(3):
                        e[b] = D[one, b, 0] * w[0] + D[one, b, 1] * w[1] + D[one, b, 2] * w[2]
                        form += e[b] * w[b]
                        for a in range(3):
                            DA[b, a] = 0.0
                            for d in range(3):
                                DA[b, a] += D[one, b, d] * y[9 * one + 3 * a + d]
                    for a in range(3):
                        g[a] = 0.0
                        for b in range(3):
                            g[a] += y[9 * one + 3 * a + b] * e[b]
                            S[a, b] = 0.0
                            for d in range(3):
                                S[a, b] += y[9 * one + 3 * a + d] * DA[d, b]
                    for a in range(3):
                        for b in range(3):
                            block[a, b] += c * (2.0 * S[a, b] - 10.0 * (g[a] * R[b] + R[a] * g[b]) / square)
                            block[a, b] += 35.0 * c * form * R[a] * R[b] / (square * square)
                        block[a, a] -= 5.0 * c * form / square
                    for a in range(3):
                        for b in range(3):
                            row = 9 * one + 3 * a + b
                            for d in range(3):
                                mixed = 2.0 * c * R[a] * (DA[b, d] - 5.0 * e[b] * R[d] / square)
                                if a == d:
                                    mixed += 2.0 * c * e[b]
                                result[row, axes + 3 * i + d] += mixed
                                result[axes + 3 * i + d, row] += mixed
                                result[row, axes + 3 * j + d] -= mixed
                                result[axes + 3 * j + d, row] -= mixed
                                for f in range(3):
                                    result[row, 9 * one + 3 * d + f] += 2.0 * c * R[a] * R[d] * D[one, b, f]
                for a in range(3):
                    for b in range(3):
                        result[axes + 3 * i + a, axes + 3 * i + b] += block[a, b]
                        result[axes + 3 * j + a, axes + 3 * j + b] += block[a, b]
                        result[axes + 3 * i + a, axes + 3 * j + b] -= block[a, b]
                        result[axes + 3 * j + a, axes + 3 * i + b] -= block[a, b]
        return result

    functions = value, gradient, hessian
    if order < 4:
        return functions
    added = fourth_order_terms(count, not multipoles)
    if multipoles:
        added = sum_of(added, multipole_terms(count))
    return sum_of(functions, added)


Functions = tuple[Callable[..., Any], ...]


def sum_of(first: Functions, second: Functions) -> Functions:
    """Return the sum of two functions with their derivatives."""
    v, g, h = first
    more_v, more_g, more_h = second
    return (
        lambda y, constants, share=ALL_SHARES: v(y, constants, share) + more_v(y, constants, share),
        lambda y, constants, share=ALL_SHARES: g(y, constants, share) + more_g(y, constants, share),
        lambda y, constants: h(y, constants) + more_h(y, constants),
    )


STEP = 2.0**-200  # of complex derivatives, which are exact to rounding: its square vanishes beside one


def by_complex_steps(gradient: Callable[..., Any]) -> Callable[..., Any]:
    """Return the second derivatives of a function from its gradient, which is analytic."""

    def hessian(y: Any, constants: Any) -> Any:
        result = np.outer(0.0 * y, y)
        for k in range(len(y)):
            moved = y + 0.0j
            moved[k] += 1j * STEP
            change = gradient(moved, constants)
            for n in range(len(y)):
                result[n, k] = change[n].imag / STEP
        return result

    return hessian


def fourth_order_terms(count: int, ellipsoids: bool = True) -> tuple[Callable[..., Any], ...]:
    """Return the terms of fourth order in the sizes, and their derivatives, with the constants of `mutual_gravity`."""
    # Without `ellipsoids` those of the second moments of both bodies alone; floats in closures would be constants.
    # With D the anisotropic part of the inertia, w = A^T R, e = D w, g = A e for the difference R of two centres, they
    # are ``-G sum of (15/7 (m_2/m_1 E(1, 1) + m_1/m_2 E(2, 2)) + 6 E(1, 2))/24``. The fourth derivatives of 1/s give
    # ``E(1, 2) = 105 w_1.e_1 w_2.e_2/s^9 - 60 g_1.g_2/s^7 + 6 tr(A_1 D_1 A_1^T A_2 D_2 A_2^T)/s^5``. The fourth moments
    # of a homogeneous ellipsoid are 5/(7 m) times the products of its second moments; isotropic parts have no effect.
    axes, D_at, squares_at = 9 * count, 1 + count, 1 + 10 * count
    bodies_of = bodies_of_shares(count)

    def parts(y: Any, D: Any, i: int, j: int) -> Any:
        """Return R, s^2, and of both bodies w, e, g, D e, A D and A D A^T, by rows."""
        R, w, e, g, u = 0.0 * y[:3], 0.0 * y[:6], 0.0 * y[:6], 0.0 * y[:6], 0.0 * y[:6]
        AD, S = np.outer(0.0 * y[:6], y[:3]), np.outer(0.0 * y[:6], y[:3])
        square = 0.0 * y[0]
        for a in range(3):
            R[a] = y[axes + 3 * i + a] - y[axes + 3 * j + a]
            square += R[a] * R[a]
        for n in range(2):
            first, body = 9 * (i if n == 0 else j), D[i if n == 0 else j]
            for a in range(3):
                for b in range(3):
                    w[3 * n + b] += y[first + 3 * a + b] * R[a]
                    for c in range(3):
                        AD[3 * n + a, b] += y[first + 3 * a + c] * body[c, b]
            for a in range(3):
                for b in range(3):
                    e[3 * n + a] += body[a, b] * w[3 * n + b]
                    g[3 * n + a] += AD[3 * n + a, b] * w[3 * n + b]
                    for c in range(3):
                        S[3 * n + a, b] += AD[3 * n + a, c] * y[first + 3 * b + c]
            for a in range(3):
                for b in range(3):
                    u[3 * n + a] += body[a, b] * e[3 * n + b]
        return R, square, w, e, g, u, AD, S

    def value(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        G, m, D = constants[0], constants[1:D_at], constants[D_at:squares_at].reshape(count, 3, 3)
        squares = constants[squares_at:]
        total = 0.0 * y[0]
        for i in range(begin, count, step):
            for j in range(i):
                _, square, w, e, g, _, _, S = parts(y, D, i, j)
                fifth = 1.0 / (square * square * np.sqrt(square))
                first, second, mixed, own, other = 0.0 * y[0], 0.0 * y[0], 0.0 * y[0], 0.0 * y[0], 0.0 * y[0]
                trace = 0.0 * y[0]
                for a in range(3):
                    first += w[a] * e[a]
                    second += w[3 + a] * e[3 + a]
                    mixed += g[a] * g[3 + a]
                    own += e[a] * e[a]
                    other += e[3 + a] * e[3 + a]
                    for b in range(3):
                        trace += S[a, b] * S[3 + a, b]
                E1 = 105.0 * first * first / square**2 - 60.0 * own / square + 6.0 * squares[i]
                E2 = 105.0 * second * second / square**2 - 60.0 * other / square + 6.0 * squares[j]
                E12 = 105.0 * first * second / square**2 - 60.0 * mixed / square + 6.0 * trace
                weighted = 6.0 * E12
                if ellipsoids:
                    weighted = 15.0 / 7.0 * (m[j] / m[i] * E1 + m[i] / m[j] * E2) + 6.0 * E12
                total -= G * weighted * fifth / 24.0
        return total

    def gradient(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        G, m, D = constants[0], constants[1:D_at], constants[D_at:squares_at].reshape(count, 3, 3)
        squares = constants[squares_at:]
        result = 0.0 * y
        for i in range(begin, count, step):
            for j in range(i):
                R, square, w, e, g, u, AD, S = parts(y, D, i, j)
                fifth = 1.0 / (square * square * np.sqrt(square))
                q, own, mixed, trace = 0.0 * y[:2], 0.0 * y[:2], 0.0 * y[0], 0.0 * y[0]
                for a in range(3):
                    mixed += g[a] * g[3 + a]
                    for n in range(2):
                        q[n] += w[3 * n + a] * e[3 * n + a]
                        own[n] += e[3 * n + a] * e[3 * n + a]
                    for b in range(3):
                        trace += S[a, b] * S[3 + a, b]
                # The powers of s: those of each term by its own degree.
                along = 0.0 * y[0]
                for n in range(2):
                    one, other = (i, j) if n == 0 else (j, i)
                    k = -G / 24.0 * 15.0 / 7.0 * m[other] / m[one] * fifth
                    if not ellipsoids:
                        k = 0.0 * k
                    along -= k * (945.0 * q[n] * q[n] / square**2 - 420.0 * own[n] / square + 30.0 * squares[one])
                    by_q, by_own = k * 210.0 * q[n] / square**2, -60.0 * k / square
                    cross = -G / 4.0 * fifth
                    by_q += cross * 105.0 * q[1 - n] / square**2
                    by_mixed, by_trace = -60.0 * cross / square, 6.0 * cross
                    x = 0.0 * y[:3]  # D A^T g of the other body
                    for b in range(3):
                        for a in range(3):
                            x[b] += AD[3 * n + a, b] * g[3 * (1 - n) + a]
                    for a in range(3):
                        push = 2.0 * by_q * g[3 * n + a]
                        for b in range(3):
                            entry = y[9 * one + 3 * a + b]
                            push += entry * (2.0 * by_own * u[3 * n + b] + by_mixed * x[b])
                            slope = R[a] * (2.0 * by_q * e[3 * n + b] + 2.0 * by_own * u[3 * n + b] + by_mixed * x[b])
                            slope += by_mixed * g[3 * (1 - n) + a] * e[3 * n + b]
                            for c in range(3):
                                slope += 2.0 * by_trace * S[3 * (1 - n) + a, c] * AD[3 * n + c, b]
                            result[9 * one + 3 * a + b] += slope
                        result[axes + 3 * i + a] += push
                        result[axes + 3 * j + a] -= push
                cross = -G / 4.0 * fifth
                along -= cross * (945.0 * q[0] * q[1] / square**2 - 420.0 * mixed / square + 30.0 * trace)
                for a in range(3):
                    result[axes + 3 * i + a] += along * R[a] / square
                    result[axes + 3 * j + a] -= along * R[a] / square
        return result

    return value, gradient, by_complex_steps(gradient)


def multipole_terms(count: int) -> tuple[Callable[..., Any], ...]:
    """Return the terms of the third and fourth multipoles of each body and the mass of the others, with derivatives."""
    # ``-G m (P3 w^3/(6 s^7) + P4 w^4/(24 s^9))`` for a mass m at w in the frame of the body, by `traceless_multipoles`.
    axes, third_at, fourth_at = 9 * count, 1 + 11 * count, 1 + 38 * count
    bodies_of = bodies_of_shares(count)

    def parts(y: Any, constants: Any, one: int, other: int) -> Any:
        """Return the difference of the centres, s^2, and of both forms the value and the derivatives by w."""
        d, w, cubic, quartic = 0.0 * y[:3], 0.0 * y[:3], 0.0 * y[:3], 0.0 * y[:3]
        square, third, fourth = 0.0 * y[0], 0.0 * y[0], 0.0 * y[0]
        for a in range(3):
            d[a] = y[axes + 3 * other + a] - y[axes + 3 * one + a]
            square += d[a] * d[a]
        for a in range(3):
            for b in range(3):
                w[b] += y[9 * one + 3 * a + b] * d[a]
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    product = w[b] * w[c]
                    cubic[a] += constants[third_at + 27 * one + 9 * a + 3 * b + c] * product
                    for e in range(3):
                        quartic[a] += constants[fourth_at + 81 * one + 27 * a + 9 * b + 3 * c + e] * product * w[e]
            third += cubic[a] * w[a]
            fourth += quartic[a] * w[a]
        return d, square, third, fourth, cubic, quartic

    def value(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        total = 0.0 * y[0]
        for i in range(begin, count, step):
            for j in range(i):
                for one, other in ((i, j), (j, i)):
                    _, square, third, fourth, _, _ = parts(y, constants, one, other)
                    seventh = 1.0 / (square**3 * np.sqrt(square))
                    total -= constants[0] * constants[1 + other] * (third / 6.0 + fourth / (24.0 * square)) * seventh
        return total

    def gradient(y: Any, constants: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        result = 0.0 * y
        for i in range(begin, count, step):
            for j in range(i):
                for one, other in ((i, j), (j, i)):
                    d, square, third, fourth, cubic, quartic = parts(y, constants, one, other)
                    factor = -constants[0] * constants[1 + other] / (square**3 * np.sqrt(square))
                    along = -factor * (7.0 * third / 6.0 + 9.0 * fourth / (24.0 * square)) / square
                    for a in range(3):
                        push = along * d[a]
                        for b in range(3):
                            slope = factor * (0.5 * cubic[b] + quartic[b] / (6.0 * square))
                            push += y[9 * one + 3 * a + b] * slope
                            result[9 * one + 3 * a + b] += d[a] * slope
                        result[axes + 3 * other + a] += push
                        result[axes + 3 * one + a] -= push
        return result

    return value, gradient, by_complex_steps(gradient)


def traceless_multipoles(third: Numbers, fourth: Numbers) -> tuple[Numbers, Numbers]:
    """Return the tensors of the third and fourth multipoles, ``P_l w^l = l! integral s^l |y|^l P_l(cos) dm``."""
    # P3 = 15 (M3 - 3/5 sym(1 M1)) with the trace M1 of M3, and P4 = 105 (M4 - 6/7 sym(1 M2) + 3/35 sym(1 1) M0).
    one = np.eye(3)
    first, second = np.einsum("abb->a", third), np.einsum("abcc->ab", fourth)
    of_third = sum(np.einsum(f"ab,c->{order}", one, first) for order in ("abc", "acb", "cba"))
    pairs = ("abcd", "acbd", "adbc", "bcad", "bdac", "cdab")
    letters = [(f"{p[:2]},{p[2:]}->abcd") for p in pairs]
    of_fourth = sum(np.einsum(rule, one, second) for rule in letters)
    of_both = sum(np.einsum(rule, one, one) for rule in letters[:3]) * np.trace(second)
    return 15.0 * third - 3.0 * of_third, 105.0 * fourth - 15.0 * of_fourth + 3.0 * of_both
