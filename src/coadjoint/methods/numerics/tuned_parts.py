"""Short orbits from given states, and the choice of the parts whose h^2 term has the smallest error along them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.long_operations import long_operation
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.program.modified_series import leading_term
from coadjoint.program.parts.decompose import ChosenParts, best_decomposition, candidates, decompose
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.second_order import (
    IMPROVEMENT_FACTOR,
    MAX_ORDERED,
    bracket_gradients,
    order_weights,
    smallest_order,
)
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import polynomial_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

STEPS = 128  # of an orbit, some 32 radians
RELATIVE_STEP = 0.25  # in units of the time in which the motion rotates by one radian or grows by a factor e
MIN_STEPS = 8  # of an orbit that leaves float64; fewer do not sample the motion
# Above this dimension only the given states are compared: brackets cost n^3 operations at each point of a motion.
MAX_ORBIT_DIMENSION = 64
# Number of choices compared by the first term of the scheme, for orders above two.
MAX_CANDIDATES = 12
# Largest number of monomials of that term; above it, the choice is that for order two.
MAX_MONOMIALS = 4000


class ShortOrbit(NamedTuple):
    """States (k + 1, n), spaced evenly (negative: backward), and the derivative of each by its predecessor."""

    points: Floats
    tangents: Floats
    spacing: float

    @property
    def square(self) -> float:
        """The square of the largest momentum; 1 if all are zero."""
        return float(np.max(np.sum(self.points**2, axis=1))) or 1.0

    def propagated(self, fields: Floats) -> Floats:
        """Return the first-order errors (k + 1, n, m) of m perturbations of the field, by the trapezoidal rule."""
        half = 0.5 * self.spacing
        errors = np.zeros_like(fields)
        for k, tangent in enumerate(self.tangents):
            errors[k + 1] = _product(tangent, errors[k] + half * fields[k]) + half * fields[k + 1]
        return errors


def _product(matrix: Floats, columns: Floats) -> Floats:
    """Return a matrix times columns, summed in order: automatic choices must not depend on the BLAS."""
    total = matrix[:, :1] * columns[:1]
    for j in range(1, len(columns)):
        total = total + matrix[:, j : j + 1] * columns[j]
    return total


@ignore_overflow
def short_orbit(method: Method, system: System, x0: Floats, t: float = 0.0, steps: int = STEPS) -> ShortOrbit:
    """Return some dozens of radians of a motion, with tangents; it ends early if the motion overflows."""
    spacing = RELATIVE_STEP / rate_at(system, x0, t)
    points, tangents = [x0], []
    for k in range(steps):
        try:
            after, tangent = method.tangent(system, points[-1], t + k * spacing, spacing)
        except IntegrationError:
            break
        if not (np.all(np.isfinite(after)) and np.all(np.isfinite(tangent))):
            break
        points.append(after)
        tangents.append(tangent)
    if len(tangents) < MIN_STEPS:
        raise orbit_overflow_error(x0, spacing)
    return ShortOrbit(np.array(points), np.array(tangents), spacing)


def orbit_overflow_error(x0: Floats, spacing: float) -> ValueError:
    """Return the error for a motion that leaves the range of float64 within a few steps."""
    return ValueError(
        f"the motion from x0 = {short(x0.tolist())} cannot be followed: it overflows within {MIN_STEPS} steps of "
        f"{spacing:g}; take another state"
    )


@ignore_overflow
def rate_at(system: System, x0: Floats, t: float = 0.0) -> float:
    """Return the rate per unit of time at which the motion turns or grows: the larger of |f|/|x| and |(Df)^2|^(1/2)."""
    size, jacobian = float(np.linalg.norm(x0)), system.jacobian(x0, t)
    turning = float(np.linalg.norm(jacobian @ jacobian)) ** 0.5
    speed = float(np.linalg.norm(system.vector_field(x0, t))) / size if size > 0.0 else 0.0
    rate = max(turning, speed) or 1.0
    if not np.isfinite(rate):
        raise ValueError(f"the motion from x0 = {short(x0.tolist())} cannot be followed: its field overflows")
    return rate


@long_operation("Splitting.tuned")
def tuned_parts(system: LiePoissonSystem, scheme: Callable[[Any], FlowMethod], starts: Floats) -> ChosenParts:
    """Return shift and order of the automatic parts with the least error along motions from `starts` (members, n)."""
    # Permutations are compared by the h^2 term, and the best of them by the first term of the scheme itself.
    method = scheme("auto")
    automatic, terms = decompose(system, "auto").choice, system.hamiltonian.terms()
    if system.dim > MAX_ORBIT_DIMENSION or not all(term.differentiable for term in terms):
        return best_decomposition(system, starts).choice
    orbits = [short_orbit(method, system, start) for start in starts]
    # All candidates have the same, smallest number of parts.
    if not 1 < len(automatic.order) <= MAX_ORDERED:
        return best_decomposition(system, np.concatenate([orbit.points for orbit in orbits])).choice
    ranked: list[tuple[float, ChosenParts]] = []
    for shift, parts in candidates(system):
        natural = automatic.order if shift == automatic.shift else tuple(range(len(parts)))
        sizes: dict[tuple[int, ...], float] = {}
        smallest_order(natural, partial(_sizes_of_orders, propagated_brackets(system, parts, orbits), orbits, sizes))
        ranked += [(size, ChosenParts(order, shift)) for order, size in sizes.items()]
    ranked.sort(key=lambda pair: (pair[0], pair[1] != automatic))
    if method.order == 2 or _monomials(system, method.order) > MAX_MONOMIALS:
        return _best_choice(ranked, automatic)
    compared = [automatic, *(choice for _, choice in ranked if choice != automatic)][:MAX_CANDIDATES]
    return _best_choice([(_error_of_scheme(system, scheme(choice), orbits), choice) for choice in compared], automatic)


def _monomials(system: LiePoissonSystem, order: int) -> float:
    """Return a bound of the number of monomials of the first term, a sum of brackets of order + 1 pieces of H."""
    H = polynomial_of(system.hamiltonian)
    return np.inf if H is None else comb(system.dim + (order + 1) * (H.degree - 1) + 1, system.dim)


def _best_choice(sizes: Sequence[tuple[float, ChosenParts]], automatic: ChosenParts) -> ChosenParts:
    """Return the choice with the smallest error; the automatic one unless another is clearly better."""
    least, best = min(sizes, key=lambda pair: pair[0])
    return (
        best if all(choice != automatic or least < size * IMPROVEMENT_FACTOR for size, choice in sizes) else automatic
    )


def _error_of_scheme(system: LiePoissonSystem, method: FlowMethod, orbits: Sequence[ShortOrbit]) -> float:
    """Return the error of a scheme, divided by h^order; as those of orders of the parts."""
    term = leading_term(system, method, method.order)
    total = 0.0
    for orbit in orbits:
        slopes = term.gradient(orbit.points)
        fields = np.array(
            [_structure_times(system, x, slope[:, None]) for x, slope in zip(orbit.points, slopes, strict=True)]
        )
        total += np.max(np.sum(orbit.propagated(fields)[:, :, 0] ** 2, axis=1)) / orbit.square
    return float(np.sqrt(total / len(orbits)))


def propagated_brackets(system: LiePoissonSystem, parts: Parts, orbits: Sequence[ShortOrbit]) -> list[Floats]:
    """Return the errors (k + 1, n, brackets) along each orbit that each bracket of the h^2 term causes."""
    found = []
    for orbit in orbits:
        slopes = np.moveaxis(bracket_gradients(system.algebra, parts, orbit.points), (2, 3), (0, 1))
        slopes = slopes.reshape(*slopes.shape[:2], -1)
        fields = np.array([_structure_times(system, x, slope) for x, slope in zip(orbit.points, slopes, strict=True)])
        found.append(orbit.propagated(fields))
    return found


def _sizes_of_orders(
    propagated: Sequence[Floats],
    orbits: Sequence[ShortOrbit],
    known: dict[tuple[int, ...], float],
    orders: Sequence[tuple[int, ...]],
) -> list[float]:
    """Return, and add to `known`, the largest errors of orders relative to x, root mean square over the orbits."""
    weights = np.array([order_weights(order).ravel() for order in orders])
    total = np.zeros(len(orders))
    for of_brackets, orbit in zip(propagated, orbits, strict=True):
        squares = np.zeros((len(of_brackets), len(orders)))
        for i in range(of_brackets.shape[1]):
            squares += _summed(of_brackets[:, i], weights) ** 2
        total += np.max(squares, axis=0) / orbit.square
    sizes: list[float] = np.sqrt(total / len(orbits)).tolist()
    known.update(zip(orders, sizes, strict=True))
    return sizes


def _summed(propagated: Floats, weights: Floats) -> Floats:
    """Return (k, m) times the transpose of (orders, m), summed in order."""
    total = np.zeros((len(propagated), len(weights)))
    for m in range(propagated.shape[1]):
        total += propagated[:, m, None] * weights[:, m]
    return total


def _structure_times(system: LiePoissonSystem, x: Floats, slopes: Floats) -> Floats:
    """Return sign J(x) times columns, summed in order."""
    structure = system.sign * system.algebra.structure_matrix(x)
    product = np.zeros_like(slopes)
    for j, slope in enumerate(slopes):
        product += structure[:, j : j + 1] * slope
    return product
