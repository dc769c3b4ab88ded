"""Gilbert's damping of spins and its heat bath, with the time factor 1/(1 + alpha^2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import Spins, spins_in
from coadjoint.systems.forces.base import ForceReader, SpinTerms, read_nonnegatives, read_seed
from coadjoint.systems.forces.double_bracket import DoubleBracketDamping, HeatBath, read_boltzmann
from coadjoint.systems.forces.orbit_flow import exponential_with_tangent
from coadjoint.validation import set_fields


@suggest_keywords
@dataclass(frozen=True)
class Gilbert(HeatBath):
    """Gilbert's damping of spins, ``S' = S cross B + alpha/|S| S' cross S``, and its heat bath.

    Choose it to run with the damping constants and temperatures of VAMPIRE, Spirit, UppASD and mumax3, which write the
    stochastic Landau-Lifshitz-Gilbert equation. Solved for S', with B = -dH/dS,

    ``S' = 1/(1 + alpha^2) (S cross B - alpha/|S| S cross (S cross B))``,

    the field, the damping and the noise all have the time factor 1/(1 + alpha^2). The factor of the field is part of
    this force, which adds ``(1/(1 + alpha^2) - 1) S cross B``, so that ``sol.energy`` is that of H, and the work of
    ``"Gilbert"`` the heat that the bath takes and gives. On a system with moments mu of sites, S has the length 1 and
    ``B = -(1/mu) dH/dS``, and alpha is the same number. `HeatBath` is the form of Landau and Lifshitz, without the
    factor and the length, for any Lie algebra.

    A magnetic moment, ``m' = -gamma/(1 + alpha^2) (m cross B + alpha m cross (m cross B))``, is S = -m in the field -B
    (see `co.systems.spin_lattice`).

    The flow is that of `HeatBath`: rotations of each spin, which keep its length to round-off. Averages have an error
    of second order in the step; without noise it has the order of the scheme, up to ten, and runs backward too.

    Parameters
    ----------
    alpha : float or (spins,) array_like
        Gilbert's damping constant of all spins or of each, dimensionless, zero or positive.
    temperature : float or (spins,) array_like
        Boltzmann's constant times the temperature of all spins or of each, in units of the energy; zero or positive.
        With energies in meV and T in kelvin it is 0.08617 T; models of `co.systems.spins` in units of meV take kelvin.
    seed : int, optional
        Seed of the noise, from 0 to 2^62; required at a temperature above zero.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed.
    boltzmann : float, optional
        Energy of a unit of `temperature`, positive; that of the system if omitted, 1 but for models in kelvin.

    Raises
    ------
    ValueError, TypeError
        A value is negative, not finite, or of the wrong shape; the seed is missing; or the system does not consist of
        spins, which are copies of so(3).

    References
    ----------
    T. L. Gilbert, A phenomenological theory of damping in ferromagnetic materials, IEEE Transactions on Magnetics 40
    (2004); R. F. L. Evans et al., Atomistic spin model simulations of magnetic nanomaterials, Journal of Physics:
    Condensed Matter 26 (2014).

    Examples
    --------
    A spin precesses about a field B at the rate B/(1 + alpha^2), and relaxes at alpha times this rate:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> alpha, B, t = 0.5, 2.0, 3.0
    >>> spin = co.systems.spin_lattice([], 1, field=(0, 0, B)).with_forces(co.forces.Gilbert(alpha))
    >>> S = co.integrate(spin, (1.0, 0.0, 0.0), (0, t), 0.01).x[-1]
    >>> rate = B / (1 + alpha**2)
    >>> bool(abs(S[2] - np.tanh(alpha * rate * t)) < 1e-5)
    True
    >>> bool(np.allclose(S[:2] / np.hypot(*S[:2]), [np.cos(rate * t), -np.sin(rate * t)], atol=1e-5))
    True
    """

    alpha: Any
    metric: ClassVar[Any] = 1.0  # type: ignore[misc]
    temperature: Any = 0.0
    seed: Any = None
    stream: int = 0
    boltzmann: float | None = None

    example: ClassVar = {"alpha": 0.25, "temperature": 0.1, "seed": 23}

    def __post_init__(self) -> None:
        self._read(alpha=read_nonnegatives, temperature=read_nonnegatives, stream=read_seed, boltzmann=read_boltzmann)
        is_random = bool(np.any(self.temperature))
        set_fields(self, random=is_random, reversible=not is_random)
        if is_random:
            self._require_seed()
        if self.seed is not None:
            self._read(seed=read_seed)

    def check(self, system: Any) -> None:
        spins = _spins_of(system)
        for name in ("alpha", "temperature"):
            value = np.asarray(getattr(self, name))
            if value.ndim and len(value) != len(spins.constants):
                raise ValueError(
                    f"{name} of Gilbert has {len(value)} numbers, and {system.name} {len(spins.constants)} spins; give "
                    "one number, or one for each spin"
                )

    def _check_kinds(self, system: Any) -> None:
        """All coordinates of spins are momenta."""

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        if self.random:
            raise TypeError("Gilbert is a noise at this temperature, and has no field; its mean part is Gilbert(alpha)")
        return DoubleBracketDamping.field(self, system, x, t)

    def _per_coordinate(self, system: Any, values: Any) -> NDArray[np.float64]:
        """Return a number of all spins or of each as one of each coordinate, (n,); zero for others."""
        found, spins = np.zeros(system.dim), _spins_of(system)
        found[spins.coordinates] = np.broadcast_to(values, len(spins.constants))[:, None]
        return found

    def _factors(self, system: Any) -> tuple[NDArray[np.float64], SpinTerms]:
        """Return the metric of the damping with its strength, (n,), for spins of length one, and its other terms."""
        spins, alpha = _spins_of(system), np.asarray(self.alpha)
        rates = alpha / (1.0 + alpha * alpha) / np.abs(spins.constants)
        added = self._per_coordinate(system, -alpha * alpha / (1.0 + alpha * alpha))
        return self._per_coordinate(system, rates), SpinTerms(added, spins.coordinates)

    def _metric_on(self, system: Any) -> Any:
        return tuple(self._factors(system)[0].tolist())

    def _temperatures(self, system: Any) -> Any:
        return self._per_coordinate(system, self.temperature)

    def _damping_direction(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        rates, terms = self._factors(system)
        damping = rates / terms.lengths(x) * system.vector_field(x, t)
        return np.asarray(damping + terms.added * system.hamiltonian.gradient(x, t))

    def _direction_tangent(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        rates, terms = self._factors(system)
        rates = rates / terms.lengths(x)
        linear = rates[:, None] * system.jacobian(x, t) + terms.added[:, None] * system.hamiltonian.hessian(x, t)
        return np.asarray(linear - np.outer(rates * system.vector_field(x, t), x) * _squared(terms, x))

    @property
    def amplitude(self) -> float:
        """Factor of the Wiener processes of a unit metric, at the highest temperature."""
        return float(np.sqrt(2.0 * self._highest_energy))

    def _at(self, system: Any, v: NDArray[np.float64], x: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(v / np.sqrt(self._factors(system)[1].lengths(x)))

    def _noise_tangent(
        self, system: Any, v: NDArray[np.float64], x: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        v = self._at(system, v, x)
        end, by_x, by_v = exponential_with_tangent(system, v, x)
        return end, by_x - 0.5 * by_v @ (np.outer(v, x) * _squared(self._factors(system)[1], x))

    def scalings(self, system: Any) -> dict[str, tuple[Any, ...]]:
        spins, alpha = _spins_of(system), np.asarray(self.alpha)
        factor, found = 1.0 / (1.0 + alpha * alpha), dict[str, tuple[Any, ...]]()
        if not self.random or np.all(alpha > 0.0):  # not of a vanishing noise, which grows with a root
            slope = (1.0 - alpha * alpha) * factor
            log_slope = 0.5 * slope / alpha if self.random else 0.0
            of_rates = slope * factor / np.abs(spins.constants)
            values = log_slope, of_rates, -2.0 * alpha * factor * factor
            found["alpha"] = tuple(self._by_entry(system, one, alpha.ndim) for one in values)
        kT = np.asarray(self.temperature)
        by_kT = np.divide(0.5, kT, out=np.zeros(kT.shape), where=kT > 0.0)
        return {**found, "temperature": (self._by_entry(system, by_kT, kT.ndim), 0.0, 0.0)}

    def _by_entry(self, system: Any, values: Any, dimensions: int) -> NDArray[np.float64]:
        """Return derivatives of coefficients of coordinates by one entry, or by that of their spin, (entries, n)."""
        found, spins = self._per_coordinate(system, values), _spins_of(system).coordinates
        if not dimensions:
            return found[None]
        each = np.zeros((len(spins), system.dim))
        each[np.arange(len(spins))[:, None], spins] = found[spins]
        return each

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        rates, terms = self._factors(system)
        return reader.on_orbit(rates, self._root(system), self.noise(system), terms)


def _squared(terms: SpinTerms, x: NDArray[Any]) -> NDArray[Any]:
    """Return 1/|S|^2 of the spin of coordinates (i, j), (n, n); zero for coordinates of different spins."""
    same = np.zeros((len(x), len(x)), dtype=bool)
    for spin in terms.spins:
        same[np.ix_(spin, spin)] = True
    return np.where(same, terms.lengths(x)[:, None] ** -2.0, 0.0)


def _spins_of(system: Any) -> Spins:
    """Return the spins of a system; ValueError for other systems."""
    found = spins_in(system.algebra) if system.has_structure_constants else None
    if found is None:
        raise ValueError(
            f"Gilbert is the damping of spins, and {system.name} does not consist of copies of so(3); take "
            "DoubleBracketDamping or HeatBath"
        )
    if found.rounded:
        raise ValueError(
            f"Gilbert needs one structure constant for the three brackets of each spin, and those of {system.name} "
            "differ by rounding; give equal ones"
        )
    return found
