"""Langevin dynamics: friction and thermal noise of momenta, linear ones and those of rotations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import check_moved, momenta_of
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.forces.base import (
    Force,
    ForceReader,
    Plain,
    ThermalNoise,
    normal_deviates,
    read_nonnegatives,
    read_seed,
    sample_states,
)
from coadjoint.systems.forces.orbit_flow import metric_root
from coadjoint.systems.forces.torque import is_on_bodies, shapes_on, torque_vector
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.validation import as_tuples, read_finite

KINETIC = 2.0**-30  # relative deviation of velocities from those of the kinetic energy that is rounding


@suggest_keywords
@dataclass(frozen=True)
class Langevin(Force):
    """Langevin dynamics of bodies, ``dp = ... - rate p dt + sqrt(2 rate kT m) dW``: friction and thermal noise.

    Choose it for rigid molecules, colloids and bodies in a fluid or a gas at a temperature: it acts on the linear
    momenta in space, with the mass m, and on the angular momenta in the frames of the bodies, with the tensor of
    inertia in place of m. So the stationary density is the Boltzmann distribution exp(-H/kT) of momenta, attitudes and
    positions. The coefficients of friction are ``rate m`` and ``rate I``, and those of diffusion, of bodies that move
    freely at times long against 1/rate, ``kT/(rate m)`` and ``kT/(rate I)``. Rods and linear molecules have no momentum
    along their axis, and get none. `HeatBath` on a body instead moves states along orbits.

    Its flow is an Ornstein-Uhlenbeck process, exact in distribution for any rate. A step consists of half of it, a step
    of the scheme, and the other half (OBABO with a splitting into kinetic energy and potential). Free bodies by
    ``Splitting(parts="free_body")`` have exactly the stationary density for every step; with a potential averages have
    an error of second order in the step, in velocities and in configurations. Times of relaxation also have an error of
    second order in rate times step: the coefficients of diffusion are larger by the factor (rate h/2) coth(rate h/2),
    1.02 for rate times step 0.5.

    Parameters
    ----------
    rate : float, (3,), (k, 3) or (n,) array_like
        Rates of friction (1/time), zero or positive. A number is that of every momentum. For bodies also the rates of
        the angular momentum about the axes of the body, (3,), or of k bodies (k, 3), without friction of linear
        momenta; or one for each coordinate, (n,), zero for those that are no momenta. Rates that differ between the
        axes of a body need principal axes, a diagonal tensor of inertia.
    temperature : float or (k,) array_like
        Boltzmann's constant times the temperature, in units of the energy, zero or positive; of k bodies also one for
        each. In SI units it is 1.380649e-23 T in J, T in kelvin; with energies in kJ/mol 0.0083145 T.
    seed : int
        Seed of the noise, from 0 to 2^62. It is required, so that no two runs share a noise by accident.
    stream : int
        Member m of a run has the noise number ``stream + m`` of the seed.

    Raises
    ------
    ValueError, TypeError
        A value is negative, not finite, or of the wrong shape; the seed is missing; or the energy of a system is not a
        quadratic kinetic energy of the momenta (for systems other than bodies, of each by itself) and a potential.

    References
    ----------
    R. L. Davidchack, T. E. Ouldridge, M. V. Tretyakov, New Langevin and gradient thermostats for rigid body dynamics,
    Journal of Chemical Physics 142 (2015); G. Bussi, M. Parrinello, Accurate sampling using Langevin dynamics, Physical
    Review E 75 (2007).

    Examples
    --------
    The angular velocities of an asymmetric body at a temperature: ``I_i <Omega_i^2> = kT``

    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.body((1.0, 2.0, 2.5)).with_forces(co.forces.Langevin(0.5, temperature=0.3, seed=1))
    >>> x0 = np.tile(body.state(), (2000, 1))
    >>> sol = co.integrate(body, x0, (0, 10), 0.25, co.Splitting(parts="free_body"), save_every=40)
    >>> energy = (np.array([1.0, 2.0, 2.5]) * sol.angular_velocity[-1] ** 2).mean(axis=0)
    >>> bool(np.all(abs(energy - 0.3) < 4 * 0.3 * np.sqrt(2 / 2000)))
    True
    """

    rate: Any
    temperature: Any = 0.0
    seed: Any = None
    stream: int = 0

    example: ClassVar = {"rate": 0.2, "temperature": 0.1, "seed": 17}
    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._require_seed()
        self._read(rate=_read_rates, temperature=read_nonnegatives, seed=read_seed, stream=read_seed)

    def check(self, system: Any) -> None:
        if system.has_matrices:
            raise ValueError(f"Langevin acts on momenta that are vectors, and the states of {system.name} are matrices")
        if system.frame_rate is not None:
            raise ValueError(f"Langevin is friction relative to space, and the frame of {system.name} turns")
        shape = np.shape(self.rate)
        if shape not in ((), (system.dim,)) and not is_on_bodies(shape, system):
            raise ValueError(
                f"rate of Langevin has the shape {shape}; {system.name} needs a number, or {shapes_on(system)}"
            )
        rates, momenta = self._rates(system), momenta_of(system)
        if momenta is not None:
            check_moved("rate of Langevin", system, (rates > 0.0) & ~momenta)
        count = len(getattr(system, "inertias", ()))
        if np.ndim(self.temperature) and len(self.temperature) != count:
            raise ValueError(
                f"temperature of Langevin has {len(self.temperature)} numbers, and {system.name} has {count} bodies; "
                "give a number, or one for each body"
            )
        self._check_kinetic_energy(system, rates)

    def _rates(self, system: Any) -> NDArray[np.float64]:
        """Return the rate of each coordinate, (n,)."""
        rate, momenta = np.asarray(self.rate, dtype=np.float64), momenta_of(system)
        if is_on_bodies(rate.shape, system):
            return torque_vector(rate, system)
        return rate if rate.ndim else np.where(np.ones(system.dim, bool) if momenta is None else momenta, rate, 0.0)

    def _check_kinetic_energy(self, system: Any, rates: NDArray[np.float64]) -> None:
        """Raise ValueError unless the derivatives of H by the momenta are the velocities of the kinetic energy."""
        moving, C = rates > 0.0, _covariance(system)
        if not hasattr(system, "inertias") and not np.isin(np.flatnonzero(moving), C.rows).all():
            raise _not_kinetic(system)
        if (moving[C.rows] & (rates[C.rows] != rates[C.columns])).any():
            raise ValueError(
                f"rate of Langevin differs between axes of a body of {system.name} whose tensor of inertia is not "
                "diagonal; give the inertia by principal moments, or a number"
            )
        for x in sample_states(system):
            x[moving] = C.times(x)[moving]
            try:
                with np.errstate(all="ignore"):
                    velocity = system.hamiltonian.gradient(x, sample_time_of(self))
            except Exception:  # outside its domain a user function may raise anything
                continue
            error = np.abs((C.times(np.where(moving, velocity, 0.0)) - x)[moving]).max(initial=0.0)
            if error > KINETIC * np.abs(x[moving]).max(initial=0.0):
                raise _not_kinetic(system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("Langevin is a noise, which has no field; its mean part is that of LinearDamping")

    def _noise(self, system: Any) -> ThermalNoise | None:
        """Return the noise; None at temperature zero."""
        if not np.any(self.temperature):
            return None
        root, kT = _covariance(system, root=True), np.asarray(self.temperature)
        size = np.sqrt(kT if not kT.ndim else kT[_body_of(system)[root.rows]])
        used = self._rates(system)[root.rows] > 0.0
        entries = root.rows[used], root.columns[used], np.broadcast_to(size * root.values, used.shape)[used]
        return ThermalNoise(*entries, self.seed, self.stream)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        self._check_forward(tau)
        rates, noise = self._rates(system), self._noise(system)
        y = x + np.expm1(-tau * rates) * x
        if noise is None:
            return np.asarray(y)
        deviates = normal_deviates(noise.seed, noise.stream, float(t), 0, system.dim)
        kicks = np.zeros(system.dim)
        np.add.at(kicks, noise.rows, noise.values * deviates[noise.columns])
        return np.asarray(y + np.sqrt(-np.expm1(-2.0 * tau * rates)) * kicks)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        return np.asarray(np.exp(-tau * self._rates(system)))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.thermal(self._rates(system), self._noise(system))


def _read_rates(value: Any, what: str) -> Plain:
    """Validate a number, a vector, or a row of three numbers for each body, zero or positive."""
    array = read_finite(value, what)
    if array.ndim < 2:
        return read_nonnegatives(value, what)
    if array.ndim != 2 or array.shape[1] != 3 or not array.size:
        raise ValueError(f"{what} has the shape {array.shape}; give a number, a vector, or (k, 3) for k bodies")
    read_nonnegatives(array.ravel(), what)
    return as_tuples(array)  # type: ignore[no-any-return]


def _not_kinetic(system: Any) -> ValueError:
    return ValueError(
        f"Langevin needs a kinetic energy of the momenta alone, a square of each or that of bodies without rotors, and "
        f"that of {system.name} is another; take HeatBath for spins and other momenta on orbits"
    )


class _Entries(NamedTuple):
    """The entries of a sparse matrix, by rows."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]

    def times(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        result = np.zeros(len(x))
        np.add.at(result, self.rows, self.values * x[self.columns])
        return result


@lru_cache(maxsize=16)
def _covariance(system: Any, root: bool = False) -> _Entries:
    """Return the covariance of the momenta at kT = 1, which are masses and tensors of inertia, or a root of it."""
    inertias = getattr(system, "inertias", None)
    if inertias is None:
        inverse = _diagonal_of_energy(system)
        moving = np.flatnonzero(inverse > 0.0)
        masses = 1.0 / inverse[moving]
        return _Entries(moving, moving, np.sqrt(masses) if root else masses)
    if len(getattr(system, "wheels", ())) + len(getattr(system, "gyros", ())):
        raise _not_kinetic(system)
    tensors = {id(one): _root_of(one.tensor) if root else one.tensor for one in inertias}
    blocks = [np.nonzero(tensors[id(one)]) for one in inertias]
    begins = np.repeat(PER_BODY * np.arange(len(inertias)), [len(block[0]) for block in blocks])
    rows, columns = (begins + np.concatenate([block[axis] for block in blocks]) for axis in (0, 1))
    values = np.concatenate([tensors[id(one)][block] for one, block in zip(inertias, blocks, strict=True)])
    masses = np.repeat(np.asarray(getattr(system, "masses", ()), dtype=np.float64), 3)
    linear = PER_BODY * len(inertias) + np.arange(len(masses))
    values = np.concatenate([values, np.sqrt(masses) if root else masses])
    return _Entries(np.concatenate([rows, linear]), np.concatenate([columns, linear]), values)


def _root_of(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L with L L^T equal to a tensor of inertia."""
    moments = np.diag(tensor)
    return np.diag(np.sqrt(moments)) if np.array_equal(tensor, np.diag(moments)) else metric_root(tensor, "inertia")


def _diagonal_of_energy(system: Any) -> NDArray[np.float64]:
    """Return the diagonal of the quadratic terms of H; zero for coordinates without."""
    diagonal = np.zeros(system.dim)
    for term in system.hamiltonian.terms():
        if term.form is not None:
            own = term.form.rows == term.form.indices
            np.add.at(diagonal, term.form.rows[own], term.form.values[own])
    return diagonal


def _body_of(system: Any) -> NDArray[np.int64]:
    """Return the body to which each coordinate of bodies belongs, (n,)."""
    k, count = np.arange(system.dim), len(system.inertias)
    linear = (k - PER_BODY * count) // 3 % count
    return np.where(k < PER_BODY * count, k // PER_BODY, linear)
