"""Wave vectors of spectra: paths, planes and shells in reciprocal space, and what is averaged at each."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.declared_spins import UNITS, cells_text
from coadjoint.systems.lattices.geometry import CELLS, cell_coordinates, has_cell, reciprocal_edges, sizes_of
from coadjoint.systems.lattices.space_groups import inverse
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.systems.lattices.twists import Twist
from coadjoint.validation import as_tuples, read_finite, set_fields

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Complex = NDArray[np.complex128]

COMMENSURATE = 1e-9  # distance from a whole number of waves, in waves
MAX_WAVES = 2**40  # whole numbers of waves up to here are exact in float64
BYTES_PER_WAVE = 200  # peak, while wave vectors of shells are listed
ORTHOGONAL = 1e-9  # defect of the rotation of a domain


class Lattice(NamedTuple):
    """Text for errors, cells along the axes, sites of a cell, reciprocal edges, usual path, hbar, and the twist."""

    text: str
    sizes: tuple[int, ...]
    sites: Floats  # in units of the edges
    reciprocal: Floats
    path: Any = None
    hbar: float = 1.0
    twist: Twist | None = None


class WaveVectors(NamedTuple):
    """Wave vectors of a spectrum, in reciprocal edges, and those that are averaged at each of them."""

    q: Floats  # (k, axes); of shells (k, 1), lengths
    distance: Floats
    corners: Integers
    shape: tuple[int, ...]  # (k,), or that of the grid of a plane
    images: Floats  # (images, axes)
    owner: Integers  # index of the wave vector of each image, ascending

    def add_means(self, totals: Floats, part: slice, values: Floats) -> None:
        """Add the share of some images (..., part, m) in the means of their wave vectors, to totals (..., k, m)."""
        owner = self.owner[part]
        starts = np.flatnonzero(np.diff(owner, prepend=-1))
        counts = np.bincount(self.owner, minlength=len(self.q))[owner[starts]]
        totals[..., owner[starts], :] += np.add.reduceat(values, starts, axis=-2) / counts[:, None]


@suggest_keywords
@dataclass(frozen=True)
class Plane:
    """A parallelogram in reciprocal space, for `structure_factor` and `linear_modes`.

    Choose it in place of a path for maps at constant energy.

    Parameters
    ----------
    origin : (axes,) array_like
        A corner, in reciprocal lattice units (h, k, l).
    first, second : (axes,) array_like
        The two edges from there.

    Raises
    ------
    ValueError, TypeError
        Vectors of other shapes, or parallel edges.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.spectra.Plane((0, 0, 0), (1, 0, 0), (0, 1, 0))       # (h, k, 0)
    Plane(origin=(0.0, 0.0, 0.0), first=(1.0, 0.0, 0.0), second=(0.0, 1.0, 0.0))
    """

    origin: Any
    first: Any
    second: Any

    def __post_init__(self) -> None:
        vectors = [read_finite(getattr(self, name), name) for name in ("origin", "first", "second")]
        if vectors[0].ndim != 1 or any(vector.shape != vectors[0].shape for vector in vectors):
            raise ValueError(f"the vectors of Plane have shapes {[v.shape for v in vectors]}; give three (h, k, l)")
        largest = [float(np.abs(vector).max(initial=0.0)) for vector in vectors]
        edges = [vector / size if size else vector for vector, size in zip(vectors[1:], largest[1:], strict=True)]
        if np.linalg.matrix_rank(np.array(edges)) < 2:
            raise ValueError(f"first is {short(self.first)} and second {short(self.second)}; give edges of a plane")
        set_fields(self, origin=as_tuples(vectors[0]), first=as_tuples(vectors[1]), second=as_tuples(vectors[2]))


@suggest_keywords
@dataclass(frozen=True)
class Powder:
    """Shells of equal lengths of q, averages of a powder, for `structure_factor` and `linear_modes`.

    A run has the wave vectors of its cells: S is the mean of those between two edges. Modes have any, and are averaged
    over directions at the middle of each shell.

    Parameters
    ----------
    edges : (shells + 1,) array_like
        Ascending lengths of q between which the shells are, with the factor 2 pi, in the inverse unit of length of the
        crystal (1/angstrom for units of meV).

    Raises
    ------
    ValueError, TypeError
        Fewer than two edges, negative ones, or edges that do not ascend.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.spectra.Powder([0.5, 1.0, 1.5])
    Powder(edges=(0.5, 1.0, 1.5))
    """

    edges: Any

    def __post_init__(self) -> None:
        edges = read_finite(self.edges, "edges")
        if edges.ndim != 1 or len(edges) < 2 or edges[0] < 0.0 or not np.all(edges[1:] > edges[:-1]):
            raise ValueError(f"edges is {short(self.edges)}; give two or more ascending lengths of q, none negative")
        set_fields(self, edges=as_tuples(edges))


def lattice_by_name(name: str, shape: Any) -> Lattice:
    """Return a lattice of `CELLS`."""
    sizes = sizes_of(shape)
    sites = cell_coordinates(name, (1,) * len(sizes))
    return Lattice(f"{name}, {cells_text(sizes)} cells", sizes, sites, reciprocal_edges(name), CELLS[name].path)


def lattice_of(system: Any) -> Lattice:
    """Return the lattice of a model on a crystal or of a lattice by name; ValueError if it has none in space."""
    if isinstance(system, SpinModel):
        crystal, units = system.crystal, UNITS[system.units]
        edges = 2.0 * np.pi * inverse(crystal.lattice).T
        twist = system._declared.twist
        turned = "" if twist is None else f" with the twist {twist.angles} about {twist.axis}"
        text = f"{crystal!r}, {cells_text(system.size)} cells{turned}"
        return Lattice(text, system.size, crystal.positions, edges, hbar=units.hbar, twist=twist)
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


def common_lattice(system: Any) -> Lattice:
    """Return the lattice that the members of a system have in common; ValueError if there is none."""
    first, *others = (lattice_of(member.unforced) for member in system.distinct)
    for other in others:
        if (other.sizes, other.twist) != (first.sizes, first.twist) or not all(
            map(np.array_equal, first[2:4], other[2:4])
        ):
            raise ValueError(
                f"the members have different lattices ({first.text}, and {other.text}); integrate those of one lattice"
            )
    return first


def places_of(system: Any, lattice: Lattice) -> Floats:
    """Return the positions of the spins in units of the edges of the cell, (sites, axes)."""
    if isinstance(system, SpinModel):
        return np.asarray(system.cells + lattice.sites[system.sites])
    return cell_coordinates(system.layout["lattice"], lattice.sizes)


def numbers_of_sites(system: Any, lattice: Lattice) -> tuple[Integers, Integers]:
    """Return the cells of all spins, (spins, axes), and the numbers of their sites in the cell."""
    if isinstance(system, SpinModel):
        return system.cells, system.sites
    cells, sites = np.divmod(np.arange(len(places_of(system, lattice))), len(lattice.sites))
    return np.stack(np.unravel_index(cells, lattice.sizes), axis=-1), sites


def commensurate_waves(lattice: Lattice, where: Any) -> WaveVectors:
    """Return the wave vectors of a path, a plane or shells that fit the cells of a lattice."""
    sizes = np.array(lattice.sizes)
    if isinstance(where, Powder):
        return _shells(lattice, where)
    if isinstance(where, Plane):
        vectors = _read_corners(lattice, [where.origin, where.first, where.second], "plane")
        shift = _shifts(lattice, vectors[:1])[0]
        whole = _whole(lattice, np.concatenate([vectors[:1] - shift, vectors[1:]]), "plane")
        counts = [math.gcd(*edge.tolist()) for edge in whole[1:]]
        steps = [edge // count for edge, count in zip(whole[1:], counts, strict=True)]
        return _grid(lattice, whole[0] / sizes + shift, [step / sizes for step in steps], counts)
    if where is None and lattice.path is None:
        raise ValueError(
            f"path is None, and {lattice.text}, have no usual path; give the corners (h, k, l) of one in reciprocal "
            "lattice units, such as [(0, 0, 0), (1, 0, 0)]"
        )
    corners = _read_corners(lattice, lattice.path if where is None else where, "path")
    shift = _shifts(lattice, corners[:1])[0]
    whole = _whole(lattice, corners - shift, "path" if where is not None else "the usual path")
    points = [whole[:1]]
    for start, end in itertools.pairwise(whole):
        count = math.gcd(*(end - start).tolist())
        points.append(start + np.arange(1, count + 1)[:, None] * ((end - start) // max(count, 1)))
    return _on_path(lattice, [part / sizes + shift for part in points])


def spaced_waves(lattice: Lattice, where: Any, points: int) -> WaveVectors:
    """Return wave vectors of a path (`points` steps), a plane (of each edge) or shells (directions), of any values."""
    if isinstance(where, Powder | Plane):
        count = points**2 if isinstance(where, Plane) else points * len(where.edges)
        check_available_memory(BYTES_PER_WAVE * count, f"{short(count)} wave vectors")
    if isinstance(where, Powder):
        edges = np.array(where.edges)
        middle = 0.5 * (edges[1:] + edges[:-1])
        turn = np.pi * (1.0 + math.sqrt(5.0)) * (np.arange(points) + 0.5)  # the golden angle
        height = 1.0 - 2.0 * (np.arange(points) + 0.5) / points
        around = np.sqrt(1.0 - height**2)
        directions = np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1)
        images = (middle[:, None, None] * directions) @ np.linalg.inv(lattice.reciprocal)
        owner = np.repeat(np.arange(len(middle)), points)
        return _of_lengths(middle, images.reshape(-1, images.shape[-1]), owner)
    if isinstance(where, Plane):
        corner, first, second = _read_corners(lattice, [where.origin, where.first, where.second], "plane")
        return _grid(lattice, corner, [first / points, second / points], [points, points])
    corners = _read_corners(lattice, where, "path")
    lengths = np.linalg.norm(np.diff(corners, axis=0) @ lattice.reciprocal, axis=1)
    parts = [corners[:1]]
    for start, end, length in zip(corners[:-1], corners[1:], lengths.tolist(), strict=True):
        count = max(1, round(points * length / lengths.sum())) if length else 0
        parts.append(start + np.arange(1, count + 1)[:, None] * (end - start) / max(count, 1))
    return _on_path(lattice, parts)


def turned_waves(waves: WaveVectors, lattice: Lattice, rotations: Floats) -> WaveVectors:
    """Return the wave vectors with the mean over domains, turned by orthogonal matrices (domains, 3, 3)."""
    # A domain that is turned by R scatters at q as the crystal at the inverse of R times q: q R for rows q.
    turns = lattice.reciprocal @ rotations @ np.linalg.inv(lattice.reciprocal)
    images = np.einsum("ka,dab->kdb", waves.images, turns).reshape(-1, waves.images.shape[1])
    return waves._replace(images=images, owner=np.repeat(waves.owner, len(rotations)))


def fitting(lattice: Lattice, q: Floats, what: str) -> Floats:
    """Return wave vectors that fit the cells, without round-off; ValueError if one does not."""
    shifts = _shifts(lattice, q)
    return np.asarray(_whole(lattice, q - shifts, what) / np.array(lattice.sizes) + shifts)


def existing_components(lattice: Lattice, q: Floats, amplitudes: Complex) -> Complex:
    """Return amplitudes (3, k, times) without the components that a twisted lattice does not have at wave vectors."""
    if lattice.twist is None:
        return amplitudes
    u = np.array(lattice.twist.axis)
    along, cross = np.outer(u, u), np.cross(u, np.eye(3)).T
    P = np.zeros((len(q), 3, 3), dtype=np.complex128)
    P[_fits(lattice, q).all(axis=1)] = along
    for sign in (1, -1):  # S+ and S-, which the twist multiplies by exp(+-i angle)
        fits = _fits(lattice, q - sign * _twist_shift(lattice)).all(axis=1)
        P[fits] += 0.5 * (np.eye(3) - along - sign * 1j * cross)
    return np.asarray(np.einsum("kab,bkt->akt", P, amplitudes))


def _twist_shift(lattice: Lattice) -> Floats:
    """Return the wave vector by which those of S+ differ from whole numbers of waves."""
    angles = np.zeros(len(lattice.sizes)) if lattice.twist is None else np.array(lattice.twist.angles)
    return np.asarray(angles / (2.0 * np.pi * np.array(lattice.sizes)))


def _shifts(lattice: Lattice, q: Floats) -> Floats:
    """Return the shift of the wave vectors of a component of spins of which each is one; 0 if there is none."""
    shifts = np.zeros(q.shape)
    if lattice.twist is not None:
        plain = _fits(lattice, q).all(axis=1)
        for sign in (-1, 1):
            shift = sign * _twist_shift(lattice)
            shifts[_fits(lattice, q - shift).all(axis=1) & ~plain] = shift
    return shifts


def _shells(lattice: Lattice, powder: Powder) -> WaveVectors:
    edges, sizes = np.array(powder.edges), np.array(lattice.sizes)
    if lattice.twist is not None:
        raise ValueError(f"{lattice.text}, have three sets of wave vectors; Powder needs a lattice without a twist")
    if lattice.reciprocal.shape != (3, 3):
        raise ValueError(f"{lattice.text}, have no volume; Powder needs a model of co.systems.spins, a crystal")
    longest = edges[-1] * np.linalg.norm(np.linalg.inv(lattice.reciprocal), axis=0) * sizes
    check_available_memory(BYTES_PER_WAVE * float(np.prod(2.0 * longest + 1.0)), "the wave vectors of a powder")
    spans = [np.arange(-math.floor(n), math.floor(n) + 1) for n in longest.tolist()]
    images = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3) / sizes
    lengths = np.linalg.norm(images @ lattice.reciprocal, axis=1)
    shell = np.searchsorted(edges, lengths, side="right") - 1
    inside = (shell >= 0) & (shell < len(edges) - 1)
    images, shell = images[inside], shell[inside]
    empty = np.setdiff1d(np.arange(len(edges) - 1), shell)
    if empty.size:
        raise ValueError(
            f"Powder has the shell from {edges[empty[0]]:g} to {edges[empty[0] + 1]:g}, where {lattice.text}, have no "
            "wave vector; take wider shells, or more cells"
        )
    order = np.argsort(shell, kind="stable")
    return _of_lengths(0.5 * (edges[1:] + edges[:-1]), images[order], shell[order])


def _of_lengths(middle: Floats, images: Floats, owner: Integers) -> WaveVectors:
    return WaveVectors(middle[:, None], middle, np.array([0, len(middle) - 1]), (len(middle),), images, owner)


def _on_path(lattice: Lattice, parts: list[Floats]) -> WaveVectors:
    q = np.concatenate(parts)
    steps = np.linalg.norm(np.diff(q, axis=0) @ lattice.reciprocal, axis=1)
    ends = np.unique(np.cumsum([len(part) for part in parts]) - 1)
    return WaveVectors(q, np.concatenate([[0.0], np.cumsum(steps)]), ends, (len(q),), q, np.arange(len(q)))


def _grid(lattice: Lattice, origin: Floats, steps: list[Floats], counts: list[int]) -> WaveVectors:
    first, second = (np.arange(count + 1)[:, None] * step for count, step in zip(counts, steps, strict=True))
    q = origin + (first[:, None] + second).reshape(-1, len(origin))
    shape = (counts[0] + 1, counts[1] + 1)
    distance = np.linalg.norm((q - q[0]) @ lattice.reciprocal, axis=1)
    corners = np.array([0, counts[1], len(q) - 1 - counts[1], len(q) - 1])
    return WaveVectors(q, distance, corners, shape, q, np.arange(len(q)))


def _read_corners(lattice: Lattice, given: Any, what: str) -> Floats:
    axes = len(lattice.sizes)
    corners = read_finite(given, what)
    if axes == 1 and corners.ndim == 1:
        corners = corners[:, None]
    if corners.ndim != 2 or corners.shape[1] != axes or not len(corners):
        raise ValueError(
            f"{what} has shape {corners.shape}; give corners (corners, {axes}) in units of the reciprocal edges"
        )
    far = np.argwhere(np.abs(corners) > MAX_WAVES)
    if far.size:
        raise ValueError(f"{what} has {corners[tuple(far[0])]:g} reciprocal lattice units; give at most {MAX_WAVES}")
    return corners


def _fits(lattice: Lattice, q: Floats) -> NDArray[np.bool_]:
    """Return where wave vectors are commensurate with the cells of a lattice, of the shape of q."""
    with np.errstate(over="ignore", invalid="ignore"):
        waves = q * np.array(lattice.sizes)
        near = np.abs(waves - np.rint(waves)) <= COMMENSURATE * np.maximum(1.0, np.abs(waves))
    return np.asarray(near & (np.abs(waves) < MAX_WAVES))


def _whole(lattice: Lattice, q: Floats, what: str) -> Integers:
    """Return the numbers of waves in the lattice; ValueError for a wave vector that does not fit its cells."""
    off = np.argwhere(~_fits(lattice, q))
    if off.size:
        twisted = (
            "" if lattice.twist is None else ", to which that of all S+, or S-, adds the twist / 2 pi, or minus it"
        )
        raise ValueError(
            f"{what} has the corner {short(tuple(q[off[0, 0]].tolist()))}, which does not fit {lattice.text}: q times "
            f"the cells of an axis must be a whole number{twisted}; give path=, or take other numbers of cells"
        )
    return np.rint(q * np.array(lattice.sizes)).astype(np.int64)
