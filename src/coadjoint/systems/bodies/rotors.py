"""Reaction wheels and control-moment gyros of a body: validation, and the energy of a body that carries them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.bodies.body_inertia import BodyInertia
from coadjoint.systems.bodies.inertia import inverse_of, plain
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]

GYRO_TOLERANCE = 1e-9
"""Largest relative difference of the two momenta of a gyro, and of their angle from a right one, that is rounding."""


class Rotors(NamedTuple):
    """Wheels, each its moment times its axis, (m, 3), and gyros, each two momenta, (g, 2, 3)."""

    # A state carries the momentum of each wheel about its axis, then the cosine and the sine of each gimbal angle.

    wheels: Floats
    gyros: Floats

    @property
    def momenta(self) -> Floats:
        """Momentum in the body frame for a unit of each number that the state carries, (m + 2 g, 3)."""
        return _momenta(self.wheels, self.gyros)

    @property
    def moments(self) -> Floats:
        """Moment of inertia of each wheel about its axis, (m,)."""
        return _moments(self.wheels)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers that the state carries."""
        gimbals = tuple(f"{name}{k + 1}" for k in range(len(self.gyros)) for name in ("cos", "sin"))
        return (*(f"k{i + 1}" for i in range(len(self.wheels))), *gimbals)

    @property
    def given(self) -> tuple[Any, Any]:
        """Wheels and gyros as nested tuples."""
        return plain(self.wheels), plain(self.gyros)


NO_ROTORS = Rotors(np.zeros((0, 3)), np.zeros((0, 2, 3)))


def read_rotors(wheels: Any, gyros: Any, inertia: BodyInertia) -> Rotors:
    """Validate wheels and gyros of a body."""
    turning, steering = read_finite(wheels, "wheels"), read_finite(gyros, "gyros")
    turning = turning.reshape(0, 3) if turning.shape == (0,) else turning
    steering = steering.reshape(0, 2, 3) if steering.shape == (0,) else steering
    if turning.ndim != 2 or turning.shape[1] != 3:
        raise ValueError(f"wheels has shape {turning.shape}; give (m, 3), of each wheel its moment times its axis")
    if steering.ndim != 3 or steering.shape[1:] != (2, 3):
        raise ValueError(
            f"gyros has shape {steering.shape}; give (g, 2, 3), of each gyro its momentum at the gimbal angles 0 and "
            "90 degrees"
        )
    for what, array in (("wheels", turning), ("gyros", steering)):
        zero = np.argwhere(~array.any(axis=-1))
        if len(zero):
            raise ValueError(f"{what}[{zero[0, 0]}] has a vector that is zero; leave it out")
    for k, (first, second) in enumerate(steering):
        a, b = _moments(steering[k])
        if abs(a - b) > GYRO_TOLERANCE * a or abs((first * second).sum()) > GYRO_TOLERANCE * a * b:
            raise ValueError(
                f"gyros[{k}] is {short(steering[k].tolist())}; its momenta at the gimbal angles 0 and 90 degrees must "
                "be orthogonal and of equal length"
            )
    if len(turning) + len(steering) and inertia.rotating is not None:
        raise ValueError("inertia is that of a rod, which carries no wheels or gyros; give three positive moments")
    if len(turning):
        without_wheels(inertia.tensor, turning)
    return Rotors(turning, steering)


def without_wheels(tensor: npt.NDArray[Any], wheels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the inverse of an inertia tensor without the moments of the wheels about their axes; real or complex."""
    inner = tensor - np.einsum("mi,mj->ij", wheels / _moments(wheels)[:, None], wheels)
    try:
        return inverse_of(inner, "inertia")
    except ValueError:
        raise ValueError(
            "the moments of wheels exceed inertia; it is that of the body with its wheels, locked"
        ) from None


def energy_with_rotors(
    tensor: npt.NDArray[Any], wheels: npt.NDArray[Any], gyros: npt.NDArray[Any], first: int, dim: int
) -> npt.NDArray[Any]:
    """Return the matrix of the energy of body and rotors, whose numbers in the state begin at `first`."""
    # With the momentum L of all and R y of the rotors, ``(L - R y) . M (L - R y) / 2`` and that of the wheels, y^2 over
    # twice the moment, y the momentum about the axis in space.
    M, R = without_wheels(tensor, wheels), _momenta(wheels, gyros)
    matrix = np.zeros((dim, dim), dtype=np.result_type(M, R))
    crossed = np.einsum("ij,qj->iq", M, R)
    end, count = first + len(R), len(wheels)
    matrix[:3, :3] = M
    matrix[:3, first:end], matrix[first:end, :3] = -crossed, -crossed.T
    matrix[first:end, first:end] = np.einsum("pi,iq->pq", R, crossed)
    matrix[range(first, first + count), range(first, first + count)] += 1.0 / _moments(wheels)
    return matrix


def _moments(wheels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(np.sqrt((wheels * wheels).sum(axis=-1)))


def _momenta(wheels: npt.NDArray[Any], gyros: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.concatenate([wheels / _moments(wheels)[:, None], gyros.reshape(-1, 3)])
