"""Derivatives by parameters as differences of systems with moved entries."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

# Nodes and weights of the derivative at zero, and of the value there, by interpolation; distance of the nodes, relative
# to the radius by which a parameter may change. Energies and steps are analytic functions of their parameters.
NODES = np.array([1.0, 2.0, 3.0, 4.0])
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
AT_ZERO = np.array([4 / 5, -2 / 5, 4 / 35, -1 / 70])
DISTANCE = 2.0**-5
# The value at zero is within some DISTANCE^7 of the change over a distance. Where it is off by more than this part of
# it, the form of a step changes between the nodes, such as the order of its parts: nearer ones are taken, a few times.
# Nearer ones are also taken where values are refused.
AGREEMENT = 2.0**-23
NEARER, MOST_DISTANCES = 2.0**-4, 3
# By how much an entry of a parameter may change, relative to its size; those below some part of the largest one, to
# the size of that one.
RADIUS, SMALL_ENTRY = 0.25, 0.125


def sizes_of_entries(value: Floats) -> Floats:
    """Return the sizes of the entries of a parameter; the largest one, or one, for those that are much smaller."""
    sizes = np.abs(value)
    largest = float(np.max(sizes)) or 1.0
    return np.asarray(np.where(sizes > SMALL_ENTRY * largest, sizes, largest))


def moved_entry(value: Floats, index: tuple[int, ...], by: float, symmetric: bool) -> Floats:
    """Return a parameter with one entry moved; half of it and half its mirror image if the matrix is symmetric."""
    moved = value.copy()
    if symmetric and index[0] != index[1]:
        moved[index] += 0.5 * by
        moved[index[::-1]] = moved[index]
    else:
        moved[index] += by
    return moved


class NearbySystems:
    """Systems in which one entry of a parameter is moved by some distances, made on first use."""

    def __init__(self, name: str, distance: float, moved: Callable[[float], Any]) -> None:
        self._name, self._distance, self._moved = name, distance, cache(moved)

    def with_systems(self, changed: Callable[[Any], Any]) -> NearbySystems:
        """Return the systems that a function makes of these."""
        return NearbySystems(self._name, self._distance, lambda by: changed(self._moved(by)))

    def centre(self) -> Any:
        """Return the system with the unchanged entry."""
        return self._moved(0.0)

    def nodes(self, agreeing: Callable[[Any], Floats] | None = None) -> tuple[float, list[Any]] | None:
        """Return the unit of the nodes 1, -1, 2, ..., -4 and the systems there; None if a value is refused.

        They are as near as values of a function of the system need, if `agreeing`.
        """
        try:
            distance = self._distance if agreeing is None else self.samples(agreeing, agreeing(self.centre()))[0]
            with warnings.catch_warnings():  # of values that the user did not give
                warnings.simplefilter("ignore")
                by = (distance * NODES).tolist()
                return distance, [self._moved(sign * shift) for shift in by for sign in (1.0, -1.0)]
        except (TypeError, ValueError):
            return None

    def samples(self, function: Callable[[Any], Floats], here: Floats) -> tuple[float, Floats, Floats]:
        """Return a distance at which values of a function of the system agree with that here, and both sides."""
        distance, found, refusal = self._distance, None, None
        for _ in range(MOST_DISTANCES):
            by, distance = NODES * distance, NEARER * distance
            try:
                with warnings.catch_warnings():  # of values that the user did not give
                    warnings.simplefilter("ignore")
                    systems = [[self._moved(shift) for shift in (sign * by).tolist()] for sign in (1.0, -1.0)]
            except (TypeError, ValueError) as reason:
                refusal = reason
                continue
            plus, minus = (np.array([function(system) for system in side]) for side in systems)
            change = np.tensordot(WEIGHTS, plus - minus, axes=1)
            off = np.max(np.abs(np.tensordot(AT_ZERO, plus + minus, axes=1) - here), initial=0.0)
            rounding = 16.0 * UNIT_ROUNDOFF * np.max(np.abs(here), initial=0.0)
            found = float(by[0]), plus, minus
            if not off > AGREEMENT * np.max(np.abs(change), initial=0.0) + rounding:
                break
        if found is None:
            raise ValueError(
                f"{self._name} cannot be differentiated, since values near this one are refused: {refusal}"
            )
        return found

    def difference(self, function: Callable[[Any], Floats], here: Floats) -> Floats:
        """Return the derivative of a function of the system by the entry, with about twelve digits."""
        distance, plus, minus = self.samples(function, here)
        return np.asarray(np.tensordot(WEIGHTS, plus - minus, axes=1) / distance)


def differences(nearby: Sequence[NearbySystems], function: Callable[[Any], Floats]) -> list[Floats]:
    """Return the derivatives of a function by entries of parameters of one system."""
    here = function(nearby[0].centre()) if nearby else np.zeros(0)
    return [one.difference(function, here) for one in nearby]


def nearby_systems(name: str, value: Floats, moved: Callable[[tuple[int, ...], float], Any]) -> list[NearbySystems]:
    """Return the systems for each entry of a parameter; `moved(index, by)` returns that with an entry moved."""
    distances = DISTANCE * RADIUS * sizes_of_entries(value)
    return [NearbySystems(name, float(distances[index]), partial(moved, index)) for index in np.ndindex(value.shape)]


class EnergyDifferences:
    """dH/dp of matrix systems, as `EnergyDerivative` for others."""

    def __init__(self, name: str, value: Floats, moved: Callable[[tuple[int, ...], float], Any]) -> None:
        self.size, self.nearby = value.size, nearby_systems(name, value, moved)

    def at(self, x: Floats) -> Floats:
        """Return the derivatives of the energy at states (..., n), shape (..., size)."""
        return np.stack(differences(self.nearby, lambda system: np.asarray(system.energy(x))), axis=-1)
