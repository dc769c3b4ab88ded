"""Small motions about equilibria of spins on crystals by wave vector: linear spin waves."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.equilibrium import DEFECTIVE, GROWTH, RANK_TOLERANCE
from coadjoint.analysis.neutrons import Neutrons, check_neutrons, intensity, measured_waves, scattering_lengths
from coadjoint.analysis.structure_factor import StructureFactor, resolution
from coadjoint.analysis.wave_vectors import COMMENSURATE, Lattice, fitting, lattice_of, spaced_waves
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.systems.lattices.twists import Twist
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import read_finite, read_integer

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Complex = NDArray[Any]  # of complex numbers

MAX_POINTS = 100_000
RESIDUAL = 1e-10  # largest rate of change of an equilibrium, relative to its terms
ALIKE = 1e-6  # difference of the states of translated cells, relative to the largest coordinate
SEMIDEFINITE = 1e-9  # negative eigenvalues of second variations down to this, relative to the largest, are zero
SINGULAR = 1e-11  # the same of positive ones, which are raised to this: modes of frequency zero are resolved to 1e-5
NO_FREQUENCY = 4.0  # frequencies below this are zero, in units of what raised eigenvalues give to a soft mode
DIVERGENT = 1e4  # norm of a mode over that of an undisturbed one, above which its intensity is infinite
INVISIBLE = 1e-9  # part of the amplitude of such a mode that neutrons do not see
UNEVEN = 1e-6  # difference of the distances of energies, relative to them
DEGENERATE = 1e-9  # difference of frequencies, relative to the largest


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class LinearModes:
    """Frequencies and intensities of the small motions about an equilibrium; `linear_modes` computes them.

    Attributes
    ----------
    q : ndarray, shape (k, axes)
        Wave vectors (h, k, l) in reciprocal lattice units of the crystal. Of a powder the lengths of q, (k, 1).
    frequencies : ndarray, shape (k, modes)
        Angular frequencies of the modes that travel along q, ascending; two times `spins_in_cell` divided by 2 for
        dipoles, times the domains or directions, and times three of a spiral by twisted boundaries. A negative one
        belongs to a mode that lowers the energy, about an equilibrium that is no minimum.
    growth : ndarray, shape (k, modes)
        Rates at which modes grow; zero if none does, to round-off.
    intensity : ndarray, shape (k, modes)
        Integrals over omega of the peaks of S(q, omega) of a spin, at positive omega and zero temperature (or that of
        `Neutrons`). Infinite for modes of frequency zero that cost no energy, and NaN for those that grow.
    components : ndarray, shape (3, k, modes)
        The same for each component, without the polarization factor.
    distance, corners, shape
        As those of `StructureFactor`.
    spins_in_cell : int
        Number of spins of the magnetic cell, the smallest with which the state repeats.
    hbar : float
        Energy of a unit of the frequencies.
    """

    q: Floats
    frequencies: Floats
    growth: Floats
    intensity: Floats
    components: Floats
    distance: Floats
    corners: Integers
    shape: tuple[int, ...]
    spins_in_cell: int
    hbar: float

    def __repr__(self) -> str:
        text = (
            f"<{self.frequencies.shape[1]} modes at {len(self.q)} wave vectors, {self.spins_in_cell} spins in a "
            f"magnetic cell, frequencies from {self.frequencies.min():.4g} to {self.frequencies.max():.4g}"
        )
        if self.stable:
            return f"{text}>"
        worst = int(self.growth.max(axis=1).argmax())
        return f"{text}; unstable, growth {self.growth.max():.4g} at q = {short(self.q[worst].tolist())}>"

    @property
    def energies(self) -> Floats:
        """Energies hbar omega in the unit of the model, (k, modes)."""
        return self.hbar * self.frequencies

    @property
    def stable(self) -> bool:
        """Whether no mode grows."""
        return not np.any(self.growth)

    def spectrum(self, energies: ArrayLike, fwhm: Any) -> StructureFactor:
        """Return S(q, omega) of the modes, broadened by a resolution.

        Choose it for pictures beside those of runs and experiments, and for powders.

        Parameters
        ----------
        energies : (m,) array_like
            Ascending, equidistant energies, in the unit of the model.
        fwhm : float or callable
            Full width at half maximum of a Gaussian, as for `StructureFactor.broadened`.

        Returns
        -------
        StructureFactor
            Modes whose intensity is infinite or NaN are left out.

        Raises
        ------
        ValueError, TypeError
            Energies that are not equidistant, or widths that are not positive.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)})
        >>> model = co.systems.spins(chain, (4, 1, 1)).exchange(chain.bonds(1)["1"], -1.0).field((0, 0, 0.2))
        >>> modes = co.spectra.linear_modes(model, [0, 0, 1] * 4, [(0, 0, 0), (1, 0, 0)])
        >>> S = modes.spectrum(np.linspace(-1, 6, 701), fwhm=0.1)
        >>> bool(np.allclose(S.intensity.sum(axis=1) * 0.01, S.static, rtol=1e-3))
        True
        """
        grid = read_finite(energies, "energies")
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.diff(np.atleast_1d(grid))
            even = grid.ndim == 1 < len(grid) and np.all(np.abs(steps - steps[0]) <= UNEVEN * steps[0])
        if not (even and steps[0] > 0.0):
            raise ValueError(f"energies is {short(energies)}; give two or more ascending, equidistant energies")
        finite = np.isfinite(self.intensity)
        weights = np.where(finite, self.intensity, 0.0)
        each = np.where(finite & np.isfinite(self.components), self.components, 0.0)
        spectrum, components = np.empty((len(self.q), len(grid))), np.empty((3, len(self.q), len(grid)))
        for k, centres in enumerate(self.energies):
            gaussians, sigma = resolution(grid, centres, fwhm)
            with np.errstate(over="ignore", under="ignore"):
                kernel = gaussians * (self.hbar / (np.sqrt(2.0 * np.pi) * sigma))
            spectrum[k], components[:, k] = kernel @ weights[k], each[:, k] @ kernel.T
        unknown, static = np.full_like(spectrum, np.nan), weights.sum(axis=1)
        places = self.distance, self.corners, self.shape
        return StructureFactor(self.q, grid / self.hbar, spectrum, unknown, components, static, *places, self.hbar)

    def plot(self) -> Figure:
        """Plot the energies over the path, with dots whose area is the intensity.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved. ``StructureFactor.plot(modes=...)`` draws modes over a spectrum.

        Raises
        ------
        ValueError
            Modes of a plane.
        """
        figure: Figure = shortcut("draw_result")("linear modes", self)
        return figure


class SitesOfSpins(NamedTuple):
    """Where the coordinates of a system on a crystal are, and what its spins are in terms of them."""

    cells: Integers  # (sites, 3)
    sites: Integers  # (sites,), numbers in the cell
    size: tuple[int, ...]
    periodic: tuple[bool, ...]
    bonds: Integers  # (bonds, 5), two sites of the cell and the offset
    spins: Floats  # (sites, 3, coordinates): components of the spins, of unit scattering length
    kinds: Floats  # (sites, k), numbers in which sites of equal ions agree
    lattice: Lattice
    frames: Floats | None = None  # (sites, 3, 3), rotations of the frames of a spiral


class Spiral(NamedTuple):
    """Frames that turn about an axis, with a wave vector in reciprocal edges, in which a twisted lattice repeats."""

    axis: Floats
    wave: Floats

    def frames(self, places: SitesOfSpins) -> Floats:
        """Return the rotations of the frames of the sites."""
        positions = places.cells + places.lattice.sites[places.sites]
        angles = 2.0 * np.pi * (positions @ self.wave)
        along, turn, back = self._parts()
        phases = np.exp(1j * angles)[:, None, None]
        return np.asarray((along + phases * turn + phases.conj() * back).real)

    def _parts(self) -> Complex:
        """Return the parts of a rotation by an angle that have the phases 0, the angle, and its negative."""
        u = self.axis
        cross = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
        across = np.eye(3) - np.outer(u, u)
        return np.array([np.outer(u, u) + 0j, 0.5 * (across - 1j * cross), 0.5 * (across + 1j * cross)])

    def in_frame(self, images: Floats) -> Floats:
        """Return the wave vectors in the frames of what scatters at given ones: along the axis, and twice across."""
        return np.concatenate([images, images - self.wave, images + self.wave])

    def in_space(
        self, frequencies: Floats, growth: Floats, amplitudes: Complex, reference: Floats
    ) -> tuple[Floats, Floats, Complex, Floats]:
        """Return the modes at wave vectors from those of `in_frame`, ascending, with their amplitudes in space."""
        k, modes = len(frequencies) // 3, frequencies.shape[1]
        turned = np.einsum("pab,bpkm->apkm", self._parts(), amplitudes.reshape(3, 3, k, modes))
        order = np.argsort(_beside(frequencies, k), axis=-1, kind="stable")
        return (
            np.take_along_axis(_beside(frequencies, k), order, -1),
            np.take_along_axis(_beside(growth, k), order, -1),
            np.take_along_axis(_beside(turned, k), order[None], -1),
            np.take_along_axis(_beside(reference, k), order, -1),
        )


def _beside(values: Complex, k: int) -> Complex:
    """Return (..., 3 k, modes) or (..., 3, k, modes) as (..., k, 3 modes)."""
    leading = values.shape[: values.ndim - 2] if values.shape[-2] == 3 * k else values.shape[:-3]
    return np.moveaxis(values.reshape(*leading, 3, k, -1), -3, -2).reshape(*leading, k, -1)


class QuadraticForm(NamedTuple):
    """The second variation of the energy at an equilibrium, in blocks (b, r, r) of pairs of tangent spaces."""

    first: Integers  # (b,), number of the spin in the magnetic cell
    second: Integers
    steps: Floats  # (b, 3), between the positions of the two spins, in cells
    blocks: Floats
    poisson: Floats  # (spins, r, r), the Poisson matrices of the tangent spaces
    tangents: Floats  # (spins, d, r), their bases
    spins: Integers  # (spins,), numbers of the spins of the magnetic cell
    translations: int
    whole: bool  # whether the steps hold only modulo the size of the lattice

    def at(self, q: Floats) -> Complex:
        """Return the Hermitian matrix at a wave vector."""
        spins, _, r = self.tangents.shape
        K = np.zeros((spins, spins, r, r), dtype=np.complex128)
        phases = np.exp(2j * np.pi * (self.steps @ q))
        np.add.at(K, (self.first, self.second), phases[:, None, None] * self.blocks)
        matrix = K.transpose(0, 2, 1, 3).reshape(spins * r, spins * r)
        return np.asarray(0.5 * (matrix + matrix.conj().T))


@suggest_keywords
@ignore_overflow
@long_operation("linear_modes")
def linear_modes(
    system: SpinModel, state: ArrayLike, path: Any, points: int = 100, neutrons: Neutrons | None = None
) -> LinearModes:
    """Return frequencies and intensities of small motions about an equilibrium, along a path of wave vectors.

    Choose it for dispersions and intensities of spin waves, for the stability of a magnetic order against all wave
    vectors, and beside the spectrum of a run, whose lines are these modes at low temperature. Wave vectors are not
    bound to the cells of the model, which needs to hold the magnetic cell, and as many cells as its bonds need.
    Spirals of any period have ``twist=``: in frames that turn with the spiral their cell repeats, and at q neutrons see
    the modes of these frames at q, along the axis, and at q minus and plus the wave vector of the spiral, across it.

    Parameters
    ----------
    system : SpinModel
        A model on a crystal, without forces, with a field that does not depend on time; at most a few thousand
        coordinates.
    state : (n,) array_like
        An equilibrium, such as ``co.equilibrium(system, x0).x``. The magnetic cell is found from it.
    path : (corners, axes) array_like, Plane or Powder
        Corners in reciprocal lattice units (h, k, l) of the crystal, or as for `structure_factor`. Models with dipoles
        need wave vectors that fit the cells of the model.
    points : int
        Steps along the whole path; of a plane along each edge; directions of a powder, for each shell.
    neutrons : Neutrons, optional
        Form factors, polarization factor, temperature and domains.

    Returns
    -------
    LinearModes

    Raises
    ------
    ValueError
        The state is no equilibrium, or has a spin of length zero; wave vectors of another shape, or that do not fit the
        cells of a model with dipoles; boundaries that are twisted by half turns.
    TypeError
        The system is no model on a crystal, has forces, or depends on time.

    Notes
    -----
    The motion linearized on the orbits, ``y' = P K(q) y`` with the Poisson matrices P of the sites and the second
    variation K of the energy, has modes ``y exp(i (q . r - omega t))``, ``i P K y = omega y``. Where K is positive they
    come from its Cholesky factor (Colpa), else from eigenvalues; where it is singular, frequencies below about 1e-5 of
    the largest are zero. A mode with action hbar, which is that of one boson,
    gives ``hbar / N |sum over sites of S_a|^2`` with ``y* (i P)^-1 y = 1``: the intensity of linear spin wave theory of
    spins S at zero temperature. The classical S of a run at the temperature T has ``k_B T / (hbar omega)`` times it, at
    omega and at -omega.

    References
    ----------
    J. H. P. Colpa, Diagonalization of the quadratic boson Hamiltonian, Physica A 93, 327 (1978); S. Toth, B. Lake,
    J. Phys.: Condens. Matter 27, 166002 (2015).

    Examples
    --------
    A ferromagnetic chain, hbar omega = 2 S J (1 - cos q), whose spin waves all have the intensity S:

    >>> import numpy as np
    >>> import coadjoint as co
    >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)})
    >>> model = co.systems.spins(chain, (4, 1, 1), spin=3 / 2).exchange(chain.bonds(1)["1"], -1.0)
    >>> modes = co.spectra.linear_modes(model, [0, 0, 1] * 4, [(0, 0, 0), (1, 0, 0)])
    >>> bool(np.allclose(modes.frequencies[:, 0], 3 * (1 - np.cos(2 * np.pi * modes.q[:, 0]))))
    True
    >>> modes, bool(np.allclose(modes.intensity, 3 / 2))
    (<1 modes at 101 wave vectors, 1 spins in a magnetic cell, frequencies from 0 to 6>, True)
    """
    check_one_system(system)
    if not isinstance(system, SpinModel):
        raise TypeError(f"system is {short(system)}; linear_modes needs a model on a crystal, of co.systems.spins")
    if system.hamiltonian.timed:
        raise TypeError(f"the field of {short(system)} depends on time, so that it has no equilibria")
    lattice = lattice_of(system)
    check_neutrons(neutrons, system, lattice)
    momenta, single = momenta_of(system, state)
    if not single:
        raise ValueError(f"state has the shape {np.shape(state)}; {short(system)} needs ({system.dim},)")
    waves = spaced_waves(lattice, path, read_integer(points, "points", 1, MAX_POINTS))
    waves = measured_waves(neutrons, waves, lattice, system)
    declared = system._declared
    joined = [*(one.bonds for one in declared.couplings), *(one.bonds for one in declared.biquadratics)]
    bonds = np.concatenate([np.zeros((0, 5), dtype=np.int64), *joined])
    count = len(system.sites)
    axes = np.broadcast_to(np.eye(3, system.dim // count), (count, 3, system.dim // count))
    kinds = np.stack([system.spin, system.moments], axis=1)
    places = SitesOfSpins(system.cells, system.sites, system.size, system.periodic, bonds, axes, kinds, lattice)
    spiral = None
    if declared.twist is not None:
        spiral = _spiral_of(declared.twist, places, momenta[0].reshape(count, 3))
        places = places if spiral is None else places._replace(frames=spiral.frames(places))
    form = second_variation(system, places, momenta[0])
    images = waves.images
    if form.whole:
        images = fitting(lattice, images, "path of a model with dipoles or other couplings without a bond")
    lengths = np.linalg.norm(images @ lattice.reciprocal, axis=1)
    scattering = np.atleast_2d(scattering_lengths(neutrons, system, lengths))
    moving = images if spiral is None else spiral.in_frame(images)
    frequencies, growth, amplitudes, reference = modes_at(form, places, moving, scattering)
    if spiral is not None:
        frequencies, growth, amplitudes, reference = spiral.in_space(frequencies, growth, amplitudes, reference)
    total = intensity(neutrons, amplitudes, images @ lattice.reciprocal)
    each = np.abs(amplitudes) ** 2
    total, each = (
        np.where(reference > 0.0, np.where(part > INVISIBLE * reference, np.inf, 0.0), part) for part in (total, each)
    )
    if neutrons is not None and neutrons.temperature is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            bosons = -1.0 / np.expm1(-lattice.hbar * frequencies / (system.boltzmann * neutrons.temperature))
            bosons = np.where(frequencies < 0.0, np.nan, np.abs(bosons))
            total, each = (np.where(part == 0.0, 0.0, part * bosons) for part in (total, each))
    k = len(waves.q)
    of_each = len(images) // k  # domains, or directions
    return LinearModes(
        waves.q,
        frequencies.reshape(k, -1),
        growth.reshape(k, -1),
        total.reshape(k, -1) / of_each,
        each.reshape(3, k, -1) / of_each,
        waves.distance,
        waves.corners,
        waves.shape,
        len(form.spins),
        lattice.hbar,
    )


def _spiral_of(twist: Twist, places: SitesOfSpins, spins: Floats) -> Spiral | None:
    """Return the spiral that a state follows most, of those with a twist; None for twists by whole turns."""
    turns = np.array(twist.angles) / (2.0 * np.pi)
    halves = np.abs(2.0 * turns - np.round(2.0 * turns))
    if np.all(halves < COMMENSURATE):
        if np.all(np.abs(turns - np.round(turns)) < COMMENSURATE):
            return None
        raise ValueError(
            f"twist is {twist.angles}, half turns, whose waves at q plus and minus that of the spiral are one; give a "
            "lattice of whole periods, without a twist"
        )
    u = np.array(twist.axis)
    first = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
    first /= np.linalg.norm(first)
    across = spins @ (first + 1j * np.cross(u, first))
    field = np.zeros((int(places.sites.max()) + 1, *places.size), dtype=np.complex128)
    field[(places.sites, *places.cells.T)] = across * np.exp(-2j * np.pi * (places.cells @ (turns / places.size)))
    closed = [1 + axis for axis, flag in enumerate(places.periodic) if flag]
    weights = np.sum(np.abs(np.fft.fftn(field, axes=closed)) ** 2, axis=(0, *({1, 2, 3} - {*closed})), keepdims=True)[0]
    largest = np.flatnonzero(weights.ravel() >= weights.max() * (1.0 - COMMENSURATE))[0]
    return Spiral(u, (turns + np.unravel_index(largest, weights.shape)) / places.size)


def second_variation(system: Any, places: SitesOfSpins, x: Floats) -> QuadraticForm:
    """Return the second variation of the energy of spins on a product of equal algebras, by pairs of spins."""
    # Along the orbit, K = U^T H U + (U^T P U)^-1 U^T D U in an orthonormal basis U of the tangent space of each spin,
    # with the Hessian H, the Poisson matrix P of the state, and D, that of the gradient.
    count = len(places.sites)
    d = system.dim // count
    check_available_memory(24 * system.dim**2, f"the second derivatives of {short(system)}")
    hessian = np.asarray(system.hamiltonian.hessian(x, 0.0), dtype=np.float64)
    gradient = np.asarray(system.hamiltonian.gradient(x, 0.0), dtype=np.float64)
    P, D = _blocks_of_sites(system, x, gradient, count)
    _check_equilibrium(system, P, gradient, np.abs(gradient) + np.abs(hessian) @ np.abs(x))
    blocks = hessian.reshape(count, d, count, d)
    if places.frames is not None:
        R, back = places.frames, places.frames.swapaxes(1, 2)
        x, gradient = (np.einsum("sab,sb->sa", back, one.reshape(count, d)).ravel() for one in (x, gradient))
        P, D, blocks = back @ P @ R, back @ D @ R, np.einsum("iab,ibjc,jcd->iajd", back, blocks, R, optimize=True)
    numbers, spins, translations = _magnetic_cell(places, x, P, gradient)
    left, sizes, _ = np.linalg.svd(P[spins])
    ranks = np.sum(sizes > RANK_TOLERANCE * sizes.max(), axis=1)
    if np.ptp(ranks) or not ranks[0]:
        spin = int(spins[ranks.argmin()])
        raise ValueError(f"state has the spin {spin} on an orbit of lower dimension; give spins that are not zero")
    U = left[:, :, : ranks[0]]
    Ut = U.swapaxes(1, 2)
    poisson = Ut @ P[spins] @ U
    own = np.linalg.solve(poisson, Ut @ D[spins] @ U)
    first, second, steps, found = [np.arange(len(spins))], [np.arange(len(spins))], [np.zeros((len(spins), 3))], [own]
    offsets, whole = _offsets(places), False
    positions = places.lattice.sites[places.sites]
    for a, spin in enumerate(spins.tolist()):
        others = np.flatnonzero(np.any(blocks[spin] != 0.0, axis=(0, 2)))
        cells, known = _cell_steps(places, offsets, spin, others)
        whole |= not known
        first.append(np.full(len(others), a))
        second.append(numbers[others])
        steps.append(cells + positions[others] - positions[spin])
        found.append(Ut[a] @ blocks[spin].swapaxes(0, 1)[others] @ U[numbers[others]])
    ends = np.concatenate(first), np.concatenate(second)
    return QuadraticForm(*ends, np.concatenate(steps), np.concatenate(found), poisson, U, spins, translations, whole)


def modes_at(
    form: QuadraticForm, places: SitesOfSpins, images: Floats, scattering: Floats
) -> tuple[Floats, Floats, Complex, Floats]:
    """Return frequencies and growth (k, modes), amplitudes (3, k, modes), and sizes of those that diverge, else 0."""
    spins, _, r = form.tangents.shape
    G = np.zeros((spins * r, spins * r), dtype=np.complex128)
    for a in range(spins):
        G[a * r : (a + 1) * r, a * r : (a + 1) * r] = 1j * form.poisson[a]
    inverse: Complex = np.linalg.inv(G)
    components = np.einsum("sad,sdr->asr", places.spins[form.spins], form.tangents).reshape(3, -1)
    undisturbed = 1.0 / np.linalg.norm(inverse, 2)
    scale = np.sqrt(places.lattice.hbar * form.translations / len(places.sites))
    shape = (len(images), spins * r // 2)
    frequencies, growth, reference = np.empty(shape), np.empty(shape), np.zeros(shape)
    amplitudes = np.empty((3, *shape), dtype=np.complex128)
    for k, q in enumerate(images):
        frequencies[k], growth[k], modes = _normal_modes(form.at(q), G, inverse)
        weights = scale * components * np.repeat(scattering[k % len(scattering), form.spins], r)
        amplitudes[:, k] = weights @ modes
        squares = np.sum(np.abs(modes) ** 2, axis=0)
        diverges = (frequencies[k] == 0.0) & (squares > DIVERGENT * undisturbed)
        reference[k] = np.where(diverges, np.linalg.norm(weights) ** 2 * squares, 0.0)
        note_progress("the modes of a wave vector", (k + 1) / len(images))
    return frequencies, growth, amplitudes, reference


def _normal_modes(K: Complex, G: Complex, inverse: Complex) -> tuple[Floats, Floats, Complex]:
    """Return frequencies, growth and vectors y of the modes of G K with y* G^-1 y = 1, half as many as rows."""
    values = np.linalg.eigvalsh(K)
    size = float(np.max(np.abs(values), initial=0.0))
    for sign in (1.0, -1.0):
        lowest = float(np.min(sign * values))
        if lowest < -SEMIDEFINITE * size:
            continue
        shift = max(0.0, SINGULAR * size - lowest) if size else 1.0
        soft = NO_FREQUENCY * np.sqrt(shift * (size or 1.0)) * float(np.linalg.norm(G, 2))
        L = np.linalg.cholesky(sign * K + shift * np.eye(len(K)))
        found, z = np.linalg.eigh(L.conj().T @ G @ L)
        positive = slice(len(K) // 2, None)
        y = np.linalg.solve(L.conj().T, z[:, positive])
        y /= np.sqrt(np.abs(np.sum(y.conj() * (inverse @ y), axis=0)))
        omega = sign * found[positive]
        omega = np.where(np.abs(omega) <= soft, 0.0, omega)
        order = np.argsort(omega, kind="stable")
        return omega[order], np.zeros(len(omega)), y[:, order]
    return _indefinite_modes(G @ K, inverse)


def _indefinite_modes(matrix: Complex, inverse: Complex) -> tuple[Floats, Floats, Complex]:
    """Return the same of a second variation of both signs, by eigenvalues; vectors of growing modes are NaN."""
    values, y = np.linalg.eig(matrix)
    largest = float(np.abs(values).max())
    growing = np.abs(values.imag) > max(GROWTH * largest, DEFECTIVE * float(np.linalg.norm(matrix)))
    order = np.lexsort((values.real, growing))
    values, y, growing = values[order], y[:, order], growing[order]
    norms = np.where(values.imag > 0.0, np.inf, -np.inf)
    calm = int(np.sum(~growing))
    apart = np.flatnonzero(np.diff(values[:calm].real) > DEGENERATE * largest) + 1
    for first, last in itertools.pairwise([0, *apart.tolist(), calm] if calm else []):
        within = slice(first, last)
        norms[within], turn = np.linalg.eigh(y[:, within].conj().T @ inverse @ y[:, within])
        y[:, within] = y[:, within] @ turn
    kept = np.sort(np.argsort(-norms, kind="stable")[: len(values) // 2])
    kept = kept[np.argsort(values[kept].real, kind="stable")]
    with np.errstate(invalid="ignore", divide="ignore"):
        y = np.where(growing[kept], np.nan, y[:, kept] / np.sqrt(np.abs(norms[kept])))
    kept_values, grows = values[kept], growing[kept]
    still = grows & (np.abs(kept_values.real) <= GROWTH * largest)
    return np.where(still, 0.0, kept_values.real), np.where(grows, np.abs(kept_values.imag), 0.0), y


def _blocks_of_sites(system: Any, x: Floats, gradient: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the blocks (sites, d, d) of P and of D, with P v = sign J(x) v and D v = sign J(v) gradient."""
    d, sign = system.dim // count, float(system.sign)
    i, j, k, c = system.algebra.triples
    site = i // d
    if np.any(site != j // d) or np.any(site != k // d):
        raise TypeError(f"the algebra of {short(system)} is no product of one for each site")
    P, D = np.zeros((2, count, d, d))
    constants = sign * c.astype(np.float64)
    np.add.at(P, (site, i % d, j % d), constants * x[k])
    np.add.at(D, (site, i % d, k % d), constants * gradient[j])
    np.add.at(D, (site, j % d, k % d), -constants * gradient[i])
    return P - P.swapaxes(1, 2), D


def _check_equilibrium(system: Any, P: Floats, gradient: Floats, terms: Floats) -> None:
    """Raise ValueError for a state that moves."""
    rates = np.abs(np.einsum("sab,sb->sa", P, gradient.reshape(len(P), -1))).max(axis=1)
    size = float(np.abs(P).sum(axis=2).max() * terms.max(initial=0.0))
    worst = int(rates.argmax())
    if rates[worst] > RESIDUAL * size:
        raise ValueError(
            f"state is no equilibrium of {short(system)}: spin {worst} moves at the rate {rates[worst]:.3g}, "
            f"{rates[worst] / size:.1e} of its terms; give co.equilibrium(system, state).x"
        )


def _magnetic_cell(places: SitesOfSpins, x: Floats, P: Floats, gradient: Floats) -> tuple[Integers, Integers, int]:
    """Return the number of each spin in the magnetic cell, the spins of this cell, and how often it repeats."""
    # Bonds repeat with the cells of the crystal; states, fields, vacancies and substituted ions may not.
    count = len(places.sites)
    numbers = np.full((*places.size, int(places.sites.max()) + 1), -1)
    numbers[(*places.cells.T, places.sites)] = np.arange(count)
    compared = [part.reshape(count, -1) for part in (x, P, gradient, places.kinds)]
    slack = [ALIKE * float(np.abs(part).max()) for part in compared]

    def moved(step: Any) -> Integers:
        return np.asarray(numbers[(*((places.cells + step) % places.size).T, places.sites)])

    def repeats(image: Integers) -> bool:
        return not np.any(image < 0) and all(
            np.abs(part[image] - part).max() <= most for part, most in zip(compared, slack, strict=True)
        )

    group = {(0, 0, 0)}
    spans = [range(size if closed else 1) for size, closed in zip(places.size, places.periodic, strict=True)]
    for step in itertools.product(*spans):
        if step in group or not repeats(moved(step)):
            continue
        multiples = [np.array((0, 0, 0))]
        while (latest := tuple(((multiples[-1] + step) % places.size).tolist())) not in group:
            multiples.append(np.array(latest))
        group = {tuple(((np.array(one) + m) % places.size).tolist()) for one in group for m in multiples}
    root = np.arange(count)
    for step in group:
        root = np.minimum(root, moved(step))
    spins, own = np.unique(root, return_inverse=True)
    return own, spins, len(group)


def _offsets(places: SitesOfSpins) -> dict[tuple[int, ...], tuple[int, ...]]:
    """Return the offset of each bond by its sites and its offset in the periodic lattice."""
    found = {}
    for i, j, *n in places.bonds.tolist():
        for first, second, sign in ((i, j, 1), (j, i, -1)):
            offset = tuple(sign * m for m in n)
            found[first, second, *_wrapped(places, offset)] = offset
    return found


def _wrapped(places: SitesOfSpins, offset: Any) -> tuple[int, ...]:
    return tuple(
        n % size if closed else n for n, size, closed in zip(offset, places.size, places.periodic, strict=True)
    )


def _cell_steps(
    places: SitesOfSpins, offsets: dict[tuple[int, ...], tuple[int, ...]], spin: int, others: Integers
) -> tuple[Integers, bool]:
    """Return the cells from a spin to others along bonds, and whether bonds join all of them."""
    steps, known, site = places.cells[others] - places.cells[spin], True, int(places.sites[spin])
    for row, (other, n) in enumerate(zip(places.sites[others].tolist(), steps.tolist(), strict=True)):
        offset = offsets.get((site, other, *_wrapped(places, n)))
        if offset is not None:
            steps[row] = offset
        elif others[row] != spin:
            known = known and not any(places.periodic)
    return steps, known
