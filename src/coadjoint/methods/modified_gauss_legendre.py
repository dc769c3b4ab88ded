"""The modified Gauss-Legendre methods: a linear system instead of the last iteration (Lemma 3.1)."""

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
from coadjoint.validation import read_choice

FREEZES = ("structure", "gradient")


@dataclass(frozen=True)
class ModifiedGaussLegendre(RungeKuttaMethod):
    """Gauss-Legendre with m - 1 function iterations and then one linear system: order min(m, 2 s).

    ``X^0 = x``; equation (6) for l = 1, ..., m - 1; then, with Z = X^(m-1), the linear system for X = X^m

    ``freeze="structure"``:  ``X_i = x + h sum_j a_ij sign J(Z_j) grad H(X_j)``  (equation (7)), H quadratic: the energy
    is preserved;

    ``freeze="gradient"``:  ``X_i = x + h sum_j a_ij sign D_u(Z_j) X_j``, u = grad H: every quadratic Casimir is
    preserved,

    and the output ``x_new = x + sum_i b_i`` of the same right-hand sides (equation (8)). ``stages=1`` is the modified
    midpoint rule, equations (10)-(11). Choose it for a fixed cost per step and one invariant to round-off. It is not
    symmetric, so that the other invariant drifts: over long times `GaussLegendre` or `Splitting` is better.

    Parameters
    ----------
    stages : int
        Number of stages s.
    iterations : int, optional
        The number m, from 1; None is 2 s, which gives the full order.
    freeze : {"structure", "gradient"}
        What the linear system evaluates at the iterate Z: the structure matrix (energy exact, the paper's
        M-orthogonality; requires quadratic H, any skew J), or the gradient (quadratic Casimirs exact, I-orthogonality
        on so(3); any H, requires a Lie algebra).

    Raises
    ------
    ValueError
        A number is not a positive integer, or `freeze` is unknown.

    Notes
    -----
    The method is linearly implicit: the system of s n unknowns is solved by LU factors with partial pivoting and one
    refinement up to s n = 160, and above that, matrix-free, by function iteration until the corrections stop falling.

    References
    ----------
    S. Reich 1993, section 3, equations (6)-(8), (10)-(11), Lemma 3.1, Example 3.1.

    Examples
    --------
    >>> import coadjoint as co
    >>> method = co.ModifiedGaussLegendre(stages=2, iterations=3, freeze="gradient")
    >>> method.order, method.explicit, method.symmetric
    (3, False, False)
    """

    stages: int = 1
    iterations: int | None = None
    freeze: str = "structure"

    explicit = False
    symmetric = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", read_stages(self.stages, "stages of ModifiedGaussLegendre"))
        if self.iterations is not None:
            count = read_stages(self.iterations, "iterations of ModifiedGaussLegendre")
            object.__setattr__(self, "iterations", count)
        read_choice(self.freeze, "freeze", FREEZES)

    @property
    def function_iterations(self) -> int:
        """The m - 1 iterations before the linear system."""
        return (2 * self.stages if self.iterations is None else self.iterations) - 1

    @property
    def solver(self) -> str:
        """The value of `freeze`."""
        return self.freeze

    @property
    def order(self) -> int:
        """min(m, 2 s)."""
        return min(self.function_iterations + 1, 2 * self.stages)

    def properties(self, system: System) -> Properties:
        """Return the properties: the energy, or the quadratic Casimirs, are preserved."""
        check_vector_states(system)
        if self.freeze == "structure":
            if not system.has_quadratic_energy:
                raise ValueError(
                    'ModifiedGaussLegendre with freeze="structure" needs a quadratic Hamiltonian, but that of '
                    f'{system.name} is not quadratic; take freeze="gradient" or GaussLegendre'
                )
            return Properties(poisson=False, energy=True, casimirs="none", attitude="none")
        if system.algebra is None:
            raise ValueError(
                'ModifiedGaussLegendre with freeze="gradient" needs a Lie algebra, which '
                f'{system.name} does not have; take freeze="structure" or GaussLegendre'
            )
        return Properties(poisson=False, energy=False, casimirs="quadratic", attitude="coadjoint")

    @property
    def collocation(self) -> list[Fraction]:
        """The Legendre polynomial of degree s on [0, 1]."""
        return node_polynomial(self.stages)

    def coefficients(self, number: Number = float) -> Coefficients:
        """Return the tableau of the Gauss-Legendre method."""
        return gauss_tableau(self.stages, number)
