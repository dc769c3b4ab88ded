"""The quartic integral of Kovalevskaya's top, for any order of the axes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.bodies.inertia import principal


def kovalevskaya_integral(M: npt.NDArray[np.float64], lever: npt.NDArray[np.float64]) -> Polynomial | None:
    """Return ``|(m_a + i m_b)^2 / (2 A) - (l_a + i l_b)(gamma_a + i gamma_b)|^2`` in six coordinates, or None.

    The top has it if the inverse inertia M, (3,) or (3, 3), is 1/A, 1/A and 2/A along coordinates a, b, c, and `lever`,
    weight times position of the center of mass, is orthogonal to c.

    Examples
    --------
    >>> kovalevskaya_integral(np.array([1.0, 1.0, 2.0]), np.zeros(3))
    0.25*x1^4 + 0.5*x1^2*x2^2 + 0.25*x2^4
    """
    m = principal(M)
    if m is None:
        return None
    for c in range(3):
        a, b = (c + 1) % 3, (c + 2) % 3
        if m[a] == m[b] and m[c] == 2.0 * m[a] and lever[c] == 0.0:
            half, u, v = 0.5 * float(m[a]), float(lever[a]), float(lever[b])
            ma, mb, ga, gb = (Polynomial.variable(i, 6) for i in (a, b, a + 3, b + 3))
            real = half * (ma**2 - mb**2) - (u * ga - v * gb)
            imaginary = 2.0 * half * ma * mb - (u * gb + v * ga)
            return real**2 + imaginary**2
    return None
