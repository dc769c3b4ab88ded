"""The free rigid body in 60 digits, by Jacobi's elliptic functions and, without them, by Taylor series.

Body convention: x' = x cross w, A' = A hat(w) with w = m x. Whittaker, "Analytical Dynamics", 69: x encircles an axis
c, x = (X_a cn u, X_b sn u, X_c dn u), and the frame of e_c cross x turns about x by an integral of the third kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpmath import mp, mpf

DIGITS = 60


def exact_motion(m: Sequence[float], x0: Sequence[Any], h: float) -> tuple[Any, Any]:
    """Return momentum (list of 3) and attitude (3 x 3 matrix), which starts from the unit matrix."""
    with mp.workdps(DIGITS + 60):  # differences of the energy and of the moments cancel
        m, x0, h = [mpf(v) for v in m], [mpf(v) for v in x0], mpf(h)
        for i in range(3):
            if m[(i + 1) % 3] == m[(i + 2) % 3]:
                return _symmetric(i, m, x0, h)
        if sum(v != 0 for v in x0) <= 1:
            return list(x0), _rotation([p * q * h for p, q in zip(m, x0, strict=True)])
        return _general(m, x0, h)


def _symmetric(i: int, m: list[Any], x0: list[Any], h: Any) -> tuple[Any, Any]:
    """The body turns about its axis i, and that in space about the momentum."""
    own = [mpf(0)] * 3
    own[i] = (m[i] - m[(i + 1) % 3]) * x0[i] * h
    spin = _rotation(own)
    return list(spin.T * mp.matrix(x0)), _rotation([m[(i + 1) % 3] * h * v for v in x0]) * spin


def _general(m: list[Any], x0: list[Any], h: Any) -> tuple[Any, Any]:
    length2 = sum(v * v for v in x0)
    energy2 = sum(p * v * v for p, v in zip(m, x0, strict=True))
    low, b, high = sorted(range(3), key=lambda i: m[i])
    c, a = (high, low) if energy2 > m[b] * length2 else (low, high)
    over = energy2 - m[c] * length2
    under = m[a] * length2 - energy2
    complement = (m[a] - m[c]) * (m[b] * length2 - energy2) / ((m[b] - m[c]) * under)
    modulus = 1 - complement
    right = 1 if x0[c] >= 0 else -1
    size = [mpf(0)] * 3
    size[a] = mp.sqrt(over / (m[a] - m[c])) * (-1 if complement == 0 and x0[a] < 0 else 1)
    parity = 1 if (b - a) % 3 == 1 else -1
    size[b] = mp.sqrt(over / (m[b] - m[c])) * parity * right * (1 if m[b] > m[c] else -1) * mp.sign(size[a])
    size[c] = mp.sqrt(under / (m[a] - m[c])) * right
    rate = mp.sqrt((m[b] - m[c]) * under)
    length = mp.sqrt(length2)
    cosine, sine = x0[a] / size[a], x0[b] / size[b]
    if complement == 0:
        u0 = mp.asinh(sine / cosine)
        ends = (u0, u0 + rate * h)
        sn, cn, dn = mp.tanh(ends[1]), mp.sech(ends[1]), mp.sech(ends[1])
    else:
        phi = mp.atan2(sine, cosine)
        u = mp.ellipf(phi, modulus) + rate * h
        sn, cn, dn = (mp.ellipfun(name, u=u, m=modulus) for name in ("sn", "cn", "dn"))
        turns = mp.nint(u / (4 * mp.ellipk(modulus)) - mp.atan2(sn, cn) / (2 * mp.pi))
        ends = (phi, mp.atan2(sn, cn) + 2 * mp.pi * turns)
    x = [mpf(0)] * 3
    x[a], x[b], x[c] = size[a] * cn, size[b] * sn, size[c] * dn
    nu = (m[b] - m[a]) / (m[b] - m[c])
    third = [_third_kind(nu, end, modulus) for end in ends]
    psi = length * m[c] * h + length * (m[a] - m[c]) / rate * (third[1] - third[0])
    turn = mp.matrix([[mp.cos(psi), -mp.sin(psi), 0], [mp.sin(psi), mp.cos(psi), 0], [0, 0, 1]])
    return x, _frame(x0, c, length).T * turn * _frame(x, c, length)


def _third_kind(nu: Any, end: Any, modulus: Any) -> Any:
    """Return the integral up to an angle, or up to the argument u on the separatrix."""
    if modulus == 1:
        root = mp.sqrt(-nu)
        return (end + root * mp.atan(root * mp.tanh(end))) / (1 - nu)
    return mp.ellippi(nu, end, modulus)


def _frame(x: list[Any], c: int, length: Any) -> Any:
    """Return the rows e_c cross n, n cross that, and n = x/|x|."""
    n = [v / length for v in x]
    axis = [mpf(i == c) for i in range(3)]
    first = _cross(axis, n)
    norm = mp.sqrt(sum(v * v for v in first))
    first = [v / norm for v in first]
    return mp.matrix([first, _cross(n, first), n])


def _cross(u: list[Any], v: list[Any]) -> list[Any]:
    return [u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3] for i in range(3)]


def _rotation(w: list[Any]) -> Any:
    angle = mp.sqrt(sum(v * v for v in w))
    if angle == 0:
        return mp.eye(3)
    n = [v / angle for v in w]
    K = mp.matrix([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    return mp.eye(3) + mp.sin(angle) * K + 2 * mp.sin(angle / 2) ** 2 * (K * K)


def taylor_motion(m: Sequence[float], x0: Sequence[Any], h: float, steps: int, order: int = 60) -> tuple[Any, Any]:
    """Return the same by Taylor series of the equations of motion."""
    with mp.workdps(DIGITS + 10):
        m, x, s = [mpf(v) for v in m], [mpf(v) for v in x0], mpf(h) / steps
        A = mp.eye(3)
        for _ in range(steps):
            X, R = [[v] for v in x], [[[mpf(i == j)] for j in range(3)] for i in range(3)]
            for n in range(order):
                W = [[p * v for v in row] for p, row in zip(m, X, strict=True)]
                new = [_term(X[i - 2], W[i - 1], n) - _term(X[i - 1], W[i - 2], n) for i in range(3)]
                for row in R:
                    turned = [_term(row[i - 2], W[i - 1], n) - _term(row[i - 1], W[i - 2], n) for i in range(3)]
                    for entry, value in zip(row, turned, strict=True):
                        entry.append(value / (n + 1))
                for entry, value in zip(X, new, strict=True):
                    entry.append(value / (n + 1))
            x = [mp.polyval(row[::-1], s) for row in X]
            A = A * mp.matrix([[mp.polyval(entry[::-1], s) for entry in row] for row in R])
        return x, A


def _term(u: list[Any], v: list[Any], n: int) -> Any:
    return mp.fdot(u[: n + 1], v[n::-1])
