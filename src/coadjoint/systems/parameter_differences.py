"""Derivatives by parameters as differences of systems with moved entries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Nodes and weights of the derivative at zero by interpolation; distance of the nodes, relative to the radius by which a
# parameter may change. Energies and steps are analytic functions of their parameters.
NODES = np.array([1.0, 2.0, 3.0, 4.0])
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
DISTANCE = 2.0**-5


class _Pairs(Sequence[tuple[Any, Any]]):
    """Pairs of systems that are made on first use: formulas may need none of them."""

    def __init__(self, makers: Sequence[Callable[[], tuple[Any, Any]]]) -> None:
        self._makers, self._made = makers, dict[int, tuple[Any, Any]]()

    def __len__(self) -> int:
        return len(self._makers)

    def __getitem__(self, k: Any) -> Any:
        if k not in self._made:
            self._made[k] = self._makers[k]()
        return self._made[k]


class NearbySystems(NamedTuple):
    """Pairs of systems in which one entry of a parameter is moved up and down, for a central difference of order 8."""

    distance: float
    pairs: Sequence[tuple[Any, Any]]

    @classmethod
    def by(cls, distance: float, moved: Callable[[float], Any]) -> NearbySystems:
        """Construct from a function of the change of the entry."""

        def made(by: float) -> tuple[Any, Any]:
            return moved(by), moved(-by)

        return cls(distance, _Pairs([partial(made, node * distance) for node in NODES.tolist()]))

    def with_systems(self, changed: Callable[[Any], Any]) -> NearbySystems:
        """Return the pairs of systems that a function makes of these."""

        def made(k: int) -> tuple[Any, Any]:
            plus, minus = self.pairs[k]
            return changed(plus), changed(minus)

        return self._replace(pairs=_Pairs([partial(made, k) for k in range(len(self.pairs))]))

    def difference(self, function: Callable[[Any], Floats]) -> Floats:
        """Return the derivative of a function of the system by the entry, with about twelve digits."""
        changes = [
            weight * (function(plus) - function(minus))
            for weight, (plus, minus) in zip(WEIGHTS, self.pairs, strict=True)
        ]
        return np.asarray(sum(changes) / self.distance)


def nearby_systems(radii: Floats, moved: Callable[[tuple[int, ...], float], Any]) -> list[NearbySystems]:
    """Return the systems for each entry of a parameter; `moved(index, by)` returns that with an entry moved.

    Each entry may change by its radius.
    """
    return [
        NearbySystems.by(DISTANCE * float(radii[index]), partial(moved, index)) for index in np.ndindex(radii.shape)
    ]


class EnergyDifferences:
    """dH/dp of matrix systems, as `EnergyDerivative` for others."""

    def __init__(self, radii: Floats, moved: Callable[[tuple[int, ...], float], Any]) -> None:
        self.size, self._nearby = radii.size, nearby_systems(radii, moved)

    def at(self, x: Floats) -> Floats:
        """Return the derivatives of the energy at states (..., n), shape (..., size)."""
        columns = [nearby.difference(lambda system: np.asarray(system.energy(x))) for nearby in self._nearby]
        return np.stack(columns, axis=-1)
