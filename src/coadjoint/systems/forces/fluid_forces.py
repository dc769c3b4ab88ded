"""Forces on fluids of matrices: friction, viscosity, the beta term, and white-noise forcing of a band of scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force, ForceReader, normal_deviates, read_seed
from coadjoint.systems.forces.mode_force import (
    LayerChange,
    ModeBasis,
    ModeRates,
    Numbers,
    PerMode,
    Waves,
    layer_index,
    layer_vector,
    modes_of,
    noise_matrix,
    read_layer,
)
from coadjoint.systems.matrices.streams import LayeredStream
from coadjoint.systems.matrices.torus_modes import representatives
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import as_tuples, read_bool, read_finite, read_integer, read_nonnegative, read_number


@suggest_keywords
@dataclass(frozen=True)
class Friction(ModeRates):
    """Scale-dependent friction of a fluid of matrices: ``W' = -rate(l) W`` on the degree l, solved exactly.

    W is the vorticity relative to the frame; in quasi-geostrophic flows it is the potential vorticity without its
    planetary and topographic terms, so that a flow comes to rest.

    Choose it for drag on large scales only, or as a filter. If all scales have the same rate, `LinearDamping` is
    cheaper; for viscous damping use `Viscosity`.

    Parameters
    ----------
    rate : float, or callable
        Rate (1/time), or a function of one number: of the degree l on the sphere, of the wave number
        ``|n|`` on the torus.
        A mode of rate zero keeps its bits, and negative rates amplify. A function is called once for each scale and
        is not compiled.
    layer : {"vorticity", "carried"} or int
        The field on which it acts, "vorticity" if the state is one matrix, or in a `layered_qg` the potential vorticity
        of all layers alike. The number of a layer, from 0, is the drag of that layer on its **relative** vorticity,
        ``q_k' = -rate Laplacian psi_k``, such as the bottom friction of the lowest one (of a coupling by `gamma`).
        Either way the energy falls.

    Raises
    ------
    ValueError, TypeError
        `rate` is neither a finite number nor a function of one number.

    Examples
    --------
    >>> import coadjoint as co
    >>> drag = co.forces.Friction(lambda l: 0.1 if l <= 3 else 0.0)
    >>> co.systems.sphere_euler(N=8).with_forces(drag).labels
    ('Friction',)
    """

    rate: float | Callable[[Any], Any]
    layer: str | int = "vorticity"

    example: ClassVar = {"rate": 0.2}

    def __post_init__(self) -> None:
        if callable(self.rate):
            check_arguments(self.rate, "rate of Friction", "scale")
        else:
            self._read(rate=read_number)
        self._read(layer=read_layer)

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        rate, scales = self.rate, modes.scales(d, numbers)
        if not callable(rate):
            return np.full(scales.shape, rate)
        values = {s: read_number(rate(s), f"rate of Friction at {s:g}") for s in np.unique(scales).tolist()}
        return np.array([values[s] for s in scales.tolist()])


MAX_POWER = 32


@suggest_keywords
@dataclass(frozen=True)
class Viscosity(ModeRates):
    """Viscosity or hyperviscosity of a fluid of matrices: ``W' = -nu A^power W`` with ``A = -Laplacian``.

    On the torus A is ``|n|^2`` on the mode n. On the sphere it is l(l + 1) - 2 on the degree l, the divergence of the
    rate of strain: a solid rotation has no strain and does not decay, so the angular momentum is preserved. With
    ``rotation=True``, and for a carried field (diffusion, resistivity), it is l(l + 1), and solid rotations decay. The
    flow is exact in every mode, for any rate. In quasi-geostrophic flows W is the potential vorticity without its
    planetary and topographic terms.

    Parameters
    ----------
    nu : float
        Viscosity, not negative (length^2/time for ``power=1``); the unit of length is the radius of the sphere, or the
        side of the torus over 2 pi.
    power : int
        1 for viscosity, 2 to 32 for hyperviscosity.
    rotation : bool
        On the sphere: whether solid rotations decay as well.
    layer : {"vorticity", "carried"} or int
        As for `Friction`; the number of a layer of a `layered_qg` is viscosity on its relative vorticity.

    Raises
    ------
    ValueError, TypeError
        An argument has the wrong type or is out of range.

    References
    ----------
    D. G. Ebin, J. Marsden, "Groups of diffeomorphisms and the motion of an incompressible fluid", Ann. Math. 92 (1970)
    102; A. D. Gilbert, X. Riedinger, J. Thuburn, "Note on the form of the viscous term for two dimensional
    Navier-Stokes flows", Q. J. Mech. Appl. Math. 67 (2014) 205.

    Examples
    --------
    A field of the degree 2 decays by exp(-4 nu t):

    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.sphere_euler(N=6)
    >>> z = np.arange(6) - 2.5
    >>> W0 = 1j * np.diag(z**2 - np.mean(z**2))
    >>> sol = co.integrate(
    ...     s.with_forces(co.forces.Viscosity(0.01)), W0, t_span=(0, 10), step=0.5, method=co.IsospectralGauss()
    ... )
    >>> bool(np.abs(sol.x[-1] - np.exp(-0.4) * W0).max() < 1e-14)
    True
    """

    nu: float
    power: int = 1
    rotation: bool = False
    layer: str | int = "vorticity"

    example: ClassVar = {"nu": 0.02}

    def __post_init__(self) -> None:
        power = partial(read_integer, minimum=1, maximum=MAX_POWER)
        self._read(nu=read_nonnegative, power=power, rotation=read_bool, layer=read_layer)

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        offset = 2.0 if modes.kind == "HARMONICS" and not self.rotation and self.layer != "carried" else 0.0
        with np.errstate(over="ignore"):  # modes of infinite rate become zero
            return np.asarray(self.nu * (modes.eigenvalues(d, numbers) - offset) ** self.power)


@suggest_keywords
@dataclass(frozen=True)
class BetaPlane(ModeRates):
    """The beta term of a fluid on the torus, ``omega' = ... - beta d psi/dx``: Rossby waves with the exact dispersion.

    The mode n rotates by ``w_n' = i beta n1/|n|^2 w_n``: a wave, exp(i (n1 x - n2 y - sigma t)), has the frequency
    ``sigma = -beta n1/|n|^2``, for `torus_qg` with ``|n|^2 + gamma`` in place of ``|n|^2``, and travels to the west for
    a positive beta, with x eastward and y northward. In a `layered_qg` it acts on all layers: each vertical mode has
    waves of its own, with its eigenvalue of the coupling in place of gamma. Energy and enstrophy, of layers their sum
    by thicknesses, are preserved. The term is that of the
    continuous fluid: it derives from no Hamiltonian of the matrix model, breaks its bracket, and changes the other
    Casimirs, tr W^3 and so on. On the sphere the rotation of the frame has this effect within the model:
    ``sphere_euler(rotation=...)``.

    Parameters
    ----------
    beta : float
        Gradient of the Coriolis parameter (1/(length time)), of either sign.

    Raises
    ------
    ValueError, TypeError
        `beta` is not a finite number.

    References
    ----------
    P. B. Rhines, "Waves and turbulence on a beta-plane", J. Fluid Mech. 69 (1975) 417.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = co.systems.torus_euler(N=7)
    >>> moving = s.with_forces(co.forces.BetaPlane(2.0))
    >>> sol = co.integrate(
    ...     moving, s.from_modes({(1, 2): 1.0}), t_span=(0, 3), step=0.25, method=co.IsospectralGauss()
    ... )
    >>> bool(abs(s.modes(sol.x[-1])[1, 2] - np.exp(2j * 3 / 5)) < 1e-14)
    True
    """

    beta: float

    example: ClassVar = {"beta": 0.5}
    layer = "vorticity"

    def __post_init__(self) -> None:
        self._read(beta=read_number)

    def check(self, system: Any) -> None:
        if modes_of(system, self.label).kind != Waves.kind:
            raise ValueError(
                f"BetaPlane acts on a fluid on the torus, and {system.name} is one on the sphere; take "
                "sphere_euler(rotation=...)"
            )

    def _selected_modes(self, system: Any, modes: ModeBasis) -> tuple[list[Numbers], PerMode, list[LayerChange]]:
        if not system.independent_layers:
            return super()._selected_modes(system, modes)
        # Each vertical mode of a wave turns by itself, so that a wave is listed once for each.
        stream: LayeredStream = system.stream
        numbers = [modes.numbers(d) for d in range(modes.diagonals)]
        numbers = [k[self.beta * representatives(modes.N)[k] != 0.0] for k in numbers]
        rates = [
            np.concatenate([self.rates(replace(modes, stream=one), d, k) for one in stream.of_modes])
            for d, k in enumerate(numbers)
        ]
        changes = [
            LayerChange(k, j, [np.repeat(stream.to_layers[k] * stream.to_modes[:, j], len(one)) for one in numbers])
            for k in range(len(stream.weights))
            for j in range(len(stream.weights))
        ]
        return [np.tile(one, len(stream.weights)) for one in numbers], rates, changes

    def preserves_energy(self, system: Any) -> bool:
        """Whether the energy is preserved: the phases of modes turn, and it depends on their sizes."""
        return True

    def rates(self, modes: ModeBasis, d: int, numbers: Numbers) -> NDArray[Any]:
        return 1j * self.beta * representatives(modes.N)[numbers] * modes.stream.on_modes(modes, d, numbers)


def _read_band(value: Any, what: str) -> Any:
    band = read_finite(value, what)
    if band.shape != (2,) or not 0.0 < band[0] <= band[1]:
        raise ValueError(f"{what} is {short(value)}; give the lowest and the highest degree")
    return as_tuples(band)


@suggest_keywords
@dataclass(frozen=True)
class RandomForcing(Force):
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
    layer : {"vorticity", "carried"} or int
        The field on which it acts, "vorticity" if the state is one matrix; of a `layered_qg` the number of the layer,
        from 0.

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
    layer: str | int = "vorticity"

    example: ClassVar = {"energy_rate": 0.1, "band": (1, 2), "seed": 3}
    reversible: ClassVar[bool] = False
    random: ClassVar[bool] = True
    selectors: ClassVar[tuple[str, ...]] = ("band",)

    def __post_init__(self) -> None:
        self._read(energy_rate=read_nonnegative, band=_read_band, seed=read_seed, stream=read_seed, layer=read_layer)

    def check(self, system: Any) -> None:
        self._selected_modes(system, modes_of(system, self.label))

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        raise TypeError("RandomForcing is a noise, which has no field; it feeds energy in at energy_rate")

    def _selected_modes(self, system: Any, modes: ModeBasis) -> tuple[list[Numbers], PerMode]:
        """Return the numbers of the modes in the band, and their amplitudes, by diagonal."""
        # On the main diagonal only waves with n1 > 0 are included; the others are their conjugates.
        numbers: list[Numbers] = []
        energies: PerMode = []
        index = layer_index(system, self.layer)
        stream = system.stream if self.layer != "carried" else system.second_stream
        if system.independent_layers:
            stream = stream.of_layer(index)
        if stream is None or stream is system.buoyancy:
            raise ValueError(f"the carried field of {system.name} has no energy; force the vorticity instead")
        waves, components = modes.kind == Waves.kind, 0
        for d in range(modes.diagonals):
            candidates = modes.numbers(d)
            if waves and d == 0:
                candidates = candidates[: modes.N // 2]
            scales = modes.scales(d, candidates)
            numbers.append(candidates[(self.band[0] <= scales) & (scales <= self.band[1])])
            energies.append(system.energy_factor * stream.on_modes(modes, d, numbers[d]))
            components += (2 if d or waves else 1) * len(numbers[d])
        if not components:
            raise ValueError(f"band of RandomForcing is {self.band}; {system.name} has no {modes.scale} in it")
        if not all(np.all(energy > 0.0) for energy in energies):
            raise ValueError(f"the energy of {system.name} is not positive in the band {self.band} of RandomForcing")
        # energy |c|^2 / 2 for each part: real, and imaginary if there are two
        return numbers, [np.sqrt(2.0 * self.energy_rate / components / energy) for energy in energies]

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        self._check_forward(tau)
        modes = modes_of(system, self.label)
        numbers, amplitudes = self._selected_modes(system, modes)
        deviates = normal_deviates(self.seed, self.stream, float(t), 0, 2 * sum(map(len, numbers)))
        noise = noise_matrix(modes, numbers, amplitudes, deviates, float(tau))
        return np.asarray(x + layer_vector(system, self.layer, noise))

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64]:
        return np.array(1.0)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        modes = modes_of(system, self.label)
        return reader.mode_noise(
            modes, *self._selected_modes(system, modes), self.seed, self.stream, layer_index(system, self.layer)
        )
