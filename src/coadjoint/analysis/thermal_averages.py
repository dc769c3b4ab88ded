"""Averages of spins in thermal equilibrium with standard errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.signals import autocorrelation
from coadjoint.analysis.thermal_states import spin_energy, states_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import read_seed
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.declared_spins import UNITS
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_finite, read_integer

Floats = npt.NDArray[np.float64]

MIN_SAMPLES = 16  # of each member, from which correlations are estimated


class Estimate(NamedTuple):
    """An average and its standard error, numbers or arrays over temperatures."""

    value: Any
    error: Any


@dataclass(frozen=True, eq=False, repr=False)
class ThermalAverages:
    """Averages of spins in thermal equilibrium; `co.spins.thermal_averages` computes them.

    Each is an `Estimate` with ``value`` and ``error``, numbers or (temperatures,).

    Attributes
    ----------
    temperature : float or (temperatures,) ndarray
        As given.
    energy : Estimate
        Energy of a spin.
    heat_capacity : Estimate
        Heat capacity of a spin over Boltzmann's constant.
    magnetization : Estimate
        Mean size of the magnetization, relative to that of parallel spins.
    susceptibility : Estimate
        Change of the moment of a spin with a weak field along it, averaged over the directions of the field; of
        `SpinModel` in mu_B over the unit of the field (tesla).
    binder : Estimate
        1 - <m^4>/(3 <m^2>^2) of the magnetization m: 4/9 of random directions, 2/3 of an ordered lattice.
    """

    temperature: Any
    energy: Estimate
    heat_capacity: Estimate
    magnetization: Estimate
    susceptibility: Estimate
    binder: Estimate

    def __repr__(self) -> str:
        return f"<averages of spins at {np.size(self.temperature)} temperatures>"


@suggest_keywords
@long_operation("thermal_averages")
def thermal_averages(
    system: Any,
    temperature: npt.ArrayLike,
    *,
    seed: int,
    members: int = 8,
    sweeps: int = 1000,
    start: int = 200,
    every: int = 5,
    weights: npt.ArrayLike | None = None,
    x0: npt.ArrayLike | None = None,
    over_relaxation: int = 0,
    method: str = "heat bath",
) -> ThermalAverages:
    """Return averages of spins at temperatures, with standard errors, by Monte Carlo sweeps.

    Choose it for curves over the temperature, and for Curie temperatures by Binder's crossing. The chains are those of
    `co.thermal_states`; samples of one chain are correlated, which the errors take into account.

    Parameters
    ----------
    system : SpinModel or LiePoissonSystem
        Spins, as for `co.thermal_states`, also of SU(N), whose moments are those of their dipoles. On a twisted lattice
        the magnetization is that of its own cells, and fields turn beyond the ends as the spins do.
    temperature : float or (temperatures,) array_like
        In the unit of the system: kelvin for models in units of meV, else an energy.
    seed : int
        Seed of the random numbers, from 0 to 2^62.
    members : int
        Independent chains at each temperature.
    sweeps : int
        Sweeps of each chain that count.
    start : int
        Sweeps before, which bring the chains to equilibrium.
    every : int
        Sweeps from one sample to the next; at least 16 samples are needed.
    weights : (spins,) array_like, optional
        Weights of the spins in the magnetization, such as +1 and -1 for the order of an antiferromagnet. By default
        the moments of a `SpinModel`, else one for each.
    x0 : (n,) array_like, optional
        First state of all chains. None is random directions.
    over_relaxation, method
        As for `co.thermal_states`.

    Returns
    -------
    ThermalAverages
        With ``energy``, ``heat_capacity``, ``magnetization``, ``susceptibility`` and ``binder``.

    Raises
    ------
    TypeError, ValueError
        As of `co.thermal_states`; too few samples, or weights of another shape.

    Notes
    -----
    Standard errors are those of `co.spectra.autocorrelation`, for functions of averages of the linearized series: two
    of them hold the truth in 95 of 100 cases. They are NaN where a few chains are too short to tell. The members at
    one temperature are compared with each other, so that chains in different valleys have large errors.

    References
    ----------
    K. Binder, Z. Phys. B 43, 119 (1981), the crossing.

    Examples
    --------
    Free spins in a field B, of the energy -B (coth(B/kT) - kT/B):

    >>> import numpy as np, coadjoint as co
    >>> spins = co.systems.spin_lattice([], 20, field=(0, 0, 1.0))
    >>> found = co.spins.thermal_averages(spins, 0.5, seed=1, sweeps=400, start=5)
    >>> energy, error = found.energy
    >>> bool(abs(energy + 1 / np.tanh(2) - 0.5) < 4 * error < 0.02)
    True
    """
    known, coherent = spin_energy(system, "thermal_averages"), isinstance(system, CoherentSpinModel)
    temperatures = read_finite(temperature, "temperature")
    if temperatures.ndim > 1 or not temperatures.size:
        raise ValueError(f"temperature has shape {temperatures.shape}; give one number, or one for each curve point")
    key, count = read_seed(seed, "seed"), read_integer(members, "members", 1)
    total, first = read_integer(sweeps, "sweeps", 1), read_integer(start, "start", 0)
    spacing, spins = read_integer(every, "every", 1), known.sites
    samples = total // spacing
    if samples < MIN_SAMPLES:
        raise ValueError(f"{total} sweeps have {samples} samples, one every {spacing}; {MIN_SAMPLES} are needed")
    own = system.moments if isinstance(system, SpinModel) else np.ones(spins)
    factors = own if weights is None else read_finite(weights, "weights")
    if factors.shape != (spins,) or not np.any(factors):
        raise ValueError(f"weights is {short(weights)}; give {spins} numbers, one for each spin, and not only zeros")
    points = np.repeat(np.atleast_1d(temperatures), count)
    check_available_memory(8 * len(points) * (4 * samples + 2 * system.dim), "averages")
    x: Any = None if x0 is None else read_finite(x0, "x0")
    if x is not None and x.shape != (system.dim,):
        raise ValueError(f"x0 has shape {x.shape}; {system.name} needs ({system.dim},)")
    lengths = np.ones(spins) if x is None or coherent else np.linalg.norm(x.reshape(-1, 3), axis=1)
    parallel = float(np.abs(factors * lengths).sum())
    if parallel == 0.0:
        raise ValueError("x0 has length zero at all spins with a weight; give spins of other lengths")
    energies, moments = np.empty((samples, len(points))), np.empty((samples, len(points), 3))
    for k in range(-1 if first else 0, samples):
        block, length = _seed_of_block(key, k + 1), first if k < 0 else spacing
        states = states_of(known, system, points, len(points), block, length, method, over_relaxation, x)
        x = states.x
        if k >= 0:
            energies[k] = states.energy[-1]
            directions = system.dipoles(x) / system.spin[:, None] if coherent else x.reshape(len(points), spins, 3)
            moments[k] = np.einsum("i,mia->ma", factors, directions)
        note_progress("averages", (k + 1) / samples)
    kT = system.boltzmann * np.atleast_1d(temperatures)
    conjugate = UNITS[system.units].mu_B if isinstance(system, SpinModel) else 1.0
    rows = [
        _averages(energies[:, chains], moments[:, chains], float(T), spins, parallel, conjugate)
        for T, chains in zip(kT, np.arange(len(points)).reshape(-1, count), strict=True)
    ]
    columns = []
    for estimates in zip(*rows, strict=True):
        value, error = np.array(estimates).T
        columns.append(Estimate(value, error) if temperatures.ndim else Estimate(float(value[0]), float(error[0])))
    return ThermalAverages(temperatures if temperatures.ndim else float(temperatures), *columns)


def _seed_of_block(key: int, k: int) -> int:
    """Return the seed of the sweeps before a sample, another one for each."""
    return int(np.random.SeedSequence([key, k]).generate_state(1, np.uint64)[0] >> np.uint64(2))


def _averages(
    E: Floats, M: Floats, kT: float, spins: int, parallel: float, conjugate: float
) -> list[tuple[float, float]]:
    """Return estimates from energies (samples, members) and moments (samples, members, 3) at one temperature."""
    energy, energy_error = _mean(E)
    deviations = (E - energy) ** 2
    square, square_error = _mean(deviations)
    centre = [_mean(M[..., axis]) for axis in range(3)]
    scatter = ((M - [mean for mean, _ in centre]) ** 2).sum(axis=-1)
    width, width_error = _mean(scatter)
    size = np.linalg.norm(M, axis=-1) / parallel
    second, fourth = float((size**2).mean()), float((size**4).mean())
    # The variance about the mean of the samples is smaller than that about the truth by the variance of this mean.
    of_mean = energy_error**2 if math.isfinite(energy_error) else 0.0
    of_centre = sum(error**2 for _, error in centre if math.isfinite(error))
    response = conjugate / (3.0 * spins * kT)
    linear = -(size**4) / (3.0 * second**2) + 2.0 * fourth * size**2 / (3.0 * second**3) if second else 0.0 * size
    return [
        (energy / spins, energy_error / spins),
        ((square + of_mean) / (spins * kT**2), square_error / (spins * kT**2)),
        _mean(size),
        (response * (width + of_centre), response * width_error),
        (1.0 - fourth / (3.0 * second**2) if second else math.nan, _mean(linear)[1]),
    ]


def _mean(series: Floats) -> tuple[float, float]:
    """Return the mean of correlated samples (samples, members) and its standard error."""
    if not np.ptp(series):
        return float(series.flat[0]), 0.0
    scale = float(np.abs(series).max())
    found = autocorrelation(np.arange(len(series)), (series / scale)[:, :, None])
    return scale * float(found.mean[0]), scale * float(found.mean_error[0])
