"""Systems with short exact constants, and what is known of the fields of schemes on them, written out."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import coadjoint as co
from moments import moments

ALGEBRAS = {
    "so(3)": lambda: co.algebras.so(3),
    "e(3)": lambda: co.algebras.e(3),
    "so(4)": lambda: co.algebras.so(4),
    "A3,7": lambda: co.algebras.A3_7(0.5),
    "moments": moments,
    "A4,7": lambda: co.algebras.get("A4,7"),
}


def whole(name: str, sign: int = 1, seed: int = 3, linear: bool = False) -> co.LiePoissonSystem:
    """Return a system with a full M of eighths, and on demand a linear term."""
    algebra, rng = ALGEBRAS[name](), np.random.default_rng(seed)
    n = algebra.dim
    B = rng.integers(-2, 3, (n, n)) / 8
    M = np.diag(1 + np.arange(n) / 4) + B + B.T
    H = co.Quadratic(M, linear=rng.integers(1, 5, n) / 8 if linear else None)
    return co.LiePoissonSystem(algebra, H, sign=sign)


def field_of(system) -> list[co.Polynomial]:
    """Return sign J(x) grad H as polynomials."""
    return motion_by(system, [gradient_entry(system, i) for i in range(system.dim)])


def motion_by(system, slopes) -> list[co.Polynomial]:
    """Return sign J(x) slopes as polynomials, from the dense constants."""
    n, g = system.dim, system.algebra
    unit = np.eye(n)
    found = [co.Polynomial({}, dim=n)] * n
    for i in range(n):
        for j in range(n):
            for k, c in enumerate(g.bracket(unit[i], unit[j])):
                if c:
                    found[i] = found[i] + slopes[j] * co.Polynomial.variable(k, n) * Fraction(float(c)) * system.sign
    return found


def gradient_entry(system, i: int) -> co.Polynomial:
    n, H = system.dim, system.hamiltonian
    at_zero = H.gradient(np.zeros(n))
    total = co.Polynomial({(0,) * n: Fraction(float(at_zero[i]))}, dim=n)
    for j in range(n):
        total = total + co.Polynomial.variable(j, n) * Fraction(float(H.hessian(np.zeros(n))[i, j]))
    return total


def along(field, F) -> co.Polynomial:
    """Return F'(x) field."""
    return sum((F.derivative(i) * f for i, f in enumerate(field)), co.Polynomial({}, dim=F.dim))


def elementary(f):
    """Return f'f, f'f'f and f''(f, f)."""
    first = [along(f, F) for F in f]
    inner = [along(first, F) for F in f]
    bent = [along(f, along(f, F)) - G for F, G in zip(f, inner, strict=True)]
    return first, inner, bent
