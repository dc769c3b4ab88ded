"""The Gauss-Legendre Runge-Kutta methods (equation (5)), iterated (6) and modified ones (7)."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.numerics.gauss_coefficients import extrapolation, gauss_legendre, node_polynomial
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.numbers import Number
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_choice, read_integer


@suggest_keywords
def gauss_tableau(stages: int, number: Number = float) -> Coefficients:
    """Return the tableau of the Gauss-Legendre method: L_j = h b_j f(X_j), X_i = x + sum_j mu_ij L_j.

    Use it for implicit steps of your own; the step adds sum_j L_j.

    Parameters
    ----------
    stages : int
        Number of stages s.
    number : type
        Number type of the coefficients: float, ``mpmath.mpf``, or Fraction for one stage.

    Returns
    -------
    Coefficients
        Nodes c_i, scale b_i, and mix mu_ij = a_ij / b_j. In float64, nodes and weights are correctly rounded, and
        mu_ij + mu_ji = 1 exactly.

    Examples
    --------
    >>> gauss_tableau(1).mix.tolist()
    [[0.5]]
    """
    nodes, weights, mu = gauss_legendre(stages, number)
    return Coefficients(nodes, weights, mu, np.array([number(1)] * stages))


# Largest number of stages or iterations: nodes for more take minutes to compute, and float64 runs gain nothing.
MAX_STAGES = 256  # order 512; coefficients take seconds


def read_stages(value: Any, what: str) -> int:
    """Validate a number of stages or iterations; raise an error that names the parameter."""
    return read_integer(value, what, 1, MAX_STAGES, reason="more would not be more accurate")


@suggest_keywords
@dataclass(frozen=True)
class GaussLegendre(RungeKuttaMethod):
    """The Gauss-Legendre method with s stages: implicit, symmetric, of order 2 s; preserves every quadratic invariant.

    Choose it for high accuracy with any Hamiltonian, with many stages and a large step. (For polynomials `Taylor` is
    mostly cheaper.) The errors of a quadratic energy and of quadratic Casimirs are round-off, which grows like the
    square root of time. It is not a Poisson map unless the bracket is constant (canonical variables), and does not
    preserve Casimirs of higher degree; for these choose `Splitting`. `GaussLegendre(1)` is the implicit midpoint rule.

    The equations are ``X_i = x + h sum_j a_ij f(X_j)``, ``x_new = x + h sum_i b_i f(X_i)`` (equation (5) of the paper).
    They are solved by function iteration until the corrections stop falling, and by Newton's method if that is slow or
    diverges.

    Parameters
    ----------
    stages : int
        Number of stages s, from 1.

    Raises
    ------
    ValueError
        `stages` is not a positive integer.

    Notes
    -----
    A step computes ``L_j = h b_j f(X_j)``, ``X_i = x + sum_j mu_ij L_j``, ``x_new = x + sum_j L_j`` with mu_ij = a_ij /
    b_j, rounded such that mu_ij + mu_ji = 1 exactly, and with compensated summation. The initial guess of the stages is
    the extrapolated previous step. Convergence is tested from the iteration in which it was reached in the previous
    step. Both are part of the state of a run, so that an interrupted and resumed run has the same bits. If function
    iteration fails, Newton's method starts from X_i = x. It uses a dense matrix for up to 200 unknowns, above that a
    banded one if an ordering of narrow bandwidth exists, and otherwise GMRES without a matrix.

    References
    ----------
    S. Reich 1993, section 3, equation (5); E. Hairer, R. McLachlan, A. Razakarivony, BIT 48 (2008) 231, on round-off.

    Examples
    --------
    >>> import coadjoint as co
    >>> method = co.GaussLegendre(stages=3)
    >>> method.order, method.explicit, method.symmetric
    (6, False, True)
    """

    stages: int = 2

    explicit = False
    symmetric = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", read_stages(self.stages, "stages of GaussLegendre"))

    @property
    def solver(self) -> str:
        return "implicit"

    @property
    def order(self) -> int:
        """2 s."""
        return 2 * self.stages

    def properties(self, system: System) -> Properties:
        """Return the properties: quadratic invariants and a constant bracket; every system is supported."""
        check_vector_states(system)
        attitude = "none" if system.algebra is None else "coadjoint"
        poisson, energy = _has_constant_bracket(system), system.has_quadratic_energy
        return Properties(poisson=poisson, energy=energy, casimirs="quadratic", attitude=attitude)

    @property
    def collocation(self) -> list[Fraction]:
        return node_polynomial(self.stages)

    def coefficients(self, number: Number = float) -> Coefficients:
        return gauss_tableau(self.stages, number)

    def forecast(self, ratio: float) -> NDArray[np.float64]:
        return extrapolation(self.stages, ratio)


def _has_constant_bracket(system: System) -> bool:
    """Whether J(x) is constant; the schemes are then symplectic (J. Sanz-Serna, BIT 28 (1988) 877)."""
    triples = getattr(system.algebra, "triples", None)
    return triples is not None and not np.intersect1d(triples.k, np.concatenate([triples.i, triples.j])).size


@suggest_keywords
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
        name = type(self).__name__
        object.__setattr__(self, "stages", read_stages(self.stages, f"stages of {name}"))
        if self.iterations is not None:
            object.__setattr__(self, "iterations", read_stages(self.iterations, f"iterations of {name}"))

    @property
    def function_iterations(self) -> int:
        return 2 * self.stages - 1 if self.iterations is None else self.iterations

    @property
    def solver(self) -> str:
        return "iterated"

    @property
    def order(self) -> int:
        """The number of function iterations and 1, at most 2 s."""
        return min(self.function_iterations + 1, 2 * self.stages)

    def properties(self, system: System) -> Properties:
        """Return the properties: only linear invariants are preserved; every system is supported."""
        check_vector_states(system)
        return Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    @property
    def collocation(self) -> list[Fraction]:
        return node_polynomial(self.stages)

    def coefficients(self, number: Number = float) -> Coefficients:
        return gauss_tableau(self.stages, number)


FREEZES = ("structure", "gradient")


@suggest_keywords
@dataclass(frozen=True)
class ModifiedGaussLegendre(IteratedGaussLegendre):
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

    def __post_init__(self) -> None:
        super().__post_init__()
        read_choice(self.freeze, "freeze", FREEZES)

    @property
    def function_iterations(self) -> int:
        """The m - 1 iterations before the linear system."""
        return (2 * self.stages if self.iterations is None else self.iterations) - 1

    @property
    def solver(self) -> str:
        return self.freeze

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
