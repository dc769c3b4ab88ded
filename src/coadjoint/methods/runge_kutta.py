"""Runge-Kutta methods: the step and its exact derivative, read in NumPy for any number type."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.base import Representation
from coadjoint.methods.stages import Coefficients, Step, begin
from coadjoint.methods.stepped import SteppedMethod
from coadjoint.program.numbers import Number, roundoff
from coadjoint.systems.kinds import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.methods.work import Work

MOST_ITERATIONS = 200  # for 53 bits; in proportion for more
GROWTH = 2**64  # of the first correction: a correction so much larger will not come back


class Evaluation(NamedTuple):
    """The slopes L of a step, shape (s, n), and, where asked for, their derivatives dL / dx, shape (s, n, n)."""

    slopes: NDArray[Any]
    derivatives: NDArray[np.float64] | None


class RungeKuttaMethod(SteppedMethod):
    """A tableau and a solver. A new scheme says what its coefficients are and how it finds its slopes."""

    @property
    @abstractmethod
    def solver(self) -> str:
        """How the compiled loop finds the slopes.

        ``"explicit"``, ``"iterated"``, ``"implicit"``, or linear with ``"structure"`` or ``"gradient"`` frozen.
        """

    @property
    def function_iterations(self) -> int:
        """How many iterations come before the output, or before the linear system; implicit schemes do not say."""
        return 0

    def forecast(self, ratio: float) -> NDArray[np.float64]:
        """Return the matrix E of the starting values X_i = x + sum_j E_ij L_j, L the slopes of the substep before.

        Parameters
        ----------
        ratio : float
            Length of the substep in units of the one before it.

        Returns
        -------
        (s, s) array
            Zero, so that X_i = x, unless the scheme knows better; only implicit ones are asked.
        """
        return np.zeros_like(self.coefficients().mix)

    @abstractmethod
    def coefficients(self, number: Number = float) -> Coefficients:
        """Return the tableau.

        Parameters
        ----------
        number : callable
            Number type.

        Returns
        -------
        Coefficients
        """

    @abstractmethod
    def evaluate(self, step: Step, tangent: bool = False) -> Evaluation:
        """Return the slopes of a step, with their derivatives if `tangent`.

        Parameters
        ----------
        step : Step
            Where the step starts.
        tangent : bool
            Whether derivatives are wanted.

        Returns
        -------
        Evaluation
        """

    def loop_of_substeps(
        self, system: System, h: float, representation: Representation, fractions: Sequence[float]
    ) -> CompiledLoop:
        """Return the loop over stages, for this tableau and solver."""
        from coadjoint.kernels import runge_kutta
        from coadjoint.kernels.loop import CompiledLoop
        from coadjoint.kernels.runge_kutta_tables import runge_kutta_tables

        found = runge_kutta_tables(system, self, representation, fractions)
        return CompiledLoop(runge_kutta.LOOP, found.tables, found.keep, memory=runge_kutta.memory_of(found.tables))

    def work_of_substeps(self, system: System, group: Representation, substeps: int) -> Work:
        """Return the work of the iterations that a step takes."""
        from coadjoint.methods.work import work_of_iterations

        return work_of_iterations(system, group)

    def took_newton(self, memory: NDArray[np.float64]) -> bool:
        """Return whether any member still begins with Newton's method: implicit schemes remember that first."""
        return bool(np.any(memory[:, :1] > 0.0))

    def step(self, system: System, x: Any, t: Any, h: Any) -> NDArray[Any]:
        """Return one step, as the formulas say it, without compensation.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.
        x : (n,) array
            The state: floats, or objects such as ``mpmath.mpf``, in whose precision everything is then computed.
        t, h : number
            Time at the start, and length of the step.

        Returns
        -------
        (n,) array

        Raises
        ------
        IntegrationError
            The iteration of an implicit scheme does not converge.
        """
        step = begin(self.coefficients, system, x, t, h)
        return np.asarray(step.x + step.coefficients.out @ self.evaluate(step).slopes)

    def tangent(self, system: System, x: Any, t: float, h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return one step and its exact derivative.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system; its Hamiltonian must have second derivatives, and a `PoissonSystem` the derivative of J.
        x : (n,) array
            The state.
        t, h : float
            Time at the start, and length of the step.

        Returns
        -------
        x_new : (n,) array
            The step.
        P : (n, n) array
            Its derivative with respect to x.

        Raises
        ------
        TypeError
            A derivative is not known.
        IntegrationError
            The iteration of an implicit scheme does not converge.
        """
        step = begin(self.coefficients, system, np.asarray(x, dtype=np.float64), t, h)
        slopes, derivatives = self.evaluate(step, tangent=True)
        if derivatives is None:
            raise TypeError(f"{self} gives no derivatives")
        out = step.coefficients.out
        return step.x + out @ slopes, np.eye(step.x.size) + np.einsum("j,jab->ab", out, derivatives)


def iterate(step: Step, count: int) -> list[NDArray[Any]]:
    """Return the function iterates X^0 = x, X^1, ..., X^count of equation (6), each of shape (s, n)."""
    iterates = [step.start()]
    for _ in range(count):
        iterates.append(step.points(step.fields(iterates[-1])))
    return iterates


def iterate_tangents(step: Step, iterates: list[NDArray[Any]]) -> NDArray[np.float64]:
    """Return the derivative of the last of the function iterates, shape (s, n, n)."""
    spread = step.spread(np.zeros((len(step.times), step.x.size, step.x.size)))
    for points in iterates[:-1]:
        spread = step.spread(step.jacobians(points) @ spread)
    return spread


def settle(step: Step, slopes_at: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Iterate X = x + mix L(X) until the correction no longer falls, and return the last slopes L.

    Parameters
    ----------
    step : Step
        Where the step starts.
    slopes_at : callable
        The slopes at given stages.

    Returns
    -------
    (s, n) array

    Raises
    ------
    IntegrationError
        The iteration does not converge.
    """
    unit = roundoff(float if step.x.dtype != object else type(step.x[0]))
    if unit == 0:
        raise TypeError("the stages solve equations that exact fractions do not settle: take floats or mpmath.mpf")
    most = MOST_ITERATIONS * max(1, int(-np.log2(float(unit)) / 53))
    points, least, quiet, largest, first = step.start(), None, 0, None, 0
    with np.errstate(over="ignore", invalid="ignore"):  # a divergent iteration is told from its last correction
        for iteration in range(1, most + 1):
            slopes = slopes_at(points)
            new = step.points(slopes)
            change = np.max(np.abs(new - points), axis=0)
            points, largest, size = new, max(change), max(np.max(np.abs(new), axis=0))
            if largest == 0:
                return slopes
            first = largest if iteration == 1 else first
            if not largest <= GROWTH * first:
                break
            falling = least is None or bool(np.any(change < least))
            least = change if least is None else np.minimum(change, least)
            quiet = quiet + 1 if iteration > 3 and not falling and largest <= 2**21 * unit * size else 0
            if quiet >= max(2, iteration // 4):  # the more slowly corrections shrink, the longer they may turn
                return slopes
    residual = float(largest) if largest is not None else float("nan")
    raise IntegrationError(
        f"the stages of a step do not converge (last correction {residual:.3g}); take a smaller step",
        step=1,
        time=float(step.times[0]),
        residual=residual,
    )
