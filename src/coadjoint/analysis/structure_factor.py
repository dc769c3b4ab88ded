"""Dynamic structure factors of spins on lattices and crystals, from runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coadjoint.analysis.signals import sampled
from coadjoint.analysis.standard_errors import student_factor
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.declared_spins import cells_text
from coadjoint.systems.lattices.geometry import CELLS, cell_coordinates, has_cell, reciprocal_edges, sizes_of
from coadjoint.systems.lattices.space_groups import inverse
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_finite, read_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

MIN_TIMES = 8  # of a transform with a window
NUMBERS_AT_ONCE = 2**22  # spins times times that are copied together

COMMENSURATE = 1e-9  # distance from a whole number of waves, in waves
MAX_WAVES = 2**40  # whole numbers of waves up to here are exact in float64


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class StructureFactor:
    """The dynamic structure factor of spins along a path in reciprocal space; `structure_factor` computes it.

    Attributes
    ----------
    q : ndarray, shape (k, axes)
        Wave vectors, in units of the reciprocal edges of the cell: (h, k, l) of crystals.
    omega : ndarray, shape (m,)
        Angular frequencies, ascending, positive and negative.
    intensity : ndarray, shape (k, m)
        S(q, omega), summed over the three components of the spins, mean of the members.
    error : ndarray, shape (k, m)
        Its standard error, from the scatter of the members with Student's factor: two errors hold 95 of 100 values of
        several waves, 90 of a single one, whose intensity is distributed exponentially. NaN for a single run.
    components : ndarray, shape (3, k, m)
        The same for each component.
    static : ndarray, shape (k,)
        Equal-time structure factor S(q) of the same states, the mean over times (weighted by the square of the window)
        and members.
    distance : ndarray, shape (k,)
        Length of the path from its start, in the inverse unit of length of a crystal (1/angstrom for units of meV), and
        in units of the inverse distance between neighbours for lattices by name. It has the factor 2 pi.
    corners : ndarray of int, shape (corners,)
        Indices of the corners of the path.
    """

    q: Floats
    omega: Floats
    intensity: Floats
    error: Floats
    components: Floats
    static: Floats
    distance: Floats
    corners: NDArray[np.int64]

    def __repr__(self) -> str:
        return (
            f"<structure factor of {len(self.q)} wave vectors and {len(self.omega)} frequencies up to "
            f"{self.omega[-1]:.4g}>"
        )

    def plot(self) -> Figure:
        """Plot S(q, omega) as colours over the path and positive frequencies.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.
        """
        figure: Figure = shortcut("draw_result")("structure factor", self)
        return figure


@suggest_keywords
@long_operation("structure_factor")
def structure_factor(solution: Solution, path: ArrayLike | None = None, window: Any = "hann") -> StructureFactor:
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
    path : (corners, axes) array_like, optional
        Corners of a path in reciprocal space, in units of the reciprocal edges of the cell: (h, k, l) of a crystal, in
        the cell of ``model.crystal``. h times the cells of its axis must be a whole number, as k and l; S is computed
        at all such wave vectors on the lines between the corners. Crystals need a path. For chains by name numbers
        suffice, and None is the usual path of lattices by name: the first zone of chains; Gamma, X, M, Gamma of square
        ones, Gamma, M, K, Gamma of triangular, honeycomb and kagome ones; Gamma, X, M, R, Gamma of cubic ones.
    window : str, tuple or None
        Window over the time by its name in `scipy.signal.get_window`, with its parameters: ``("kaiser", 8.0)``; None is
        none, as is ``"boxcar"``.

    Returns
    -------
    StructureFactor

    Raises
    ------
    ValueError
        The system has no lattice in space, the members have different ones, a crystal has no path, the times are not
        equidistant, a corner does not fit the lattice, a member failed, or the window is unknown.
    TypeError
        Not a solution.

    Notes
    -----
    ``S_a(q, omega) = dt / (2 pi N sum w^2) |sum over i and t of w(t) S_a,i(t) exp(i (omega t - q . r_i))|^2``, N spins:
    a wave with positive omega travels along q. The sum over all frequencies times their distance is the equal-time
    structure factor ``|sum over i of S_a,i exp(-i q . r_i)|^2 / N``, exactly. Sites of cells with several are at their
    positions, so that S is not periodic in q there. Spins of a model on a crystal are S times their directions, without
    g and form factors, and of SU(N) they are their expectations; N does not count vacancies. Spins of `spin_lattice`
    are the state, whatever their moments.

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
    """
    check_solution(solution)
    lattice = _lattice(solution)
    signal = sampled(solution, _directions_in(solution.system), MIN_TIMES)
    members, count, n = signal.values.shape
    q, distance, corners = reciprocal_path(lattice, path)
    k = len(q)
    weight = _window(window, count)
    spacing = float(signal.t[-1] - signal.t[0]) / (count - 1)
    scale = abs(spacing) / (2.0 * np.pi * (n // 3) * np.sum(weight**2))
    system = None
    mean, square, static = np.zeros((3, k, count)), np.zeros((k, count)), np.zeros(k)
    for member, rows in enumerate(signal.values):
        if system is not solution.system.of_member(member):
            system = solution.system.of_member(member)
            waves = _waves(system.unforced, lattice, q)
        amplitudes = _amplitudes(rows if spacing > 0.0 else rows[::-1], waves)
        static += np.sum(np.abs(amplitudes) ** 2 * weight**2, axis=(0, 2)) / (n // 3 * np.sum(weight**2) * members)
        # ifft has the sign of exp(+i omega t), and divides by the number of times.
        power = scale * np.abs(count * np.fft.ifft(amplitudes * weight, axis=2)) ** 2
        total = power.sum(axis=0)
        # Welford's update.
        before = mean.sum(axis=0)
        mean += (power - mean) / (member + 1)
        square += (total - before) * (total - mean.sum(axis=0))
        note_progress("the spectrum of a member", (member + 1) / members)
    with np.errstate(invalid="ignore"):
        error = np.sqrt(square / (members - 1) / members) if members > 1 else np.full_like(square, np.nan)
        error *= student_factor(members - 1)
    order = np.argsort(np.fft.fftfreq(count), kind="stable")
    omega = 2.0 * np.pi * np.fft.fftfreq(count, abs(spacing))[order]
    spectrum = mean[:, :, order]
    return StructureFactor(q, omega, spectrum.sum(axis=0), error[:, order], spectrum, static, distance, corners)


class Lattice(NamedTuple):
    """Text for errors, cells along the axes, sites of a cell and reciprocal edges, and the usual path, if any."""

    text: str
    sizes: tuple[int, ...]
    sites: Floats  # in units of the edges
    reciprocal: Floats
    path: Any


def lattice_by_name(name: str, shape: Any) -> Lattice:
    """Return a lattice of `CELLS`."""
    sizes = sizes_of(shape)
    sites = cell_coordinates(name, (1,) * len(sizes))
    return Lattice(f"{name}, {cells_text(sizes)} cells", sizes, sites, reciprocal_edges(name), CELLS[name].path)


def _lattice(solution: Solution) -> Lattice:
    """Return the lattice that the members of a run have in common; ValueError if there is none."""
    first, *others = (_lattice_of(member.unforced) for member in solution.system.distinct)
    for other in others:
        if other.sizes != first.sizes or not all(map(np.array_equal, first[2:4], other[2:4])):
            raise ValueError(
                f"the members have different lattices ({first.text}, and {other.text}); integrate those of one lattice"
            )
    return first


def _lattice_of(system: Any) -> Lattice:
    if isinstance(system, SpinModel):
        crystal, text = system.crystal, f"{system.crystal!r}, {cells_text(system.size)} cells"
        return Lattice(text, system.size, crystal.positions, 2.0 * np.pi * inverse(crystal.lattice).T, None)
    name = system.layout.get("lattice")
    if not has_cell(name):
        raise ValueError(
            f"{system.name} has no lattice in space; structure_factor needs a model of co.systems.spins (which "
            f"co.load takes as system=, since archives have no crystals), or one of {', '.join(CELLS)}, as "
            "spin_lattice and layout= give"
        )
    shape, axes = system.layout.get("shape"), len(CELLS[name].edges)
    if shape is None or len(sizes_of(shape)) != axes:
        raise ValueError(f"the shape in layout of {system.name} is {short(shape)}; {name} has cells along {axes} axes")
    lattice = lattice_by_name(name, shape)
    sites = len(lattice.sites) * math.prod(lattice.sizes)
    if 3 * sites != system.dim:
        raise ValueError(f"the lattice of {system.name} has {sites} sites, and its states {system.dim} coordinates")
    return lattice


def _directions_in(system: Any) -> Callable[[Any], Floats] | None:
    """Return the function of states whose values are dipoles over S; None if states are directions of spins."""
    model = system.distinct[0].unforced
    if not isinstance(model, CoherentSpinModel):
        return None

    def directions(x: Any) -> Floats:
        found = model.dipoles(x) / model.spin[:, None]
        return np.asarray(found.reshape(*found.shape[:-2], -1))

    return directions


def _waves(system: Any, lattice: Lattice, q: Floats) -> Floats:
    """Return the lengths of the spins times cosines and negative sines of q . r, (sites, 2 k)."""
    lengths: Any = 1.0
    if isinstance(system, SpinModel):
        places, lengths = system.cells + lattice.sites[system.sites], system.spin
    else:
        places = cell_coordinates(system.layout["lattice"], lattice.sizes)
    phase = 2.0 * np.pi * (q @ places.T)
    return np.ascontiguousarray((lengths * np.concatenate([np.cos(phase), -np.sin(phase)])).T)


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


def _amplitudes(rows: Floats, waves: Floats) -> NDArray[np.complex128]:
    """Return the sums of spins (times, 3 sites) times `waves` as complex numbers, shape (3, k, times)."""
    count, n = rows.shape
    k = waves.shape[1] // 2
    result = np.empty((3, k, count), dtype=np.complex128)
    every = max(1, NUMBERS_AT_ONCE // n)
    for first in range(0, count, every):
        part = slice(first, first + every)
        for axis in range(3):
            sums = np.ascontiguousarray(rows[part, axis::3]) @ waves
            result[axis, :, part] = (sums[:, :k] + 1j * sums[:, k:]).T
    return result


def reciprocal_path(lattice: Lattice, path: Any) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return commensurate wave vectors (k, axes) in reciprocal edges, distances (k,), and indices of corners."""
    sizes = np.array(lattice.sizes)
    given = lattice.path if path is None else path
    if given is None:
        raise ValueError(
            f"path is None, and {lattice.text}, have no usual path; give the corners (h, k, l) of one in reciprocal "
            "lattice units, such as [(0, 0, 0), (1, 0, 0)]"
        )
    corners = read_finite(given, "path")
    if len(sizes) == 1 and corners.ndim == 1:
        corners = corners[:, None]
    if corners.ndim != 2 or corners.shape[1] != len(sizes) or not len(corners):
        raise ValueError(
            f"path has shape {corners.shape}; give corners (corners, {len(sizes)}) in units of the reciprocal edges"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        waves = corners * sizes
    whole = np.rint(waves)
    with np.errstate(over="ignore", invalid="ignore"):
        fits = np.abs(waves - whole) <= COMMENSURATE * np.maximum(1.0, np.abs(waves))
    off = np.argwhere(~(fits & (np.abs(waves) < MAX_WAVES)))
    if off.size:
        corner = corners[off[0, 0]].tolist()
        subject = "the usual path" if path is None else "path"
        raise ValueError(
            f"{subject} has the corner {short(tuple(corner))}, which does not fit {lattice.text}: q times the cells of "
            "an axis must be a whole number; give path=, or take other numbers of cells"
        )
    points = [whole[:1].astype(np.int64)]
    for start, end in zip(whole[:-1].astype(np.int64), whole[1:].astype(np.int64), strict=True):
        count = math.gcd(*(end - start).tolist())
        points.append(start + np.arange(1, count + 1)[:, None] * ((end - start) // max(count, 1)))
    q = np.concatenate(points) / sizes
    steps = np.linalg.norm(np.diff(q, axis=0) @ lattice.reciprocal, axis=1)
    ends = np.cumsum([len(part) for part in points]) - 1
    return q, np.concatenate([[0.0], np.cumsum(steps)]), np.unique(ends)
