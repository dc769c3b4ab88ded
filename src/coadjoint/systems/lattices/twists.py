"""Twisted boundaries: spins turned about an axis beyond the ends of a periodic lattice, as of spirals."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.lattices.bonds import clean
from coadjoint.systems.lattices.spin_polynomials import SitePolynomial, turned, values_of
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

TOLERANCE = 1e-12  # of what must be invariant, relative to its size: rounding of rotated matrices


class Twist(NamedTuple):
    """Angles of the turns beyond the ends along the three lattice vectors, about a unit vector."""

    angles: tuple[float, float, float]
    axis: tuple[float, float, float]
    checked: bool = True  # whether terms that turns change are refused

    @classmethod
    def of(cls, angles: Any, axis: Any, periodic: tuple[bool, ...]) -> Twist | None:
        """Read angles and an axis; None for no twist."""
        direction = read_finite(axis, "axis")
        size = float(np.abs(direction).max(initial=0.0))
        if direction.shape != (3,) or size == 0.0:
            raise ValueError(f"axis is {short(axis)}; give a direction (3,)")
        given = read_finite((0.0, 0.0, 0.0) if angles is None else angles, "twist")
        if given.shape != (3,):
            raise ValueError(f"twist has shape {given.shape}; give an angle for each lattice vector, (3,)")
        for name, angle, flag in zip("abc", given.tolist(), periodic, strict=True):
            if angle and not flag:
                raise ValueError(f"twist has {angle!r} along {name}, which is open; give 0 there, or periodic=True")
        if not given.any():
            return None
        unit = direction / size
        unit = unit / np.sqrt((unit**2).sum())
        return cls(tuple(given.tolist()), tuple(unit.tolist()))

    def matrices(self, windings: Integers) -> tuple[Floats, Integers]:
        """Return the distinct rotations beyond ends that are crossed (k, 3) times, and the number of each."""
        distinct, numbers = np.unique(windings, axis=0, return_inverse=True)
        return np.stack(
            [self._rotation(float(total)) for total in (distinct * self.angles).sum(axis=1)]
        ), numbers.ravel()

    def _rotation(self, angle: float) -> Floats:
        u = np.array(self.axis)
        cross = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
        outer = u[:, None] * u
        return clean(np.cos(angle) * (np.eye(3) - outer) + np.sin(angle) * cross + outer, 1.0)

    def check_matrices(self, matrices: Floats, what: str) -> None:
        """Raise ValueError if matrices do not commute with rotations about the axis."""
        turn = self._rotation(1.0)  # of no finite order, so that what it leaves all turns leave
        moved = np.array([turn @ one @ turn.T for one in matrices])
        self._refuse(np.abs(moved - matrices).max(initial=0.0), np.abs(matrices).max(initial=0.0), what)

    def check_polynomial(self, polynomial: SitePolynomial, what: str) -> None:
        """Raise ValueError if a polynomial of a direction changes in rotations about the axis."""
        before, after = values_of(polynomial), values_of(turned(polynomial, self._rotation(1.0)))
        self._refuse(np.abs(after - before).max(), sum(map(abs, polynomial.values())), what)

    def check_field(self, B: Any) -> None:
        """Raise ValueError for a field that is not along the axis, or a function, of which that is not known."""
        if callable(B):
            raise ValueError("B is a function, and the lattice is twisted; give a constant field along the axis")
        u = np.array(self.axis)
        across = B - (B * u).sum(axis=-1, keepdims=True) * u
        self._refuse(np.abs(across).max(), np.abs(B).max(), "the field")

    def _refuse(self, change: float, size: float, what: str) -> None:
        if self.checked and change > TOLERANCE * size:
            raise ValueError(
                f"{what} changes in rotations about the axis {[round(a, 6) for a in self.axis]} of the twist; give "
                "terms that do not, or no twist"
            )


def windings(step: tuple[int, ...], sizes: tuple[int, ...], periodic: tuple[bool, ...]) -> Integers:
    """Return how often edges of a bond cross the ends of each axis, (edges, 3), in the order of `edges_of_bonds`."""
    places = np.indices(sizes)
    crossed = np.zeros_like(places)
    for axis, (shift, size, closed) in enumerate(zip(step, sizes, periodic, strict=True)):
        if closed:
            crossed[axis] = (places[axis] + shift) // size
    for axis, (shift, size, closed) in enumerate(zip(step, sizes, periodic, strict=True)):
        if shift and not closed:
            inside = slice(max(0, -shift), max(0, size - max(0, shift)))
            crossed = crossed[(slice(None),) * (axis + 1) + (inside,)]
    return crossed.reshape(len(sizes), -1).T
