"""Schemes as a user writes them: in Python, with and without what Numba compiles."""

from __future__ import annotations

import dataclasses

import coadjoint as co

NOTHING = co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")


class Plain(co.methods.StepMethod):
    """A step of first order that preserves nothing."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return NOTHING


@dataclasses.dataclass(frozen=True)
class OwnKahan(Plain):
    """Kahan's method for quadratic fields: x' = x + h (1 - h/2 f'(x))^-1 f(x).

    Eliminated number by number: Numba takes six seconds to compile `np.linalg.solve`, in each process.
    """

    order, explicit, symmetric = 2, False, True

    def step(self, system, x, t, h):
        n, matrix, rest = len(x), -h / 2 * system.jacobian(x, t), h * system.vector_field(x, t)
        for k in range(n):
            matrix[k, k] += 1
        for k in range(n):
            for i in range(n):
                if i != k:
                    factor = matrix[i, k] / matrix[k, k]
                    rest[i] -= factor * rest[k]
                    for j in range(k, n):
                        matrix[i, j] -= factor * matrix[k, j]
        for k in range(n):
            rest[k] /= matrix[k, k]
        return x + rest


@dataclasses.dataclass(frozen=True)
class Classical(Plain):
    """The classical Runge-Kutta method."""

    order, explicit, symmetric = 4, True, False

    def step(self, system, x, t, h):
        k1 = system.vector_field(x, t)
        k2 = system.vector_field(x + h / 2 * k1, t + h / 2)
        k3 = system.vector_field(x + h / 2 * k2, t + h / 2)
        k4 = system.vector_field(x + h * k3, t + h)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclasses.dataclass(frozen=True)
class Interpreted(Plain):
    """What Numba does not compile: an import in the step."""

    def step(self, system, x, t, h):
        import math

        return x + math.fsum([h]) * system.vector_field(x, t)


@dataclasses.dataclass(frozen=True)
class Failing(Plain):
    """A step that raises beyond a time."""

    def step(self, system, x, t, h):
        if t > 0.5:
            raise LookupError(f"nothing is known at t = {t:.1f}")
        return x + h * system.vector_field(x, t)
