"""Transport noise: white noise in the stream function of a fluid, which stirs it along its coadjoint orbit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import ForceReader
from coadjoint.systems.forces.matrix_noise import MatrixNoise
from coadjoint.systems.forces.mode_force import ModeBasis, Numbers, PerMode, Waves, modes_of, noise_matrix
from coadjoint.systems.forces.orbit_noise import NoiseTerms, OrbitNoise
from coadjoint.validation import as_tuples, read_finite, read_integer, read_nonnegative


def _read_degrees(value: Any, what: str) -> Any:
    degrees = np.atleast_1d(np.asarray(read_finite(value, what)))
    if degrees.ndim != 1 or not degrees.size:
        raise ValueError(f"{what} is {short(value)}; give one degree, or several, such as (2, 3)")
    found = tuple(read_integer(int(one) if one.is_integer() else one, what, 1) for one in degrees.tolist())
    if len(set(found)) < len(found):
        raise ValueError(f"{what} is {short(value)}; give each degree once")
    return found


def _read_spectrum(value: Any, what: str) -> Any:
    if value is None:
        return None
    shares = read_finite(value, what)
    if shares.ndim != 1 or np.any(shares < 0.0) or not np.any(shares > 0.0):
        raise ValueError(
            f"{what} is {short(value)}; give the share of each degree, none of them negative, not all zero"
        )
    return as_tuples(shares)


@suggest_keywords
@dataclass(frozen=True)
class TransportNoise(OrbitNoise):
    """Transport noise in the sense of Stratonovich: ``dW = [P dt + sum_k A_k o dB_k, W]``, modes A_k of a fluid.

    A random flow, white in time, carries the vorticity in addition to its own: on average over the paths it is an eddy
    diffusivity, and on each path every value of the vorticity keeps its area. Choose it for unresolved motions in an
    ensemble of fluids; for a random torque, which changes the vorticity itself, take `RandomForcing`. The noise of a
    degree includes all its modes with equal strengths, so that it is homogeneous and isotropic. On a rotating sphere
    the absolute vorticity is carried, and of two matrices both.

    The mean of the vorticity diffuses, ``d<omega>/dt = (strength^2/4) Laplacian <omega>`` in the limit of large
    matrices and without its own flow: degree l then decays at the rate ``strength^2 l(l + 1)/4``, the wave number n on
    the torus at ``strength^2 |n|^2/4``. For finite N the rate is lower: noise of degree d lacks the share ``(d(d + 1) -
    2) (l(l + 1) - 2)/(4 N^2)`` on the sphere, and ``(pi d |n|/N)^2`` on the torus, where this is small. Take N well
    above ``d l/2``, or ``pi d |n|``, for every degree whose decay matters; below, the mean keeps small scales too long,
    0.21 of the rate for degree 5, noise of degrees 6 and 7, and N = 16. `ito_drift` has the exact rate.

    It is the `HamiltonianNoise` of these modes: before or after a step, by a fair coin, two exponentials for any
    number of modes, of weak order two. Paths converge with order one half. Casimirs are preserved to round-off, and
    every path is a Poisson map.

    Parameters
    ----------
    degrees : int or sequence of int
        Degrees l on the sphere, or wave numbers ``|n|`` on the torus, each with the modes from l - 1/2 to l + 1/2.
    strength : float
        Root mean square of the random displacement in a time t, over the square root of t (length/sqrt(time), in radii
        of the sphere, or in sides of the torus over 2 pi); zero or positive.
    spectrum : sequence of float, optional
        Shares of the degrees in the mean square of the displacement, in their order; by default equal ones.
    seed : int
        Seed of the noise, from 0 to 2^62; it is required.
    stream, levels : int
        As for `HamiltonianNoise`.

    Raises
    ------
    ValueError, TypeError
        A negative strength, an invalid degree or spectrum, or the seed is missing. On systems: not a fluid, or one
        without modes of a degree.

    References
    ----------
    D. D. Holm, Variational principles for stochastic fluid dynamics, Proceedings of the Royal Society A 471 (2015);
    S. Ephrati, E. Jansson, A. Lang, E. Luesink, An exponential map free implicit midpoint method for stochastic
    Lie-Poisson systems, arXiv:2408.16701; M. Ninomiya, S. Ninomiya, A new higher-order weak approximation scheme for
    stochastic differential equations and the Runge-Kutta method, Finance and Stochastics 13 (2009).

    Examples
    --------
    >>> import coadjoint as co
    >>> noise = co.forces.TransportNoise(degrees=(2, 3), strength=0.4, seed=7)
    >>> s = co.systems.sphere_euler(N=8).with_forces(noise)
    >>> sol = co.integrate(s, [s.random(seed=1)] * 4, t_span=(0, 1), step=0.125, method=co.IsospectralGauss())
    >>> bool(sol.balance()["tr W^2"] < 1e-13)
    True
    """

    degrees: Any
    strength: float
    spectrum: Any = None
    seed: Any = None
    stream: int = 0
    levels: int = 0

    example: ClassVar = {"degrees": (1, 2), "strength": 0.3, "spectrum": (1.0, 2.0), "seed": 19}
    uses_energy: ClassVar[bool] = True
    selectors: ClassVar[tuple[str, ...]] = ("degrees", "spectrum")

    def __post_init__(self) -> None:
        self._read(degrees=_read_degrees, strength=read_nonnegative, spectrum=_read_spectrum)
        self._read_numbers()
        if self.spectrum is not None and len(self.spectrum) != len(self.degrees):
            raise ValueError(
                f"spectrum of TransportNoise has {len(self.spectrum)} shares for {len(self.degrees)} degrees; give one "
                "for each"
            )

    def check(self, system: Any) -> None:
        self._selected_modes(system, modes_of(system, self.label))

    def terms(self, system: Any) -> NoiseTerms:
        raise TypeError(f"TransportNoise acts on fluids of matrices, and {system.name} has vectors")

    def on_matrices(self, system: Any) -> MatrixNoise:
        modes = modes_of(system, self.label)
        numbers, amplitudes = self._selected_modes(system, modes)
        combined = partial(noise_matrix, modes, numbers, amplitudes, tau=1.0)
        return MatrixNoise(combined, 2 * sum(map(len, numbers)))

    def _selected_modes(self, system: Any, modes: ModeBasis) -> tuple[list[Numbers], PerMode]:
        """Return the numbers of the modes of the degrees, and their amplitudes, by diagonal."""
        # Each real mode has the stream function sigma Y, the integral of Y^2 being one; |grad Y|^2 has the mean of its
        # eigenvalue over the area. On the main diagonal only waves with n1 > 0 are included.
        waves, numbers, rounded, sums = modes.kind == Waves.kind, [], [], dict.fromkeys(self.degrees, 0.0)
        for d in range(modes.diagonals):
            candidates = modes.numbers(d)
            if waves and d == 0:
                candidates = candidates[: modes.N // 2]
            degrees = np.rint(modes.scales(d, candidates)).astype(np.int64)
            chosen = np.isin(degrees, self.degrees)
            numbers.append(candidates[chosen])
            rounded.append(degrees[chosen])
            parts = (2.0 if d or waves else 1.0) * modes.eigenvalues(d, numbers[d])
            for degree, part in zip(rounded[d].tolist(), parts.tolist(), strict=True):
                sums[degree] += part
        for degree, total in sums.items():
            if total == 0.0:
                raise ValueError(f"degrees of TransportNoise contain {degree}; {system.name} has no modes of it")
        shares = np.ones(len(self.degrees)) if self.spectrum is None else np.array(self.spectrum)
        factor = self.strength * np.sqrt(system.fluid.area / system.energy_unit / shares.sum())
        sizes = {degree: factor * np.sqrt(share / sums[degree]) for degree, share in zip(sums, shares, strict=True)}
        return numbers, [np.array([sizes[degree] for degree in of.tolist()]) for of in rounded]

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        return reader.mode_transport(
            system, modes, *self._selected_modes(system, modes), self.seed, self.stream, self.levels
        )
