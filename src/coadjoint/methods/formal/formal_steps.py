"""Runge-Kutta steps as formal power series: stages of tableaux and of collocation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.methods.formal.formal_numbers import NODE, FormalNumber, vector
from coadjoint.methods.numerics.solvers import Coefficients
from coadjoint.methods.protocol.method import is_short
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.system import System


class FormalStages(ABC):
    """Interface of stages for the solvers of stage equations: the points X for slopes L, and the end of the step."""

    x: NDArray[Any]
    h: FormalNumber

    @abstractmethod
    def start(self) -> NDArray[Any]:
        """Return X = x for every stage."""

    @abstractmethod
    def each(self, function: Callable[..., NDArray[Any]], *points: NDArray[Any]) -> NDArray[Any]:
        """Return the values of a function at the points of every stage."""

    @abstractmethod
    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        """Return X = x + h A L."""

    @abstractmethod
    def end(self, slopes: NDArray[Any]) -> NDArray[Any]:
        """Return x + h b . L."""


class StagesOfTableau(FormalStages):
    """Separate stages, with the numbers of a tableau."""

    def __init__(self, coefficients: Coefficients, x: NDArray[Any], h: FormalNumber) -> None:
        self.coefficients, self.x, self.h = coefficients, x, h

    def start(self) -> NDArray[Any]:
        return np.stack([self.x] * len(self.coefficients.node))

    def each(self, function: Callable[..., NDArray[Any]], *points: NDArray[Any]) -> NDArray[Any]:
        number = type(self.h)
        return np.stack([vector(map(number, function(*rows))) for rows in zip(*points, strict=True)])

    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.x + self.coefficients.mix @ self._scaled(slopes)

    def end(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.x + self.coefficients.out @ self._scaled(slopes)

    def _scaled(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.coefficients.scale[:, None] * slopes * self.h


class StagesOfCollocation(FormalStages):
    """All stages at once: X(c) = x + h int_0^c L, modulo the polynomial whose roots are the nodes."""

    # Expressions equal at all nodes are computed once, and are rational although the nodes are not.

    def __init__(self, nodes: Sequence[Fraction], x: NDArray[Any], h: FormalNumber) -> None:
        self.x, self.h, ring = x, h, h.ring
        self._node = ring.dim + ring.symbols.index(NODE)
        node = ring.symbol_elements[NODE]
        self._modulus = ring.zero
        for power, coefficient in enumerate(nodes):
            self._modulus += rational(coefficient) * node**power

    def start(self) -> NDArray[Any]:
        return self.x[None]

    def each(self, function: Callable[..., NDArray[Any]], *points: NDArray[Any]) -> NDArray[Any]:
        values = vector(map(type(self.h), function(*(rows[0] for rows in points))))
        return self._mapped(values, lambda term: divmod(term, self._modulus)[1])[None]

    def points(self, slopes: NDArray[Any]) -> NDArray[Any]:
        integral = self._mapped(slopes[0], lambda term: divmod(term.integral(self._node), self._modulus)[1])
        return (self.x + self.h * integral)[None]

    def end(self, slopes: NDArray[Any]) -> NDArray[Any]:
        return self.x + self.h * self._mapped(slopes[0], lambda term: term.integral(self._node).subs({NODE: 1}))

    @staticmethod
    def _mapped(values: NDArray[Any], function: Callable[[Any], Any]) -> NDArray[Any]:
        return vector(type(value).from_coefficients(map(function, value.coefficients)) for value in values)


def formal_end(stages: FormalStages, system: System, solver: str, iterations: int) -> NDArray[Any]:
    """Return the end of a step with slopes computed by `solver`, a key of ``solvers.SOLVERS``."""
    # Explicit and implicit stages are treated alike: each pass through the equations gains a power of h.

    def product(momentum: NDArray[Any], slope: NDArray[Any]) -> NDArray[Any]:
        return system.sign * (system.structure_matrix(momentum) @ slope)

    field, gradient = system.vector_field, system.hamiltonian.gradient
    if solver in ("explicit", "implicit"):
        return stages.end(_converged_slopes(stages, lambda X: stages.each(field, X)))
    frozen = stages.start()
    for _ in range(iterations):
        frozen = stages.points(stages.each(field, frozen))
    if solver == "iterated":
        return stages.end(stages.each(field, frozen))
    if solver == "structure":
        return stages.end(
            _converged_slopes(stages, lambda X: stages.each(lambda Z, Y: product(Z, gradient(Y)), frozen, X))
        )
    return stages.end(_converged_slopes(stages, lambda X: stages.each(lambda Z, Y: product(Y, gradient(Z)), frozen, X)))


def _converged_slopes(stages: FormalStages, slopes_at: Callable[[NDArray[Any]], NDArray[Any]]) -> NDArray[Any]:
    """Return the slopes at the solution of X = x + h A L(X); each pass is exact in one more power of h."""
    count = stages.h.count
    points = vector(value.cut(1) for value in stages.start().ravel()).reshape(stages.start().shape)
    slopes = slopes_at(points)
    for _ in range(count):
        points = stages.points(slopes)
        slopes = slopes_at(points)
    return slopes


DIGITS = 50  # decimal digits of irrational coefficients: those published, and more than any float keeps


def rational_tableau(coefficients: Callable[..., Coefficients]) -> tuple[Coefficients, float]:
    """Return a tableau in fractions, and their relative error: 0 if the tableau is rational."""
    from mpmath import mp, workdps

    with workdps(DIGITS):
        for number in (Fraction, mp.mpf):
            try:
                tableau = Coefficients(*coefficients(number))
            except (TypeError, ValueError, ArithmeticError):
                continue
            break
        else:
            tableau = Coefficients(*coefficients())
        entries = [Fraction(fraction_of(value)) for part in tableau for value in np.ravel(part)]
        fractions = Coefficients(*(_array_of(np.shape(part), fraction_of, np.ravel(part)) for part in tableau))
    if all(map(is_short, entries)):
        return fractions, 0.0
    in_mpmath = all(isinstance(value, mp.mpf | Fraction | int) for part in tableau for value in np.ravel(part))
    return fractions, 10.0 ** (2 - DIGITS) if in_mpmath else UNIT_ROUNDOFF


def fraction_of(value: Any) -> Fraction:
    """Return a number of Python, NumPy or mpmath exactly as a fraction."""
    if hasattr(value, "_mpf_"):
        sign, mantissa, exponent, _ = value._mpf_
        return (-1 if sign else 1) * Fraction(int(mantissa)) * Fraction(2) ** exponent
    return Fraction(value.item() if isinstance(value, np.generic) else value)


def _array_of(shape: tuple[int, ...], convert: Callable[[Any], Any], values: Any) -> NDArray[Any]:
    return vector(map(convert, values)).reshape(shape)
