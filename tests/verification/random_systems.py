"""Random systems for tests of both signs, both directions and every order of the axes."""

from __future__ import annotations

from functools import cache

import numpy as np

import coadjoint as co

# With representations that the algebra has itself, unimodular and not; none is symmetric under an exchange of axes.
ALGEBRAS = {
    "so(3)": lambda: co.algebras.so(3),
    "sl(2)": lambda: co.algebras.sl(2),
    "A3,7": lambda: co.algebras.A3_7(0.75),
    "A4,7": lambda: co.algebras.get("A4,7"),
    "so(4)": lambda: co.algebras.so(4),
    "so(2,2)": lambda: co.algebras.so(2, 2),
    "e(3)": lambda: co.algebras.e(3),
    "A5,40": lambda: co.algebras.get("A5,40"),
}


def drawn(name: str, seed: int, sign: int) -> tuple[co.LiePoissonSystem, np.ndarray]:
    """Return a system with a full M and a linear term, and a state of size one."""
    algebra, rng = ALGEBRAS[name](), np.random.default_rng(seed)
    n = algebra.dim
    B = rng.uniform(-0.25, 0.25, (n, n))
    H = co.Quadratic(np.diag(rng.uniform(0.5, 1.5, n)) + B + B.T, linear=rng.uniform(-0.25, 0.25, n))
    x0 = rng.uniform(0.4, 1.0, n) * rng.choice([-1.0, 1.0], n)
    return co.LiePoissonSystem(algebra, H, sign=sign, casimirs={}), x0 / np.linalg.norm(x0)


@cache
def curl_bracket(seed: int):
    """Return J(x) = hat(x + a x1 x) and its derivative: skew, not linear, without symmetry under exchange of axes."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(0.25, 0.75, 3) * rng.choice([-1.0, 1.0], 3)

    def structure(x):
        w0, w1, w2 = x[0] + a[0] * x[1] * x[2], x[1] + a[1] * x[0] * x[0], x[2] + a[2] * x[0] * x[1]
        return np.array([[0.0 * w0, -w2, w1], [w2, 0.0 * w0, -w0], [-w1, w0, 0.0 * w0]])

    def derivative(x):
        dw = np.array(
            [
                [1.0, a[0] * x[2], a[0] * x[1]],
                [2.0 * a[1] * x[0], 1.0, 0.0],
                [a[2] * x[1], a[2] * x[0], 1.0],
            ]
        )
        d = np.zeros((3, 3, 3))
        d[0, 1], d[1, 0], d[0, 2], d[2, 0], d[1, 2], d[2, 1] = -dw[2], dw[2], dw[1], -dw[1], -dw[0], dw[0]
        return d

    return structure, derivative


def drawn_bracket(seed: int, sign: int) -> tuple[co.PoissonSystem, np.ndarray]:
    """Return a system whose J is a function of x, and a state of size one."""
    rng = np.random.default_rng(seed)
    # The same functions every time: each is compiled once.
    structure, derivative = curl_bracket(seed)
    B = rng.uniform(-0.25, 0.25, (3, 3))
    H = co.Quadratic(np.diag(rng.uniform(0.5, 1.5, 3)) + B + B.T)
    x0 = rng.uniform(0.4, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    return co.PoissonSystem(structure, H, sign=sign, dim=3, derivative=derivative), x0 / np.linalg.norm(x0)
