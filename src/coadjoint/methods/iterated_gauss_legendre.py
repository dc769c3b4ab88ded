"""Gauss-Legendre methods stopped after a fixed number of function iterations (equation (6))."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from coadjoint.methods.gauss_legendre import gauss_tableau, read_stages
from coadjoint.methods.numerics.gauss_coefficients import node_polynomial
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states


@dataclass(frozen=True)
class IteratedGaussLegendre(RungeKuttaMethod):
    """A fixed number m of function iterations of a Gauss-Legendre method: explicit, of order min(m + 1, 2 s).

    ``X_i^0 = x``, ``X_i^l = x + h sum_j a_ij f(X_j^(l-1))`` (equation (6)), and ``x_new = x + h sum_i b_i f(X_i^m)``.
    The method is explicit, without a step-size restriction from convergence; energy and Casimirs drift slowly, by
    O(h^(m+1)) or better. If they must be preserved, choose `GaussLegendre` or `ModifiedGaussLegendre`.

    Parameters
    ----------
    stages : int
        Number of stages s.
    iterations : int, optional
        Number m of iterations, from 1; None is 2 s - 1, which gives the full order.

    Raises
    ------
    ValueError
        `stages` or `iterations` is not a positive integer.

    Notes
    -----
    The paper uses m = p = 2 s iterations; one fewer suffices, since the output evaluates f once more.

    References
    ----------
    S. Reich 1993, section 3, equation (6).

    Examples
    --------
    >>> import coadjoint as co
    >>> co.IteratedGaussLegendre(stages=2).order, co.IteratedGaussLegendre(stages=2, iterations=1).order
    (4, 2)
    """

    stages: int = 2
    iterations: int | None = None

    explicit = True
    symmetric = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", read_stages(self.stages, "stages of IteratedGaussLegendre"))
        if self.iterations is not None:
            count = read_stages(self.iterations, "iterations of IteratedGaussLegendre")
            object.__setattr__(self, "iterations", count)

    @property
    def function_iterations(self) -> int:
        """The number m of iterations."""
        return 2 * self.stages - 1 if self.iterations is None else self.iterations

    @property
    def solver(self) -> str:
        """``"iterated"``."""
        return "iterated"

    @property
    def order(self) -> int:
        """min(m + 1, 2 s)."""
        return min(self.function_iterations + 1, 2 * self.stages)

    def properties(self, system: System) -> Properties:
        """Return the properties: only linear invariants are preserved; every system is supported."""
        check_vector_states(system)
        return Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    @property
    def collocation(self) -> list[Fraction]:
        """The Legendre polynomial of degree s on [0, 1]."""
        return node_polynomial(self.stages)

    def coefficients(self, number: Number = float) -> Coefficients:
        """Return the tableau of the Gauss-Legendre method."""
        return gauss_tableau(self.stages, number)
