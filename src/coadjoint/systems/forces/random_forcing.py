"""White-noise forcing of a band of scales of a fluid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.short_repr import short
from coadjoint.systems.forces.base import ForceReader, normal_deviates
from coadjoint.systems.forces.heat_bath import MAX_SEED
from coadjoint.systems.forces.mode_force import OnLayer, PerMode, modes_of
from coadjoint.systems.matrices.mode_basis import ModeBasis, Numbers, Waves, stream_values
from coadjoint.validation import read_finite, read_integer, read_number


@dataclass(frozen=True)
class RandomForcing(OnLayer):
    """White noise in time on a band of scales of a fluid of matrices, with a known mean rate of energy input.

    The real and the imaginary part of every mode of the band have independent Wiener processes, with equal shares of
    the energy: the noise is isotropic. Its flow is exact in distribution.
    The mean of the energy grows at `energy_rate`, in the unit of ``sol.energy`` and of the sum of ``energy_spectrum``:
    the integral of ``|u|^2/2`` over the surface, for every N. The mean of the enstrophy grows at that rate times the
    mean eigenvalue of minus the Laplacian over the components of the band.

    Parameters
    ----------
    energy_rate : float
        Mean rate of energy input, not negative: of the integral of ``|u|^2/2``, per time.
    band : (float, float)
        Lowest and highest degree l, or wave number ``|n|``, inclusive.
    seed : int
        Seed of the noise, from 0 to 2^62; the noise does not depend on other forces or members.
    stream : int
        Stream of the first member; member m of an ensemble has the noise of ``stream + m``.
    layer : {"vorticity", "carried"}
        The field on which it acts; "vorticity" if the state is one matrix.

    Raises
    ------
    ValueError, TypeError
        A negative rate, an invalid band, or an invalid seed.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> noise = co.forces.RandomForcing(0.5, band=(2, 3), seed=1)
    >>> s = co.systems.sphere_euler(N=8).with_forces(noise)
    >>> still = np.zeros((400, 8, 8))
    >>> sol = co.integrate(s, still, t_span=(0, 1), step=0.5, method=co.IsospectralGauss())
    >>> bool(abs(sol.energy[-1].mean() - 0.5) < 4 * 0.5 * np.sqrt(2 / 12 / 400))
    True
    """

    energy_rate: float
    band: Any
    seed: int
    stream: int = 0
    layer: str = "vorticity"

    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True
    selectors: ClassVar[tuple[str, ...]] = ("band",)

    def __post_init__(self) -> None:
        rate = read_number(self.energy_rate, "energy_rate of RandomForcing")
        if rate < 0.0:
            raise ValueError(f"energy_rate of RandomForcing is {rate!r}; it must be zero or positive")
        band = read_finite(self.band, "band of RandomForcing")
        if band.shape != (2,) or not 0.0 < band[0] <= band[1]:
            raise ValueError(f"band of RandomForcing is {short(self.band)}; give the lowest and the highest degree")
        object.__setattr__(self, "energy_rate", rate)
        object.__setattr__(self, "band", tuple(band.tolist()))
        for name in ("seed", "stream"):
            object.__setattr__(self, name, read_integer(getattr(self, name), f"{name} of RandomForcing", 0, MAX_SEED))
        self.read_layer()

    def check(self, system: Any) -> None:
        self._selected_modes(system, modes_of(system, self.label))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("RandomForcing is a noise, which has no field; it feeds energy in at energy_rate")

    def _selected_modes(self, system: Any, modes: ModeBasis) -> tuple[list[Numbers], PerMode]:
        """Return the numbers of the modes in the band, and their amplitudes, by diagonal."""
        # On the main diagonal only waves with n1 > 0 are included; the others are their conjugates.
        numbers: list[Numbers] = []
        energies: PerMode = []
        stream = system.stream if self.layer == "vorticity" else getattr(system, "second_stream", None)
        self.layer_index(system)
        if stream is None:
            raise ValueError(f"the carried field of {system.name} has no energy; force the vorticity instead")
        waves, components = modes.kind == Waves.kind, 0
        for d in range(modes.diagonals):
            candidates = modes.numbers(d)
            if waves and d == 0:
                candidates = candidates[: modes.N // 2]
            scales = modes.scales(d, candidates)
            numbers.append(candidates[(self.band[0] <= scales) & (scales <= self.band[1])])
            energies.append(system.energy_factor * stream_values(stream, modes, d, numbers[d]))
            components += (2 if d or waves else 1) * len(numbers[d])
        if not components:
            raise ValueError(f"band of RandomForcing is {self.band}; {system.name} has no {modes.scale} in it")
        if not all(np.all(energy > 0.0) for energy in energies):
            raise ValueError(f"the energy of {system.name} is not positive in the band {self.band} of RandomForcing")
        # energy |c|^2 / 2 for each part: real, and imaginary if there are two
        return numbers, [np.sqrt(2.0 * self.energy_rate / components / energy) for energy in energies]

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if tau < 0.0:
            raise ValueError("RandomForcing is a noise, which does not run backward")
        modes = modes_of(system, self.label)
        numbers, amplitudes = self._selected_modes(system, modes)
        count = sum(map(len, numbers))
        pairs = normal_deviates(self.seed, self.stream, float(t), 0, 2 * count).reshape(count, 2)
        coefficients, offset = [], 0
        for d, amplitude in enumerate(amplitudes):
            real, imaginary = pairs[offset : offset + len(amplitude)].T
            offset += len(amplitude)
            if d == 0 and modes.kind != Waves.kind:
                coefficients.append(1j * np.sqrt(tau) * amplitude * real)
                continue
            multiplicity = 2.0 if d == 0 else 1.0
            coefficients.append(multiplicity * np.sqrt(0.5 * tau) * amplitude * (real + 1j * imaginary))
        return np.asarray(x + self.layer_vector(system, modes.matrix(coefficients, numbers)))

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        return np.array(1.0)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        return reader.mode_noise(
            modes, *self._selected_modes(system, modes), self.seed, self.stream, self.layer_index(system)
        )
