"""Which parts for a state? Those whose h^2 term, carried along a short motion from there, makes the smallest error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.base import Method
from coadjoint.methods.short_orbit import ShortOrbit, short_orbit
from coadjoint.program.chosen_parts import ChosenParts
from coadjoint.program.decompose import best_decomposition, candidates, decompose
from coadjoint.program.nested_brackets import NestedBrackets
from coadjoint.program.order_of_parts import CLEARLY, MOST_ORDERED, least_of_orders
from coadjoint.program.parts import Parts
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = NDArray[np.float64]

# Larger systems are compared at the given states alone: the brackets of a motion cost n^3 for each of its points.
LARGEST_FOLLOWED = 64


def tuned_parts(system: LiePoissonSystem, method: Method, starts: Floats) -> ChosenParts:
    """Return shift and order of the automatic parts with the smallest error along short motions from some states.

    The error is that of the step of order two: its field differs by h^2 J grad H2 from the motion's, and the tangent
    map carries what this adds at one point to all later ones.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    method : Method
        Any splitting of order two, to follow the motion.
    starts : ndarray, shape (members, n)
        The states.

    Returns
    -------
    ChosenParts
        The choice of ``parts="auto"``, unless another one is better.
    """
    terms = system.hamiltonian.terms()
    if system.dim > LARGEST_FOLLOWED or not all(term.differentiable for term in terms):
        return best_decomposition(system, starts).choice
    orbits = [short_orbit(method, system, start) for start in starts]
    own, found = decompose(system, "auto").choice, candidates(system)
    # Any number of parts is the same for all of them: the fewest.
    if not 1 < len(own.order) <= MOST_ORDERED:
        return best_decomposition(system, np.concatenate([orbit.points for orbit in orbits])).choice
    errors = {shift: ErrorsOfOrders(system, parts, orbits) for shift, parts in found}
    best, least = own, errors[own.shift].sizes([own.order])[0] if own.shift in errors else np.inf
    for shift, measured in errors.items():
        order, size = least_of_orders(tuple(range(len(own.order))), measured.sizes)
        if size < least * CLEARLY:
            best, least = ChosenParts(order, shift), size
    return best


class ErrorsOfOrders:
    """What the brackets in the h^2 term of one set of parts make of some orbits; with them, the error of every order.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    parts : Parts
        Those of its Hamiltonian, or of the Hamiltonian less a Casimir.
    orbits : sequence of ShortOrbit
        Its motions.
    """

    def __init__(self, system: LiePoissonSystem, parts: Parts, orbits: Sequence[ShortOrbit]) -> None:
        self._brackets = NestedBrackets(system.algebra, parts)
        self._carried, self._size = [], []
        for orbit in orbits:
            slopes = np.moveaxis(self._brackets.gradients(orbit.points), (2, 3), (0, 1))
            slopes = slopes.reshape(*slopes.shape[:2], -1)
            fields = np.array([_turned(system, x, slope) for x, slope in zip(orbit.points, slopes, strict=True)])
            self._carried.append(orbit.carried(fields))
            self._size.append(float(np.max(np.abs(orbit.points))))

    def sizes(self, orders: Sequence[tuple[int, ...]]) -> list[float]:
        """Return for orders of the parts the root mean square over the orbits of the largest error, a part of x."""
        weights = np.array([self._brackets.weights(order).ravel() for order in orders])
        total = np.zeros(len(orders))
        for carried, size in zip(self._carried, self._size, strict=True):
            squares = np.zeros((len(carried), len(orders)))
            for i in range(carried.shape[1]):
                squares += _summed(carried[:, i], weights) ** 2
            total += np.max(squares, axis=0) / (size**2 or 1.0)
        return np.sqrt(total / len(self._carried)).tolist()

    def along(self, order: tuple[int, ...]) -> list[Floats]:
        """Return the error of one order at the points of each orbit, (k + 1, n), divided by h^2."""
        weights = self._brackets.weights(order).ravel()[None]
        return [
            np.stack([_summed(carried[:, i], weights)[:, 0] for i in range(carried.shape[1])], axis=1)
            for carried in self._carried
        ]


def _summed(carried: Floats, weights: Floats) -> Floats:
    """Return (k, m) times the transpose of (orders, m), summed in order."""
    total = np.zeros((len(carried), len(weights)))
    for m in range(carried.shape[1]):
        total += carried[:, m, None] * weights[:, m]
    return total


def _turned(system: LiePoissonSystem, x: Floats, slopes: Floats) -> Floats:
    """Return sign J(x) times columns, summed in order."""
    structure = system.sign * system.algebra.structure_matrix(x)
    found = np.zeros_like(slopes)
    for j, slope in enumerate(slopes):
        found += structure[:, j : j + 1] * slope
    return found
