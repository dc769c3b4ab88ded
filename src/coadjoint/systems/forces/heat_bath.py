"""A heat bath: damping along coadjoint orbits, and the noise of its temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.forces.base import Noise, Plain, apply_metric, metric_root, normal_deviates, read_seed
from coadjoint.systems.forces.double_bracket import DoubleBracketDamping, exponential, exponential_with_tangent
from coadjoint.systems.forces.orbit_flow import Exponential, OrbitFlow, bracket_of
from coadjoint.validation import read_nonnegative


@dataclass(frozen=True)
class HeatBath(DoubleBracketDamping):
    """A heat bath for spins, and for any coadjoint orbit: damping and thermal noise.

    ``dx = sign J(x) (grad H dt + alpha P sign J(x) grad H dt + sqrt(2 alpha kT) L o dW)`` in the sense of Stratonovich,
    with L L^T = P and independent Wiener processes W. The stationary density on an orbit is the Boltzmann distribution,
    exp(-H/kT), with respect to the symplectic volume of the orbit: for spins the area on their spheres. In Gilbert's
    form with damping a, where H is multiplied by 1/(1 + a^2), multiply the temperature by the same factor.

    The flow is half of the noise, the midpoint rule of the damping, and half of the noise, all by exponentials on the
    orbit: every Casimir is preserved to round-off, in every realization. Commuting noise directions are applied
    together, with the exact distribution, and the sets of them are composed symmetrically. So averages have an error of
    second order in the step, whereas the stochastic midpoint rule, which takes all directions at once, has order one.
    The noise enters no iteration, and increments need no truncation.

    The noise is a function of the seed, the number of the member and the time only: it does not depend on the number of
    threads, on other members, or on how often a run is interrupted and resumed. Consecutive spans have different noise.
    Runs backward in time raise an error.

    Parameters
    ----------
    alpha : float
        Strength of the damping, as for `DoubleBracketDamping`.
    metric : float, (n,) or (n, n) array_like
        As for `DoubleBracketDamping`.
    temperature : float
        Boltzmann's constant times the temperature, in units of the energy; zero or positive.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed. With stream=m a single run is bit-identical
        to member m of an ensemble.

    Raises
    ------
    ValueError, TypeError
        A value is negative, not finite, or of the wrong shape; or the seed is missing.

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
        if self.seed is None:
            raise TypeError("HeatBath needs a seed, a whole number: runs with the same seed have the same noise")
        self._read(temperature=read_nonnegative, seed=read_seed, stream=read_seed)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("HeatBath is a noise, which has no field; its mean part is that of DoubleBracketDamping")

    @property
    def amplitude(self) -> float:
        """Factor of the Wiener processes, sqrt(2 alpha kT)."""
        return float(np.sqrt(2.0 * self.alpha * self.temperature))

    def noise(self, system: Any) -> Noise | None:
        """Return the thermal noise; None at temperature zero."""
        if self.amplitude == 0.0:
            return None
        return Noise(self.amplitude, self.seed, self.stream, commuting_sets(system.algebra, self.metric))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if tau < 0.0:
            raise ValueError("HeatBath is a noise, which does not run backward")
        x = self._apply_noise(system, x, float(t), float(tau), 0)
        return self._apply_noise(system, super().flow(system, x, t, tau), float(t), float(tau), 1)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64] | None:
        """Return the derivative of the flow with the same noise."""
        product, y = np.eye(len(x)), x
        for v in self._noise_directions(system, t, tau, 0):
            y, by_x, _ = exponential_with_tangent(system, v, y)
            product = by_x @ product
        damping = super().tangent(system, y, t, tau)
        if damping is None:
            return None
        y, product = super().flow(system, y, t, tau), damping @ product
        for v in self._noise_directions(system, t, tau, 1):
            y, by_x, _ = exponential_with_tangent(system, v, y)
            product = by_x @ product
        return np.asarray(product)

    def orbit_flow(self, system: Any, x: NDArray[np.float64], t: float, tau: float) -> OrbitFlow | None:
        """Return the flow with the same noise, with its transposed derivative."""
        stages: list[Any] = []

        def noise(half: int) -> None:
            for v in self._noise_directions(system, t, tau, half):
                stages.append(Exponential.of(bracket, v, stages[-1].end if stages else x))

        bracket = bracket_of(system.algebra, system.sign)
        noise(0)
        damping = self._midpoint_stage(system, stages[-1].end if stages else x, t, tau)
        if damping is None:
            return None
        stages.append(damping)
        noise(1)
        return OrbitFlow(stages, self.scalings())

    def scalings(self) -> dict[str, tuple[Any, Any]]:
        return {**super().scalings(), "temperature": (0.5 / self.temperature if self.temperature else 0.0, 0.0)}

    def _apply_noise(self, system: Any, x: NDArray[Any], t: float, tau: float, half: int) -> NDArray[Any]:
        """Apply half of the noise, set by set."""
        for v in self._noise_directions(system, t, tau, half):
            x = exponential(system, v, x)
        return x

    def _noise_directions(self, system: Any, t: float, tau: float, half: int) -> Iterator[NDArray[np.float64]]:
        """Yield the directions of the exponentials of half of the noise; the second half uses the reverse order."""
        noise = self.noise(system)
        if noise is None:
            return
        deviates = normal_deviates(self.seed, self.stream, t, half, system.dim)
        root = metric_root(self.metric, "metric")
        for directions in reversed(noise.sets) if half else noise.sets:
            selected = np.zeros(system.dim)
            selected[list(directions)] = deviates[list(directions)]
            yield self.amplitude * np.sqrt(0.5 * tau) * apply_metric(root, selected)


@lru_cache(maxsize=16)
def commuting_sets(algebra: Any, metric: Plain) -> tuple[tuple[int, ...], ...]:
    """Partition noise directions into commuting sets: basis elements by first fit, else one column of the root each."""
    root = metric_root(metric, "metric")
    if root.ndim == 2:
        return tuple((a,) for a in range(algebra.dim) if np.any(root[:, a]))
    noisy = np.broadcast_to(root, (algebra.dim,)) != 0.0
    neighbours: list[set[int]] = [set() for _ in range(algebra.dim)]
    for i, j in zip(algebra.triples.i.tolist(), algebra.triples.j.tolist(), strict=True):
        neighbours[i].add(j)
        neighbours[j].add(i)
    sets: list[list[int]] = []
    set_of: dict[int, int] = {}
    for a in np.flatnonzero(noisy).tolist():
        used = {set_of[b] for b in neighbours[a] if b in set_of}
        index = next(s for s in range(len(sets) + 1) if s not in used)
        if index == len(sets):
            sets.append([])
        sets[index].append(a)
        set_of[a] = index
    return tuple(map(tuple, sets))
