"""A heat bath: damping along coadjoint orbits, and the noise of its temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.given import read_number, read_whole
from coadjoint.systems.forces.base import Noise
from coadjoint.systems.forces.double_bracket import DoubleBracketDamping, exponential
from coadjoint.systems.forces.matrices import Plain, applied, root_of
from coadjoint.systems.forces.normal_deviates import normal_deviates

LARGEST_SEED = 2**62


@dataclass(frozen=True)
class HeatBath(DoubleBracketDamping):
    """A heat bath for spins, and for any coadjoint orbit: damping, and the noise of its temperature.

    ``dx = sign J(x) (grad H dt + alpha P sign J(x) grad H dt + sqrt(2 alpha kT) L o dW)`` in the sense of Stratonovich,
    with L L^T = P and independent Wiener processes W. The stationary density on an orbit is that of Boltzmann,
    exp(-H/kT), with respect to the symplectic volume of the orbit: for spins the surface of their spheres. In the form
    of Gilbert with damping a, where H was multiplied by 1/(1 + a^2), multiply the temperature by that too.

    The flow is half of the noise, the midpoint rule of the damping, and half of the noise, all by exponentials on the
    orbit: every Casimir is kept to round-off, for every draw. Directions of the noise that commute move together, with
    the exact law, and the sets of them follow each other symmetrically. So averages have an error of the second order
    in the step, where the stochastic midpoint rule, which takes all directions at once, has one of the first. The noise
    is never iterated on, and no increment has to be cut off.

    The noise is a function of the seed, the number of the member and the time, and of nothing else: the same on any
    number of threads, with or without other members, however often the run is cut. Two spans that follow each other
    have different noise. A run backward is refused.

    Parameters
    ----------
    alpha : float
        Strength of the damping, as for `DoubleBracketDamping`.
    metric : float, (n,) or (n, n) array_like
        As for `DoubleBracketDamping`.
    temperature : float
        Boltzmann's constant times the temperature, in units of the energy; zero or positive.
    seed : int
        Of the noise, from 0 to 2^62. Give one: there is no default, so that no two runs share a noise by accident.
    stream : int
        The member m of a run has the noise number ``stream + m`` of the seed. With stream=m a member alone has the bits
        that it has as number m of an ensemble.

    Raises
    ------
    ValueError, TypeError
        Negative, or of another shape, or no finite numbers; no seed.

    References
    ----------
    W. F. Brown, Thermal fluctuations of a single-domain particle, Physical Review 130 (1963); J. H. Mentink,
    M. V. Tretyakov, A. Fasolino, M. I. Katsnelson, Th. Rasing, Stable and fast semi-implicit integration of the
    stochastic Landau-Lifshitz equation, Journal of Physics: Condensed Matter 22 (2010); A. Arnaudon, A. L. De Castro,
    D. D. Holm, Noise and dissipation on coadjoint orbits, Journal of Nonlinear Science 28 (2018).

    Examples
    --------
    >>> import coadjoint as co
    >>> field = co.Polynomial({(0, 0, 1): -1.0})
    >>> bath = co.forces.HeatBath(0.5, temperature=0.5, seed=7)
    >>> spin = co.LiePoissonSystem(co.algebras.so(3), field).with_forces(bath)
    >>> sol = co.integrate(spin, [(0.0, 0.6, 0.8)] * 3, t_span=(0, 10), step=0.125)
    >>> bool(sol.balance()["|x|^2"] < 1e-13)
    True
    """

    temperature: float = 0.0
    seed: Any = None
    stream: int = 0

    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        temperature = read_number(self.temperature, "temperature of HeatBath")
        if temperature < 0.0:
            raise ValueError(f"temperature of HeatBath is {temperature!r}; it must be zero or positive")
        object.__setattr__(self, "temperature", temperature)
        if self.seed is None:
            raise TypeError("HeatBath needs a seed, a whole number: runs with the same seed have the same noise")
        object.__setattr__(self, "seed", read_whole(self.seed, "seed of HeatBath", 0, LARGEST_SEED))
        object.__setattr__(self, "stream", read_whole(self.stream, "stream of HeatBath", 0, LARGEST_SEED))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("HeatBath is a noise, which has no field; its mean part is that of DoubleBracketDamping")

    @property
    def amplitude(self) -> float:
        """The factor of the Wiener processes, sqrt(2 alpha kT)."""
        return float(np.sqrt(2.0 * self.alpha * self.temperature))

    def noise(self, system: Any) -> Noise | None:
        """Return the noise of the temperature; none at zero."""
        if self.amplitude == 0.0:
            return None
        return Noise(self.amplitude, self.seed, self.stream, commuting_sets(system.algebra, self.metric))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if tau < 0.0:
            raise ValueError("HeatBath is a noise, which does not run backward")
        x = self._shaken(system, x, float(t), float(tau), 0)
        return self._shaken(system, super().flow(system, x, t, tau), float(t), float(tau), 1)

    def _shaken(self, system: Any, x: NDArray[Any], t: float, tau: float, half: int) -> NDArray[Any]:
        """Return the state after half of the noise, set by set; in the second half the other way."""
        noise = self.noise(system)
        if noise is None:
            return x
        deviates = normal_deviates(self.seed, self.stream, t, half, system.dim)
        root = root_of(self.metric, "metric")
        for some in reversed(noise.sets) if half else noise.sets:
            chosen = np.zeros(system.dim)
            chosen[list(some)] = deviates[list(some)]
            x = exponential(system, self.amplitude * np.sqrt(0.5 * tau) * applied(root, chosen), x)
        return x


def commuting_sets(algebra: Any, metric: Plain) -> tuple[tuple[int, ...], ...]:
    """Return the directions of a noise as sets that commute: of the basis, first fit; else one column of the root each.

    Parameters
    ----------
    algebra : LieAlgebra
        The algebra.
    metric : float, (n,) or (n, n)
        Of the damping that belongs to the noise.

    Returns
    -------
    tuple of tuple of int

    Examples
    --------
    >>> import coadjoint as co
    >>> commuting_sets(co.algebras.copies(co.algebras.so(3), 2), 1.0)
    ((0, 3), (1, 4), (2, 5))
    """
    root = root_of(metric, "metric")
    if root.ndim == 2:
        return tuple((a,) for a in range(algebra.dim) if np.any(root[:, a]))
    noisy = np.broadcast_to(root, (algebra.dim,)) != 0.0
    others: list[set[int]] = [set() for _ in range(algebra.dim)]
    for i, j in zip(algebra.triples.i.tolist(), algebra.triples.j.tolist(), strict=True):
        others[i].add(j)
        others[j].add(i)
    sets: list[list[int]] = []
    place: dict[int, int] = {}
    for a in np.flatnonzero(noisy).tolist():
        taken = {place[b] for b in others[a] if b in place}
        free = next(s for s in range(len(sets) + 1) if s not in taken)
        if free == len(sets):
            sets.append([])
        sets[free].append(a)
        place[a] = free
    return tuple(map(tuple, sets))
