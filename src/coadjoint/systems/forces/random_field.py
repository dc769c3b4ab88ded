"""A random field on spins: Hamiltonian noise of their components."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.orbit_noise import NoiseTerm, NoiseTerms, OrbitNoise, read_strength
from coadjoint.validation import read_bool


@suggest_keywords
@dataclass(frozen=True)
class RandomField(OrbitNoise):
    """A random field on spins, white noise in the sense of Stratonovich: ``dS = ... + strength J(S) o dB`` at sites.

    Choose it for dephasing and rotational diffusion of spins without a temperature; `HeatBath` adds the damping that
    leads to equilibrium. Each site has three independent Brownian motions, or all sites have the same three. A free
    spin forgets its direction as ``E P_l = exp(-strength^2 l (l + 1) t/2)`` for Legendre polynomials P_l. It is the
    `HamiltonianNoise` of all coordinates, which has the scheme and its order; each site keeps its length to round-off.

    Parameters
    ----------
    strength : float or (3,) array_like
        Strength along all axes, or along each: of the field times the square root of time.
    common : bool
        Whether all sites have the same field, as of fluctuations of an external one.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream, levels : int
        As for `HamiltonianNoise`.

    Raises
    ------
    ValueError, TypeError
        A strength that is not finite or of the wrong shape, or a missing seed. A system other than copies of so(3),
        when it is added to a system.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> ring = co.systems.spin_lattice("ring", 8, exchange=0.0).with_forces(co.forces.RandomField(0.5, seed=1))
    >>> up = np.tile((0.0, 0.0, 1.0), (500, 8)).reshape(500, 24)
    >>> sol = co.integrate(ring, up, t_span=(0, 1), step=0.25)
    >>> bool(abs(sol.x[-1, :, 2::3].mean() - np.exp(-(0.5**2))) < 0.04)
    True
    """

    strength: Any = 1.0
    common: bool = False
    seed: Any = None
    stream: int = 0
    levels: int = 0

    example: ClassVar = {"strength": 0.3, "seed": 12}

    def __post_init__(self) -> None:
        self._read(strength=read_strength, common=read_bool)
        self._read_numbers()
        shape = np.shape(self.strength)
        if shape not in ((), (3,)):
            raise ValueError(
                f"strength of RandomField has the shape {shape}; give a number, or one for each axis, (3,)"
            )

    def check(self, system: Any) -> None:
        super().check(system)
        i, j, k, _ = system.algebra.triples
        if system.dim % 3 or len(i) != system.dim or np.any((i // 3 != j // 3) | (i // 3 != k // 3)):
            raise TypeError(
                f"RandomField acts on spins, copies of so(3), and the algebra of {system.name} is another; take "
                "HamiltonianNoise"
            )

    def terms(self, system: Any) -> NoiseTerms:
        return _terms_of_spins(self, system.dim)


@lru_cache(maxsize=64)
def _terms_of_spins(field: RandomField, n: int) -> NoiseTerms:
    strength = np.broadcast_to(np.asarray(field.strength, dtype=np.float64), 3)
    axes = np.arange(n).reshape(-1, 3).T
    if field.common:
        terms = [NoiseTerm(sites, np.full(len(sites), size)) for sites, size in zip(axes, strength, strict=True)]
        return NoiseTerms(tuple(terms), ((0,), (1,), (2,)))
    terms = [NoiseTerm(np.array([i]), strength[i % 3 : i % 3 + 1]) for i in range(n)]
    return NoiseTerms(tuple(terms), tuple(tuple(sites.tolist()) for sites in axes))
