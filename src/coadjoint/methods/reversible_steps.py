"""Reversible steps of a symmetric scheme, with lengths that follow the speed of the motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import IntegrationError
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.invariants import invariants_table
from coadjoint.kernels.tables.steps import INNER_LOOP_INDEX, STEP_LOOP, inner_loop_integers, named_step_tables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.numerics.taylor_series import TOO_MANY_STEPS_MESSAGE
from coadjoint.methods.protocol.composed import Wrapper, check_base
from coadjoint.methods.protocol.method import SIZE_SAMPLES, FinerRun, Method, Representation
from coadjoint.methods.protocol.properties import Properties
from coadjoint.methods.splitting import Splitting
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.shortcuts import of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_number

NO_STEP_MESSAGE = (
    "the speed of the motion fell to zero or below (a smaller stride may help), or grew until the steps no longer "
    f"change the time, {TOO_MANY_STEPS_MESSAGE}"
)
MAX_STEPS = 10**7
"""Largest number of steps in Python."""


@suggest_keywords
@dataclass(frozen=True)
class ReversibleSteps(Wrapper):
    """A symmetric scheme whose step length follows the speed of the motion, in a reversible way.

    The controller of Hairer and Soederlind: with the speed Q(x) of the motion, step n has the length stride / rho_n,
    and ``rho_(n+1) = rho_n + stride Q'/Q`` at the state between them; rho_0 is Q, advanced by half a step. States
    and rho together are a reversible map: for integrable or nearly integrable motions energy and actions do not drift,
    unlike with steps controlled by an error estimate. The steps are those of the base: the Casimirs that it preserves
    are preserved, and the energy if the base preserves it. A step of varying length is not a Poisson map.

    Choose it for long runs in which the motion is much faster at some times than at others: close encounters, a falling
    top, scattering particles. If the speed hardly varies, the base alone at a constant step is better; for accuracy
    over short times, `Taylor` with a tolerance is. The step of a run is the distance of output points; the state at an
    output point is computed by a fraction of a step of the base, and does not affect the motion.

    Parameters
    ----------
    base : Method
        A symmetric scheme: a splitting of even order, a Gauss-Legendre method, a composition.
    stride : float
        Length of a step times the speed: roughly the angle in radians, or the relative change of the momentum, of a
        step. The error is proportional to stride^order, with the order of the base.
    speed : Quadratic or Polynomial, optional
        A polynomial of the state that is positive along the motion; in files a list of its terms, ``[coefficient,
        [exponent of x1, exponent of x2, ...]]``. None is the root mean square size of the matrix D, x' = D x with grad
        H held constant: the rate at which flows rotate, shear and stretch. It is required for systems without a Lie
        algebra.

    Raises
    ------
    TypeError, ValueError
        The base is not a symmetric scheme; the stride is not positive; the speed is not of these types.

    References
    ----------
    E. Hairer, G. Soederlind, Explicit, time reversible, adaptive step size control, SIAM J. Sci. Comput. 26 (2005)
    1838; E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, VIII.3.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> chain = co.systems.toda(5)
    >>> x0 = np.concatenate([np.zeros(5), np.full(4, 0.5)])
    >>> method = co.ReversibleSteps(co.Splitting(order=4), stride=0.1)
    >>> sol = co.integrate(chain, x0, t_span=(0, 100), step=10.0, method=method)
    >>> bool(abs(sol.x[-1] - chain.exact(x0, 100.0)).max() < 1e-5), sol.stats.evaluations > 0
    (True, True)
    """

    base: Method
    stride: float = 0.1
    speed: Quadratic | Polynomial | Sequence[Any] | None = None

    symmetric = False
    compensates = False
    fixed_steps = of("base")
    work = of("base.work")

    def __post_init__(self) -> None:
        check_base(self.base, "ReversibleSteps", "Splitting(order=2)")
        if self.base.own_steps:
            raise ValueError(f"{self.base} already chooses its own steps; give ReversibleSteps the base of it")
        if not self.base.symmetric:
            raise ValueError(
                f"ReversibleSteps needs a symmetric base, which {self.base} is not"
                f"{'; ' + self.base.instead if self.base.instead else '; take Splitting(order=2) or GaussLegendre()'}"
            )
        stride = read_number(self.stride, "stride of ReversibleSteps")
        if not stride > 0.0:
            raise ValueError(f"stride of ReversibleSteps is {stride:g}; it must be positive, such as 0.1")
        object.__setattr__(self, "stride", stride)
        if isinstance(self.speed, list | tuple):
            object.__setattr__(self, "speed", _speed_of_terms(self.speed))
        if not (self.speed is None or isinstance(self.speed, Quadratic | Polynomial)):
            raise TypeError(f"speed of ReversibleSteps is {short(self.speed)}; it must be a Quadratic or a Polynomial")

    @property
    def own_steps(self) -> bool:
        return True

    @property
    def failures(self) -> Mapping[str, str]:  # type: ignore[override]
        """Those of the base, and a vanishing speed."""
        return {"UNDEFINED": NO_STEP_MESSAGE} | dict(self.base.failures)

    @classmethod
    def examples(cls) -> Sequence[ReversibleSteps]:
        """Return steps of flows and of stages."""
        return [cls(Splitting(order=2)), cls(GaussLegendre(2), 0.2)]

    def properties(self, system: System) -> Properties:
        """Return those of the base except the bracket: variable steps are no Poisson maps."""
        check_vector_states(system)
        declared = self.base.properties(system)
        if system.hamiltonian.timed:
            raise ValueError(
                "ReversibleSteps follows a speed that depends on the state alone, but the Hamiltonian of "
                f"{system.name} depends on time; take {self.base} at a constant step"
            )
        self._speed(system)
        return replace(declared, poisson=False, reversible=True)

    def _speed(self, system: System) -> Any:
        """Return the polynomial that is the speed, or the quadratic form of grad H of which it is the square root."""
        return _square_of_generators(system) if self.speed is None else _speed_of_system(system, self.speed)

    def compiled(self, system: System, h: float, representation: Representation) -> CompiledLoop:
        # Angles are scaled to the length of each step from a unit step, so that bits do not depend on output points.
        inner = self.base.loop(system, math.copysign(1.0, h), representation)
        integers, keepalive = inner_loop_integers(inner, system, representation)
        speed_table = invariants_table([("the speed", self._speed(system))], system.dim)
        step = f"reversible_{'generator' if self.speed is None else 'given'}"
        tables = named_step_tables(system, step, speed_table, integers, representation, keepalive, [self.stride])
        return loop_over(STEP_LOOP, tables, referenced={INNER_LOOP_INDEX: inner})

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return the motion over h by variable steps from a fresh start, in NumPy for any number type."""
        self.properties(system)
        speed, y, elapsed = self._speed(system), np.array(x), 0 * h
        rho = None
        for _ in range(MAX_STEPS):
            length, rho = self._length(system, speed, y, t, h, rho)
            remaining = h - elapsed
            if abs(remaining.real) <= abs(length.real):
                return np.asarray(self.base.step(system, y, t + elapsed, remaining)) if remaining != 0 else y
            y = np.asarray(self.base.step(system, y, t + elapsed, length))
            elapsed = elapsed + length
            if not abs(length.real) > UNIT_ROUNDOFF * abs(elapsed.real):
                break
        raise IntegrationError(
            "its steps became so short that they no longer change the time",
            step=1,
            time=float(t),
            residual=0.0,
        )

    def next_length(self, system: System, x: NDArray[np.float64], h: float, memory: Any) -> tuple[float, Any]:
        return self._length(system, self._speed(system), x, 0.0, h, memory)

    def _length(self, system: System, speed: Any, x: NDArray[Any], t: Any, h: Any, rho: Any) -> tuple[Any, Any]:
        """Return the length of the next step from a state, and rho, from that of the step before."""
        # The speed Q at the state, and its rate of change Q' / Q along the motion.
        f = system.vector_field(x)
        if self.speed is None:
            slope, change = system.hamiltonian.gradient(x, 0.0), np.dot(system.hamiltonian.hessian(x, 0.0), f)
            square = speed.value(slope)
            Q, rate = square**0.5, np.dot(speed.gradient(slope), change) / (2 * square)
        else:
            Q = speed.value(x) if isinstance(speed, Quadratic) else speed(x)
            rate = np.dot(speed.gradient(x), f) / Q
        rate = rate if h.real > 0 else -rate
        rho = Q + self.stride * rate / 2 if rho is None else rho + self.stride * rate
        if not (rho.real > 0 and Q.real > 0):
            raise IntegrationError(NO_STEP_MESSAGE, step=1, time=float(t), residual=float(rho.real))
        return (self.stride / rho if h.real > 0 else -(self.stride / rho)), rho

    def finer(self, steps: int, times: float) -> FinerRun:
        """Return a run with a shorter stride, whose output points only sample the size of the motion."""
        return FinerRun(replace(self, stride=self.stride / times), max(steps, SIZE_SAMPLES), times**-self.order)


def _speed_of_terms(terms: Sequence[Any]) -> Polynomial:
    try:
        return Polynomial({tuple(powers): coefficient for coefficient, powers in terms})
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"speed of ReversibleSteps is {short(terms)}: {error}; give a Quadratic, a Polynomial, or terms such as "
            "[[0.5, [0, 0, 0]], [1.0, [2, 0, 0]]]"
        ) from None


def _speed_of_system(system: System, speed: Any) -> Any:
    if isinstance(speed, Quadratic):
        return speed.bind(system.dim)
    if speed.dim != system.dim:
        raise ValueError(f"speed is a polynomial in {speed.dim} coordinates, and {system.name} has {system.dim}")
    return speed


def _square_of_generators(system: System) -> Quadratic:
    """Return the mean square size of D, x' = D x, as a quadratic form of the gradient of H."""
    algebra = system.algebra
    if algebra is None:
        raise ValueError(
            f"ReversibleSteps finds the speed from a Lie algebra, which {system.name} does not have; give speed=, a "
            "Polynomial that is positive"
        )
    square = _mean_square_of_generators(algebra)
    if square is None:
        raise ValueError(f"all brackets of {algebra} are zero, so that every state is at rest; take any scheme")
    return square


@lru_cache(maxsize=64)
def _mean_square_of_generators(algebra: Any) -> Quadratic | None:
    """Return u -> |D_u|^2 / n with D_u x = J(x) u as a quadratic form; None if all brackets are zero."""
    from scipy import sparse

    i, j, k, c = algebra.triples
    n = algebra.dim
    if not len(c):
        return None
    # J_ij(x) = c x_k: entry (i, k) of D_u has c u_j, and entry (j, k) has -c u_i.
    rows, columns = np.concatenate([i * n + k, j * n + k]), np.concatenate([j, i])
    positions, entry = np.unique(rows, return_inverse=True)
    C = sparse.csr_array((np.concatenate([c, -c]), (entry, columns)), shape=(len(positions), n))
    return Quadratic(sparse.csr_array(C.T @ C) * (2.0 / n))
