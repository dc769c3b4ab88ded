"""A Hamiltonian of a kind of its own: a quadratic energy with a soft wall in one coordinate (docs/extending.md)."""

import numpy as np

import coadjoint as co


class Walled:
    """0.5 x.Mx + cosh(stiffness x_i), M diagonal."""

    timed = False

    def __init__(self, M, i, stiffness, dim=None):
        self.M, self.i, self.stiffness, self.dim = np.asarray(M, dtype=float), i, stiffness, dim

    def bind(self, n):
        """Return the same for dimension n; refuse what does not fit."""
        if len(self.M) != n:
            raise ValueError(f"M has {len(self.M)} entries, and the system {n} coordinates")
        return Walled(self.M, self.i, self.stiffness, n)

    def value(self, x, t=0.0):
        return 0.5 * np.dot(x, self.M * x) + np.cosh(self.stiffness * x[self.i])

    def gradient(self, x, t=0.0):
        found = self.M * x
        found[self.i] += self.stiffness * np.sinh(self.stiffness * x[self.i])
        return found

    def hessian(self, x, t=0.0):
        found = np.diag(self.M)
        found[self.i, self.i] += self.stiffness**2 * np.cosh(self.stiffness * x[self.i])
        return found

    def terms(self):
        k = self.stiffness
        wall = co.systems.FunctionTerm(
            np.array([self.i]),
            value=lambda y: np.cosh(k * y),
            gradient=lambda y: k * np.sinh(k * y),
            hessian=lambda y: k**2 * np.cosh(k * y),
            scalar=True,  # functions of a number, not of an array
        )
        return (*co.Quadratic(self.M).bind(self.dim).terms(), wall)


walled = co.LiePoissonSystem(co.algebras.so(3), Walled([1, 2, 3], 0, 1.5), name="walled")
sol = co.integrate(walled, (1.0, 0.2, 0.5), (0, 20), 0.05, co.Splitting(order=4))
assert sol.drift()["energy"] < 1e-4 and sol.drift()["|x|^2"] < 1e-14
print(co.Splitting(order=4).describe(walled))
