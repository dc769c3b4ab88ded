"""Dynamic structure factors of spins on lattices and crystals, from runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.neutrons import (
    Neutrons,
    check_neutrons,
    intensity,
    measured_waves,
    quantum_factor,
    scattering_lengths,
    values_at,
)
from coadjoint.analysis.signals import sampled
from coadjoint.analysis.standard_errors import student_factor
from coadjoint.analysis.wave_vectors import (
    Lattice,
    commensurate_waves,
    common_lattice,
    existing_components,
    fitting,
    numbers_of_sites,
    places_of,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.validation import read_list, read_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

MIN_TIMES = 8  # of a transform with a window
NUMBERS_AT_ONCE = 2**22  # spins times times that are copied together
LEAST_WIDTH = 1e-12  # of a resolution, relative to the largest energy
FWHM = 2.0 * np.sqrt(2.0 * np.log(2.0))  # full width at half maximum of a Gaussian, in standard deviations


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class StructureFactor:
    """The dynamic structure factor of spins in reciprocal space; `structure_factor` computes it.

    Attributes
    ----------
    q : ndarray, shape (k, axes)
        Wave vectors, in units of the reciprocal edges of the cell: (h, k, l) of crystals. Of a powder the middle
        lengths of the shells, (k, 1).
    omega : ndarray, shape (m,)
        Angular frequencies, ascending; of runs positive and negative.
    intensity : ndarray, shape (k, m)
        S(q, omega), summed over the three components of the spins or over the operators of `structure_factor`, mean of
        the members; or what neutrons measure.
    error : ndarray, shape (k, m)
        Its standard error, from the scatter of the members with Student's factor: two errors hold 95 of 100 values of
        several waves, 90 of a single one, whose intensity is distributed exponentially. NaN for a single run, and of
        modes.
    components : ndarray, shape (3 or operators, k, m)
        The same for each component or operator, without the polarization factor.
    static : ndarray, shape (k,)
        Equal-time structure factor S(q) of the same states, the mean over times (weighted by the square of the window)
        and members. Of modes the sum of their intensities.
    distance : ndarray, shape (k,)
        Length of the path from its start, in the inverse unit of length of a crystal (1/angstrom for units of meV), and
        in units of the inverse distance between neighbours for lattices by name. It has the factor 2 pi. Of a plane the
        distance from its origin, of a powder the length of q.
    corners : ndarray of int, shape (corners,)
        Indices of the corners of the path or the plane.
    shape : tuple of int
        ``(k,)``, or (first, second) wave vectors of the grid of a plane.
    hbar : float
        Energy of a unit of `omega`: 0.658 meV ps for units of meV, else 1.
    """

    q: Floats
    omega: Floats
    intensity: Floats
    error: Floats
    components: Floats
    static: Floats
    distance: Floats
    corners: NDArray[np.int64]
    shape: tuple[int, ...]
    hbar: float

    def __repr__(self) -> str:
        return (
            f"<structure factor of {len(self.q)} wave vectors and {len(self.omega)} frequencies up to "
            f"{self.omega[-1]:.4g}>"
        )

    @property
    def energies(self) -> Floats:
        """Energies hbar omega, in the unit of the model, (m,)."""
        return self.hbar * self.omega

    @property
    def density(self) -> Floats:
        """Intensity for each unit of energy, as 1/meV, (k, m); its sum times the distance of energies is `static`."""
        return self.intensity / self.hbar

    def broadened(self, fwhm: float | Callable[[Any], Any]) -> StructureFactor:
        """Return the structure factor with the energy resolution of an instrument.

        Parameters
        ----------
        fwhm : float or callable
            Full width at half maximum of a Gaussian, an energy, in the unit of the model; or a function of an array of
            energy transfers that returns those widths.

        Returns
        -------
        StructureFactor
            The intensity of each frequency is distributed over all with the width there, and sums over frequencies stay
            as they are. Errors are those of independent frequencies.

        Raises
        ------
        ValueError, TypeError
            Widths that are not positive, or of another number.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> ring = co.systems.spin_lattice("ring", 8, field=(0, 0, 1.0))
        >>> sol = co.integrate(ring, np.tile([0.6, 0, 0.8], 8), (0, 40), 0.05, save_every=5)
        >>> S = co.spectra.structure_factor(sol, [0, 1 / 2])
        >>> broad = S.broadened(lambda energy: 0.2 + 0.1 * abs(energy))
        >>> bool(broad.intensity.max() < S.intensity.max()), bool(np.isclose(broad.intensity.sum(), S.intensity.sum()))
        (True, True)
        """
        kernel, _ = resolution(self.energies, self.energies, fwhm)
        kernel /= kernel.sum(axis=0)
        with np.errstate(invalid="ignore"):
            error = np.sqrt(self.error**2 @ (kernel**2).T)
        spectrum, components = self.intensity @ kernel.T, self.components @ kernel.T
        return replace(self, intensity=spectrum, error=error, components=components)

    def integrated(self, low: float, high: float) -> Floats:
        """Return the intensity between two energies, such as of a cut or a map at constant energy.

        Parameters
        ----------
        low, high : float
            Energy transfers, in the unit of the model.

        Returns
        -------
        ndarray, shape (k,)
            The integral over omega. A frequency counts with the part of the distance between frequencies that is
            inside.

        Raises
        ------
        ValueError, TypeError
            Energies that do not ascend, or beyond the largest, which the distance of the saved times limits.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> ring = co.systems.spin_lattice("ring", 8, field=(0, 0, 1.0))
        >>> sol = co.integrate(ring, np.tile([0.6, 0, 0.8], 8), (0, 40), 0.05, save_every=5)
        >>> S = co.spectra.structure_factor(sol, [0, 1 / 2])
        >>> bool(S.integrated(0.5, 1.5)[0] > 0.9 * S.integrated(0.5, 4)[0])
        True
        """
        first, last = _read_energies(self.energies, (low, high))
        width = float(self.omega[1] - self.omega[0])
        edges = np.array([first, last]) / self.hbar
        inside = np.clip(self.omega + 0.5 * width, *edges) - np.clip(self.omega - 0.5 * width, *edges)
        return np.asarray(self.intensity @ inside)

    def plot(self, energies: Any = None, modes: Any = None) -> Figure:
        """Plot S(q, omega) as colours, over a path and energies, or over a plane.

        Parameters
        ----------
        energies : (float, float), optional
            The energies shown; of a plane those over which it is integrated. By default positive ones, on a path those
            up to the largest that is visible.
        modes : LinearModes, optional
            Modes of the same path, drawn as lines.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.

        Raises
        ------
        ValueError, TypeError
            Energies beyond those of S; modes of another path or of a powder.
        """
        window = None if energies is None else _read_energies(self.energies, energies)
        figure: Figure = shortcut("draw_result")("structure factor", self, window, modes)
        return figure


def _read_energies(energies: Floats, given: Any) -> tuple[float, float]:
    """Validate a range of energies, within those of a structure factor."""
    pair = read_list(given, "energies", "give (low, high)")
    if len(pair) != 2:
        raise ValueError(f"energies is {short(given)}; give (low, high)")
    low, high = (read_number(value, "energies") for value in pair)
    lowest, largest = energies[[0, -1]].tolist()
    if not low < high:
        raise ValueError(f"energies is {short((low, high))}; give the lower one first")
    slack = 1e-9 * max(abs(lowest), largest)
    if high > largest + slack or low < lowest - slack:
        raise ValueError(
            f"energies is {short((low, high))}, and S has those from {lowest:.6g} to {largest:.6g}; for larger ones, "
            "save more times of the run"
        )
    return low, high


def resolution(energies: Floats, centres: Floats, fwhm: Any) -> tuple[Floats, Floats]:
    """Return Gaussians with the maximum 1 (energies, centres), and their standard deviations."""
    if callable(fwhm):
        given = values_at(fwhm, centres, "fwhm")
    else:
        given = np.full(centres.shape, read_number(fwhm, "fwhm"))
    least = LEAST_WIDTH * float(max(np.abs(energies).max(), np.abs(centres).max()))
    wrong = np.flatnonzero(~((given > 0.0) & (given >= least)))
    if wrong.size:
        raise ValueError(
            f"fwhm is {given[wrong[0]]:g} at the energy {centres[wrong[0]]:g}; widths are positive, of at least "
            f"{least:.1g}"
        )
    sigma = given / FWHM
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.exp(-0.5 * ((energies[:, None] - centres) / sigma) ** 2)), sigma


@suggest_keywords
@long_operation("structure_factor")
def structure_factor(
    solution: Solution,
    path: Any = None,
    window: Any = "hann",
    neutrons: Neutrons | None = None,
    operators: Any = None,
) -> StructureFactor:
    """Return the dynamic structure factor S(q, omega) of spins from a run, the mean over its members.

    Choose it for spin-wave spectra, linewidths and comparisons with neutron scattering. Start the members from
    `co.thermal_states`, and integrate without a heat bath, which would broaden the lines.

    Parameters
    ----------
    solution : Solution
        A run of a model on a crystal (`spins`) or of a lattice by name (`spin_lattice`), with at least 8 equidistant
        times. The largest frequency is pi over their distance; faster motion is aliased. The models of members may
        differ in couplings, vacancies and substituted ions, not in the crystal and its size. An archive of a model is
        read with it: ``co.load(path, system=model)``.
    path : (corners, axes) array_like, Plane or Powder, optional
        Corners of a path in reciprocal space, in units of the reciprocal edges of the cell: (h, k, l) of a crystal, in
        the cell of ``model.crystal``. h times the cells of its axis must be a whole number, as k and l; S is computed
        at all such wave vectors on the lines between the corners. Crystals need a path. For chains by name numbers
        suffice, and None is the usual path of lattices by name: the first zone of chains; Gamma, X, M, Gamma of square
        ones, Gamma, M, K, Gamma of triangular, honeycomb and kagome ones; Gamma, X, M, R, Gamma of cubic ones. A
        `Plane` has all wave vectors of a parallelogram, and a `Powder` means over shells. Notes have those of twists.
    window : str, tuple or None
        Window over the time by its name in `scipy.signal.get_window`, with its parameters: ``("kaiser", 8.0)``; None is
        none, as is ``"boxcar"``.
    neutrons : Neutrons, optional
        Form factors, polarization factor, temperature and domains, of models on crystals.
    operators : (operators, N, N) array_like, complex or real, optional
        Hermitian matrices in the basis of `co.spins.operators`, for models of ``mode="SU(N)"``: their expectations at
        all sites take the place of the components of the spins. Choose them for quadrupoles and other multipoles, whose
        lines neutrons do not see, such as ``[Sx @ Sy + Sy @ Sx]``. Units are those of the operators.

    Returns
    -------
    StructureFactor

    Raises
    ------
    ValueError
        The system has no lattice in space, the members have different ones, a crystal has no path, the times are not
        equidistant, a corner does not fit the lattice, a shell is empty, a member failed, or the window is unknown.
        Operators of models of dipoles, together with `neutrons`, not Hermitian or of another shape.
    TypeError
        Not a solution, or not `Neutrons`.

    Notes
    -----
    ``S_a(q, omega) = dt / (2 pi N sum w^2) |sum over i and t of w(t) S_a,i(t) exp(i (omega t - q . r_i))|^2``, N spins:
    a wave with positive omega travels along q. The sum over all frequencies times their distance is the equal-time
    structure factor ``|sum over i of S_a,i exp(-i q . r_i)|^2 / N``, exactly. Sites of cells with several are at their
    positions, so that S is not periodic in q there. Spins of a model on a crystal are S times their directions, without
    g and form factors unless `neutrons` are given, and of SU(N) they are dipoles <S>; N does not count vacancies. Spins
    of `spin_lattice` are the state, whatever their moments. An operator A has ``<A>_i`` in place of ``S_a,i``.

    Spins of a lattice with a twist, S(n + size) = R S(n), have three sets of wave vectors: components along the axis
    those above, S+ = S_1 + i S_2 across it those plus ``k = twist / (2 pi size)``, and S- those minus k. A path or a
    plane is in one of these sets, and S has the components that exist there, in the frame of the lattice: with [k, k +
    1/2] the waves of S+. A periodic lattice of M times the cells has M times this S, and zero elsewhere.

    Examples
    --------
    Spin waves of a cold chain, omega = 2 (1 - cos q):

    >>> import numpy as np
    >>> import coadjoint as co
    >>> ring = co.systems.spin_lattice("ring", 16)
    >>> states = co.thermal_states(ring, 0.001, members=4, seed=1)
    >>> sol = co.integrate(ring, states.x, (0, 100), 0.02, save_every=25)
    >>> S = co.spectra.structure_factor(sol, path=[1 / 8, 1 / 2])
    >>> peaks = abs(S.omega[S.intensity.argmax(axis=1)])
    >>> bool(abs(peaks - 2 * (1 - np.cos(2 * np.pi * S.q[:, 0]))).max() < 0.1)
    True

    Quadrupoles of an easy-axis ferromagnet of S = 1, which go from m = 1 to m = -1 at omega = 4 abs(J):

    >>> Sx, Sy, Sz = co.spins.operators(1)
    >>> chain = co.spins.crystal(lattice=(2, 2, 1, 90, 90, 90), sites={"Ni": (0, 0, 0)})
    >>> model = co.systems.spins(chain, (1, 1, 4), spin=1, periodic=(False, False, True), mode="SU(N)")
    >>> model = model.exchange(chain.bonds(1)["1"], -0.5)
    >>> model = model.single_ion("Ni", -3 * Sz @ Sz)
    >>> x0 = model.from_amplitudes([[1, 0, 0.02], [1, 0, 0.01], [1, 0, 0], [1, 0, 0]])
    >>> sol = co.integrate(model, x0, (0, 100), 0.1, save_every=5)
    >>> S = co.spectra.structure_factor(sol, [(0, 0, 0), (0, 0, 1 / 2)], operators=[Sx @ Sy + Sy @ Sx])
    >>> bool(np.all(abs(abs(S.omega[S.intensity.argmax(axis=1)]) - 2.0) < 0.1))
    True
    """
    check_solution(solution)
    lattice = common_lattice(solution.system)
    first = solution.system.distinct[0].unforced
    check_neutrons(neutrons, first, lattice)
    coefficients = _coefficients(operators, neutrons, first, lattice)
    signal = sampled(solution, None, MIN_TIMES)
    members, count, _ = signal.values.shape
    waves = measured_waves(neutrons, commensurate_waves(lattice, path), lattice, first)
    images = fitting(lattice, waves.images, "path, turned by a domain,")
    k = len(waves.q)
    weight = _window(window, count)
    spacing = float(signal.t[-1] - signal.t[0]) / (count - 1)
    squares = float(np.sum(weight**2))
    spins = len(places_of(first, lattice))
    scale = abs(spacing) / (2.0 * np.pi * spins * squares)
    every = max(1, NUMBERS_AT_ONCE // count)
    parts = [slice(start, start + every) for start in range(0, len(images), every)]
    size = (len(coefficients) + 1, k, count)
    mean, square, static = np.zeros(size), np.zeros((k, count)), np.zeros((k, 1))
    for member, rows in enumerate(signal.values):
        system = solution.system.of_member(member).unforced
        power = np.zeros(size)
        for part in parts:
            cartesian = images[part] @ lattice.reciprocal
            forward = rows if spacing > 0.0 else rows[::-1]
            amplitudes = _amplitudes(forward, system, lattice, images[part], neutrons, coefficients)
            amplitudes = existing_components(lattice, images[part], amplitudes)
            equal = np.sum(intensity(neutrons, amplitudes, cartesian) * weight**2, axis=1, keepdims=True)
            waves.add_means(static, part, equal / (spins * squares * members))
            # ifft has the sign of exp(+i omega t), and divides by the number of times.
            spectrum = count * np.fft.ifft(amplitudes * weight, axis=2)
            each = np.concatenate([np.abs(spectrum) ** 2, intensity(neutrons, spectrum, cartesian)[None]])
            waves.add_means(power, part, scale * each)
        # Welford's update.
        before = mean[-1].copy()
        mean += (power - mean) / (member + 1)
        square += (power[-1] - before) * (power[-1] - mean[-1])
        note_progress("the spectrum of a member", (member + 1) / members)
    with np.errstate(invalid="ignore"):
        error = np.sqrt(square / (members - 1) / members) if members > 1 else np.full_like(square, np.nan)
        error *= student_factor(members - 1)
    order = np.argsort(np.fft.fftfreq(count), kind="stable")
    omega = 2.0 * np.pi * np.fft.fftfreq(count, abs(spacing))[order]
    factor = np.ones(count)
    if neutrons is not None and neutrons.temperature is not None:
        factor = quantum_factor(lattice.hbar * omega, first.boltzmann * neutrons.temperature)
    mean = mean[:, :, order] * factor
    return StructureFactor(
        waves.q,
        omega,
        mean[-1],
        error[:, order] * factor,
        mean[:-1],
        static[:, 0],
        waves.distance,
        waves.corners,
        waves.shape,
        lattice.hbar,
    )


def _window(window: Any, count: int) -> Floats:
    if window is None:
        return np.ones(count)
    from scipy.signal import get_window

    name, *parameters = window if isinstance(window, tuple) and window else (window,)
    refusal = ValueError(f"window is {short(window)}; give a name of scipy.signal.get_window, or (name, parameter)")
    if not isinstance(name, str):
        raise refusal
    given: Any = (name, *(read_number(parameter, "a parameter of window") for parameter in parameters))
    try:
        with np.errstate(all="ignore"):
            weight = np.asarray(get_window(given, count), dtype=np.float64)
    except (ValueError, TypeError) as reason:
        raise refusal from reason
    if not (np.all(np.isfinite(weight)) and np.sum(weight**2) > 0.0):
        raise ValueError(f"window is {short(window)}, which cannot be computed at {count} times; give another one")
    return weight


def _coefficients(operators: Any, neutrons: Neutrons | None, system: Any, lattice: Lattice) -> Floats:
    """Return constants and the coefficients of the coordinates of a site: of its first three, or of operators."""
    if operators is None:
        return np.eye(3, 1 + system.dim // len(places_of(system, lattice)), k=1)
    if not isinstance(system, CoherentSpinModel):
        raise ValueError(
            f"operators is given for {system.name}, whose sites have no states of N levels; leave it out, or take a "
            'model of co.systems.spins(..., mode="SU(N)")'
        )
    if neutrons is not None:
        raise ValueError("operators and neutrons are both given, and neutrons see dipoles only; give one of them")
    given = read_list(operators, "operators", "give a list of Hermitian matrices (N, N)")
    if not given:
        raise ValueError("operators is empty; give at least one Hermitian matrix (N, N)")
    return np.array([system._coefficients(matrix, f"operators[{number}]") for number, matrix in enumerate(given)])


def _amplitudes(
    rows: Floats, system: Any, lattice: Lattice, q: Floats, neutrons: Neutrons | None, coefficients: Floats
) -> NDArray[np.complex128]:
    """Return sums over the sites of states (times, n) with exp(-i q . r), shape (components, k, times), by FFT."""
    cells, sites = numbers_of_sites(system, lattice)
    lengths = scattering_lengths(neutrons, system, np.linalg.norm(q @ lattice.reciprocal, axis=1))
    lengths = np.atleast_2d(lengths)
    lengths = np.broadcast_to(lengths, (len(lengths), len(sites)))
    by_spin = lengths[0] if len(lengths) == 1 else np.ones(len(sites))
    sizes, (count, n) = np.array(lattice.sizes), rows.shape
    waves = np.rint(q * sizes)
    shifts, group = np.unique(np.round(q * sizes - waves, 9), axis=0, return_inverse=True)  # those of a twist
    indices, axes = tuple((waves % sizes).astype(np.int64).T), tuple(range(1, 1 + len(sizes)))
    result = np.zeros((len(coefficients), len(q), count), dtype=np.complex128)
    every = max(1, NUMBERS_AT_ONCE // n)
    for kind, first in zip(*np.unique(sites, return_index=True), strict=True):
        own = np.flatnonzero(sites == kind)
        places = tuple(cells[own].T)
        factors = np.exp(-2j * np.pi * (q @ lattice.sites[kind])) * (1.0 if len(lengths) == 1 else lengths[:, first])
        for begin, (component, (constant, *linear)) in product(range(0, count, every), enumerate(coefficients)):
            part = slice(begin, begin + every)
            values = rows[part].reshape(-1, len(sites), n // len(sites))[:, own] @ np.array(linear)
            values = (constant + values) * by_spin[own]
            for number, shift in enumerate(shifts):
                grid = np.zeros((len(values), *lattice.sizes), dtype=np.complex128 if shift.any() else np.float64)
                turn = np.exp(-2j * np.pi * (cells[own] @ (shift / sizes))) if shift.any() else 1.0
                grid[(slice(None), *places)] = values * turn
                chosen = np.flatnonzero(group.ravel() == number)
                found = np.fft.fftn(grid, axes=axes)[(slice(None), *(index[chosen] for index in indices))]
                result[component, chosen, part] += (found * factors[chosen]).T
    return result
