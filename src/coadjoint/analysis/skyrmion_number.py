"""The skyrmion number of spins on a lattice in the plane, by solid angles."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.geometry import CELLS, has_cell, read_flags, sizes_of
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# A small affine map, without symmetry, after which no four sites of a lattice are on one circle.
STRAIN = np.array([[1.0 + 3.1e-4, 1.7e-4], [-0.9e-4, 1.0 - 2.3e-4]])
ROUNDING = 1e-9  # of sums of solid angles of up to 10^7 triangles
FLAT = 1e-6  # largest difference of the heights of sites, in distances of cells


class PlaneOfSites(NamedTuple):
    """A lattice in the plane: vectors of the cell (2, 2), sites in units of them, cells (a, b), layers, occupation."""

    vectors: Floats
    sites: Floats
    cells: tuple[int, int]
    periodic: tuple[bool, ...]
    layers: int
    occupied: Integers  # numbers of the sites of the state among all


@suggest_keywords
def skyrmion_number(model: Any, x: npt.ArrayLike) -> Any:
    """Return the skyrmion number of states on a lattice in the plane: how often the spins cover the sphere.

    Choose it to count skyrmions, merons and vortices, of any lattice. The lattice is triangulated, and the solid angles
    of the three spins of each triangle are summed (Berg and Luescher). On a periodic lattice the sum is an integer,
    which changes when a skyrmion collapses; with open edges it is a real number, and a skyrmion far from the edge
    counts as one.

    Parameters
    ----------
    model : SpinModel or LiePoissonSystem
        From `co.systems.spins` or `co.spins.micromagnetic`, in the plane of the first two lattice vectors, or a
        `spin_lattice` that is square, triangular, honeycomb or kagome.
    x : (..., n) array_like
        One state or several, such as ``sol.x``.

    Returns
    -------
    float or ndarray
        The number of each state, (...); of a model of several cells along the third lattice vector that of each layer,
        (..., layers). It is that of the spins; moments m = -S have the opposite one. A skyrmion whose spins point up
        far away and down in the middle has -1, an antiskyrmion +1.

    Raises
    ------
    ValueError, TypeError
        Another lattice, a cell whose sites are not in one plane, or states of another size.

    Notes
    -----
    ``Q = (1/4 pi) sum(Omega)``, with ``tan(Omega/2) = S1 . (S2 x S3) / (1 + S1 . S2 + S2 . S3 + S3 . S1)``, over the
    triangles 123 counterclockwise about the normal a x b. The triangulation is Delaunay's of a slightly strained
    lattice, the same for each cell. Triangles with a vacancy, or with a spin of length zero, are left out, as at an
    open edge.

    References
    ----------
    B. Berg, M. Luescher, Nuclear Physics B 190, 412 (1981).

    Examples
    --------
    >>> import numpy as np, coadjoint as co
    >>> lattice = co.systems.spin_lattice("triangular", (16, 16), periodic=True)
    >>> r = np.stack(np.indices((16, 16)) - 7.5, axis=-1) @ [[1, 0], [0.5, 0.75**0.5]]
    >>> angle, tilt = np.arctan2(r[..., 1], r[..., 0]), np.pi * np.clip(1 - np.hypot(*np.moveaxis(r, -1, 0)) / 6, 0, 1)
    >>> S = np.stack([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), np.cos(tilt)], axis=-1)
    >>> co.spins.skyrmion_number(lattice, S.ravel())
    -1.0
    """
    plane = _plane(model)
    states = read_finite(x, "x")
    if states.ndim == 0 or states.shape[-1] != model.dim:
        raise ValueError(f"x has shape {states.shape}; {model.name} has states of {model.dim} numbers")
    whole = states.shape[:-1]
    count, (na, nb) = len(plane.sites), plane.cells
    triangles = _triangles(plane)
    check_available_memory(8 * 12 * len(triangles) * plane.layers, "solid angles")
    found = np.empty((math.prod(whole), plane.layers))
    for k, row in enumerate(states.reshape(-1, model.dim)):
        spins = np.zeros((na * nb * plane.layers * count, 3))
        spins[plane.occupied] = row.reshape(-1, 3)
        lengths = np.linalg.norm(spins, axis=1, keepdims=True)
        spins /= np.where(lengths > 0.0, lengths, 1.0)
        layers = spins.reshape(na * nb, plane.layers, count, 3).swapaxes(0, 1).reshape(plane.layers, -1, 3)
        one, two, three = (layers[:, triangles[:, corner]] for corner in range(3))
        dots = [(a * b).sum(axis=-1) for a, b in ((one, two), (two, three), (three, one))]
        angles = 2.0 * np.arctan2((one * np.cross(two, three)).sum(axis=-1), 1.0 + dots[0] + dots[1] + dots[2])
        there = (layers[:, triangles] != 0.0).any(axis=-1).all(axis=-1)
        found[k] = np.where(there, angles, 0.0).sum(axis=-1) / (4.0 * np.pi)
    whole_numbers = np.rint(found)
    found = np.where(np.abs(found - whole_numbers) < ROUNDING, whole_numbers, found) + 0.0  # no -0
    result = found.reshape(*whole, plane.layers) if plane.layers > 1 else found.reshape(whole)
    return result if result.ndim else float(result)


def _plane(model: Any) -> PlaneOfSites:
    """Return the plane of a model; ValueError or TypeError for systems without one."""
    if isinstance(model, SpinModel):
        model._check_directions("skyrmion_number")
        if any(model.twist):
            raise ValueError(f"{short(model)} has twisted boundaries, across which its number is not whole")
        lattice = model.crystal.lattice
        a, b, normal = lattice[0], lattice[1], np.cross(lattice[0], lattice[1])
        normal = normal / np.linalg.norm(normal)
        along = a / np.linalg.norm(a)
        frame = np.stack([along, np.cross(normal, along)])
        places = model.crystal.positions @ lattice
        heights = places @ normal
        if np.ptp(heights) > FLAT * np.linalg.norm(a):
            raise ValueError(
                f"the sites of {model.crystal!r} are at the heights {heights.round(4).tolist()} above the plane of the "
                "first two lattice vectors; skyrmion_number needs sites in one plane, which subcrystal keeps"
            )
        vectors = np.stack([a, b]) @ frame.T
        sites = (places - places[0]) @ frame.T @ np.linalg.inv(vectors)
        return PlaneOfSites(vectors, sites, model.size[:2], model.periodic[:2], model.size[2], model._declared.numbers)
    layout: Any = getattr(model, "layout", {})
    name, parameters = layout.get("lattice"), getattr(model, "parameters", None) or {}
    if not has_cell(name) or len(CELLS[name].edges) != 2 or "periodic" not in parameters:
        raise TypeError(
            f"{short(getattr(model, 'name', model))} is no lattice in the plane; skyrmion_number takes models of "
            "co.systems.spins, and spin_lattice with a square, triangular, honeycomb or kagome lattice and a field "
            "that is no function"
        )
    sizes, vectors = sizes_of(layout["shape"]), np.array(CELLS[name].edges, dtype=np.float64)
    sites = np.array(CELLS[name].sites, dtype=np.float64) @ np.linalg.inv(vectors)
    total = len(sites) * math.prod(sizes)
    return PlaneOfSites(
        vectors, sites, (sizes[0], sizes[1]), read_flags(parameters["periodic"], 2), 1, np.arange(total)
    )


def _triangles(plane: PlaneOfSites) -> Integers:
    """Return the triangles of all cells of a layer, (triangles, 3), counterclockwise; none crosses an open edge."""
    corners, offsets = _triangles_of_cell(plane.vectors, plane.sites)
    na, nb = plane.cells
    cells = np.indices((na, nb)).reshape(2, -1).T[:, None, None] + offsets  # (cells, triangles, 3, 2)
    inside = np.ones(cells.shape[:2], dtype=bool)
    for axis, closed in enumerate(plane.periodic):
        if closed:
            cells[..., axis] %= plane.cells[axis]
        else:
            inside &= ((cells[..., axis] >= 0) & (cells[..., axis] < plane.cells[axis])).all(axis=2)
    numbers = (cells[..., 0] * nb + cells[..., 1]) * len(plane.sites) + corners
    return numbers[inside]


def _triangles_of_cell(vectors: Floats, sites: Floats) -> tuple[Integers, Integers]:
    """Return Delaunay triangles of a periodic plane, once for each cell: sites (k, 3), and their cells (k, 3, 2)."""
    from scipy.spatial import Delaunay

    reach = 2.0 * float(np.linalg.norm(vectors, axis=1).sum())  # of the circles of all triangles of a cell
    spans = np.ceil(reach * np.linalg.norm(np.linalg.inv(vectors), axis=0)).astype(np.int64) + 1
    sizes = 2 * spans + 1
    check_available_memory(400 * float(math.prod(sizes.tolist())) * len(sites), "a triangulation")
    offsets = np.indices(sizes).reshape(2, -1).T - spans
    places = ((offsets[:, None] + sites) @ vectors @ STRAIN).reshape(-1, 2)
    simplices = np.asarray(Delaunay(places).simplices, dtype=np.int64)
    first, second, third = (places[simplices[:, corner]] for corner in range(3))
    (xa, ya), (xb, yb) = (second - first).T, (third - first).T
    turn = xa * yb - ya * xb
    simplices[turn < 0.0] = simplices[turn < 0.0][:, ::-1]
    kinds, cells = simplices % len(sites), offsets[simplices // len(sites)]
    # The corner that is least by site, then by cell, is the same for all images of a triangle; keep that of one cell.
    key = (kinds * sizes[0] + cells[..., 0]) * sizes[1] + cells[..., 1]
    least = np.take_along_axis(cells, key.argmin(axis=1)[:, None, None], axis=1)[:, 0]
    kept = (least == 0).all(axis=1) & (turn != 0.0)
    if kept.sum() != 2 * len(sites):
        raise ValueError("the sites of the cell are too close to each other, or to a line, to be triangulated")
    return kinds[kept], cells[kept]
