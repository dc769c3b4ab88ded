"""The heavy top without symmetry in fixed-point arithmetic of 200 bits: a Taylor series, independent of the library."""

from __future__ import annotations

import numpy as np

BITS, ORDER = 200, 36
ONE = 1 << BITS


def fixed(values):
    """Return numbers as whole multiples of 2^-BITS; floats exactly, where they are not too small."""
    found = []
    for value in values:
        numerator, denominator = float(value).as_integer_ratio()
        found.append(numerator * ONE // denominator)
    return found


class Top:
    """m' = m x (m/I) + g x c, g' = g x (m/I), with principal moments of inertia I and the vector c to the centre."""

    def __init__(self, inertia, centre):
        self.inverse = fixed(1.0 / np.asarray(inertia))
        self.centre = fixed(centre)

    def field(self, m, g):
        """Return the coefficients of degree k of m' and g' from those of m and g up to k."""
        k = len(m[0]) - 1
        omega = [[v * w >> BITS for w in row] for v, row in zip(self.inverse, m, strict=True)]

        def times(a, b):
            return sum(a[j] * b[k - j] for j in range(k + 1))

        torque, turn = [], []
        for i in range(3):
            p, q = (i + 1) % 3, (i + 2) % 3
            weight = g[p][k] * self.centre[q] - g[q][k] * self.centre[p]
            torque.append((times(m[p], omega[q]) - times(m[q], omega[p]) + weight) >> BITS)
            turn.append((times(g[p], omega[q]) - times(g[q], omega[p])) >> BITS)
        return torque, turn

    def step(self, x, h):
        """Return the state after a step of the length h, a power of two."""
        m, g = [[v] for v in x[:3]], [[v] for v in x[3:]]
        for k in range(ORDER):
            torque, turn = self.field(m, g)
            for row, slope in zip((*m, *g), (*torque, *turn), strict=True):
                row.append(slope // (k + 1))
        scaled = fixed([h])[0]
        found = []
        for row in (*m, *g):
            total = 0
            for coefficient in reversed(row):
                total = coefficient + (total * scaled >> BITS)
            found.append(total)
        return found

    def flow(self, x, h, steps):
        for _ in range(steps):
            x = self.step(x, h)
        return x
