"""The mutual gravity of extended bodies to second order in their sizes, with its first and second derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.hamiltonians.mutual_gravity_fourth import fourth_order_terms
from coadjoint.systems.user_functions import ALL_SHARES, bodies_of_shares, callable_from_compiled, number_of_shares

Numbers = npt.NDArray[Any]


def mutual_gravity(
    coordinates: Any, masses: Numbers, anisotropic: Numbers, gravity: Any, order: int
) -> FunctionOfConstants:
    """Return ``V = -G sum of (m_i m_j/s - 3 (m_j w_i.D_i w_i + m_i w_j.D_j w_j)/(2 s^5))`` over pairs of bodies."""
    # s is the distance of the centres and w_i their difference in the frame of body i; D = I - tr(I)/3, (k, 3, 3), is
    # the anisotropic part of the inertia. ``tr(I) - 3 u.Iu = -3 u.Du`` for a unit vector u: this is MacCullagh's
    # formula without the difference of large terms. Coordinates: attitudes, (k, 3, 3), then positions, (k, 3).
    # Constants: G, masses, D, and the sums of the squares of the entries of each D.
    count, squares = len(masses), np.array([(one * one).sum() for one in anisotropic])
    constants = np.concatenate([np.ravel(gravity), masses, np.ravel(anisotropic), squares])
    value, gradient, hessian = _functions(count, order)
    return FunctionOfConstants(coordinates, constants, value, gradient, hessian, number_of_shares(count))


@lru_cache(maxsize=64)
def _functions(count: int, order: int) -> tuple[Callable[..., Any], ...]:
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
    v, g, h = map(callable_from_compiled, functions)
    more_v, more_g, more_h = map(callable_from_compiled, fourth_order_terms(count))
    return (
        lambda y, constants, share=ALL_SHARES: v(y, constants, share) + more_v(y, constants, share),
        lambda y, constants, share=ALL_SHARES: g(y, constants, share) + more_g(y, constants, share),
        lambda y, constants: h(y, constants) + more_h(y, constants),
    )
