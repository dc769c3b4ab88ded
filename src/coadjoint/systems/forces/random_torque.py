"""White noise as a torque on bodies, additive in their angular momenta."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.base import Force, ForceReader, normal_deviates, read_matrix, read_seed
from coadjoint.systems.forces.torque import check_attitude, places_of_torques
from coadjoint.validation import read_choice

AXES = ("body", "space")


class Kicks(NamedTuple):
    """Changes ``x[changed] += factor x[state] dB_number`` of a state; without x[state] where `state` is -1."""

    changed: NDArray[np.int64]
    state: NDArray[np.int64]
    number: NDArray[np.int64]
    factor: NDArray[np.float64]

    @property
    def motions(self) -> int:
        """Number of Brownian motions."""
        return int(self.number.max(initial=-1)) + 1


@suggest_keywords
@dataclass(frozen=True)
class RandomTorque(Force):
    """A random torque on bodies, white noise of Ito or Stratonovich (which agree): ``dL = strength dB`` in body axes.

    Choose it for torques without memory, such as those of a gas, of sloshing, or of unmodelled disturbances on a
    satellite. Each body has three independent Brownian motions. In axes of space they act as ``dL = A^T strength dB``
    on the momentum L in the frame of the body. It is additive in the momentum, and so it is no `HamiltonianNoise`: it
    leaves the coadjoint orbit, and the square of the momentum grows by ``3 strength^2`` per time on average. Its flow
    is exact. For thermal equilibrium add damping, or choose `HeatBath`.

    Runs backward in time raise an error; the noise depends on threads, members and interruptions as little as that of
    `HeatBath`.

    Parameters
    ----------
    strength : float, (3,) or (3, 3) array_like
        Strength about all axes, about each, or a matrix S with ``dL = S dB``, and the covariance ``S S^T dt``; in units
        of the angular momentum per square root of time. The sign makes no difference to the statistics.
    axes : {"body", "space"}
        The axes of `strength`. Those of space need an attitude in the state, as of ``co.systems.body``.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed.

    Raises
    ------
    ValueError, TypeError
        A strength that is not finite or of the wrong shape, unknown axes, or a missing seed. A system without bodies, a
        rod, or axes of space without an attitude, when it is added to a system.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> torque = co.forces.RandomTorque(0.1, seed=1)
    >>> body = co.systems.body(inertia=(1, 2, 3)).with_forces(torque)
    >>> x0 = np.tile(body.state(np.eye(3), (0.0, 0.0, 0.0)), (4000, 1))
    >>> sol = co.integrate(body, x0, t_span=(0, 2), step=0.5)
    >>> L = body.angular_momentum(sol.x[-1])
    >>> bool(abs((L**2).sum(axis=-1).mean() - 3 * 0.1**2 * 2) < 0.004)
    True
    """

    strength: Any
    axes: str = "body"
    seed: Any = None
    stream: int = 0

    example: ClassVar = {"strength": 0.05, "seed": 13}
    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True
    uses_energy: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._require_seed()
        self._read(strength=read_matrix, seed=read_seed, stream=read_seed)
        read_choice(self.axes, "axes of RandomTorque", AXES)
        shape = np.shape(self.strength)
        if shape and shape[0] != 3:
            raise ValueError(f"strength of RandomTorque has the shape {shape}; it must be a number, (3,) or (3, 3)")

    def check(self, system: Any) -> None:
        if not hasattr(system, "bodies"):
            raise TypeError(f"RandomTorque acts on bodies, and {system.name} has none; take HamiltonianNoise")
        if self.axes == "space":
            check_attitude(system, "RandomTorque in axes of space")
        for k, inertia in enumerate(getattr(system, "inertias", ())):
            if inertia.rotating is not None:
                raise ValueError(
                    f"RandomTorque turns body {k} of {system.name} about all its axes, and a rod has no momentum about "
                    "its own; take a HamiltonianNoise of its directions"
                )

    def _changed(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[np.bool_]:
        return np.isin(np.arange(system.dim), self.kicks(system).changed)

    def kicks(self, system: Any) -> Kicks:
        """Return the changes of the state by each Brownian motion."""
        return _kicks(self.strength, self.axes, system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("RandomTorque is a noise, which has no field; its mean is zero")

    def _changes(self, system: Any, t: Any, tau: Any) -> tuple[Kicks, NDArray[np.float64]]:
        self._check_forward(tau)
        kicks = self.kicks(system)
        drawn = normal_deviates(self.seed, self.stream, float(t), 0, kicks.motions)
        return kicks, kicks.factor * (np.sqrt(float(tau)) * drawn)[kicks.number]

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        kicks, changes = self._changes(system, t, tau)
        y = x + np.zeros(len(x))
        np.add.at(y, kicks.changed, np.where(kicks.state < 0, 1.0, x[kicks.state]) * changes)
        return y

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        (kicks, changes), product = self._changes(system, t, tau), np.eye(len(x))
        inside = kicks.state >= 0
        np.add.at(product, (kicks.changed[inside], kicks.state[inside]), changes[inside])
        return product

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.kicks(self.kicks(system), self.seed, self.stream)


@lru_cache(maxsize=64)
def _kicks(strength: Any, axes: str, system: Any) -> Kicks:
    S = np.asarray(strength, dtype=np.float64)
    S = S if S.ndim == 2 else np.diag(np.broadcast_to(S, 3))
    places = places_of_torques(system).reshape(-1, 3)
    rows: list[tuple[int, int, int, float]] = []
    for k, momenta in enumerate(places.tolist()):
        for i, changed in enumerate(momenta):
            for b in range(3):
                if axes == "body":
                    rows.append((changed, -1, 3 * k + b, S[i, b]))
                else:  # entry A[r, i] of the attitude behind the momentum
                    rows += [(changed, momenta[0] + 3 + 3 * r + i, 3 * k + b, S[r, b]) for r in range(3)]
    return Kicks(*map(np.array, zip(*rows, strict=True)))
