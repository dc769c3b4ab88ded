"""Lattices: positions of the sites in space, reciprocal lattices, and neighbours, also of graphs given by edges."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import read_bool, read_choice, read_integer, read_list, to_array

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
BYTES_PER_EDGE = 100  # peak, while edges are sorted
MAX_SITES = 2**30  # three coordinates per site, with 32-bit indices

COS_60, SIN_60 = 0.5, math.sqrt(0.75)  # directions of bonds of triangles and hexagons


class Cell(NamedTuple):
    """Edges of a cell, positions of its sites, corners of a path in reciprocal edges, and bonds."""

    # A bond is (site, site of the other cell, offset of the other cell along the edges); all have length one.

    edges: tuple[tuple[float, ...], ...]
    sites: tuple[tuple[float, ...], ...]
    path: tuple[tuple[float, ...], ...]
    bonds: tuple[tuple[int, int, tuple[int, ...]], ...]


TRIANGULAR_PATH = ((0.0, 0.0), (0.5, 0.0), (2.0 / 3.0, 1.0 / 3.0), (0.0, 0.0))  # Gamma, M, K, Gamma
_CHAIN = Cell(((1.0, 0.0),), ((0.0, 0.0),), ((0.0,), (1.0,)), ((0, 0, (1,)),))
CELLS: Mapping[str, Cell] = {
    "chain": _CHAIN,
    "ring": _CHAIN,
    "square": Cell(
        ((1.0, 0.0), (0.0, 1.0)),
        ((0.0, 0.0),),
        ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.0)),
        ((0, 0, (1, 0)), (0, 0, (0, 1))),
    ),
    "triangular": Cell(
        ((1.0, 0.0), (COS_60, SIN_60)),
        ((0.0, 0.0),),
        TRIANGULAR_PATH,
        ((0, 0, (1, 0)), (0, 0, (0, 1)), (0, 0, (1, -1))),
    ),
    "honeycomb": Cell(
        ((2 * SIN_60, 0.0), (SIN_60, 1.5)),
        ((0.0, 0.0), (SIN_60, COS_60)),
        TRIANGULAR_PATH,
        ((0, 1, (0, 0)), (1, 0, (1, 0)), (1, 0, (0, 1))),
    ),
    "kagome": Cell(
        ((2.0, 0.0), (1.0, 2 * SIN_60)),
        ((0.0, 0.0), (1.0, 0.0), (COS_60, SIN_60)),
        TRIANGULAR_PATH,
        ((0, 1, (0, 0)), (0, 2, (0, 0)), (1, 2, (0, 0)), (1, 0, (1, 0)), (2, 0, (0, 1)), (1, 2, (1, -1))),
    ),
    "cubic": Cell(
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0),),
        ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.5, 0.5), (0.0, 0.0, 0.0)),
        ((0, 0, (1, 0, 0)), (0, 0, (0, 1, 0)), (0, 0, (0, 0, 1))),
    ),
}
"""Lattice -> its cell; the distance between neighbours is one."""
OPEN_LATTICES = tuple(name for name in CELLS if name != "ring")
NAMES = (*OPEN_LATTICES, "complete", "ring")


def has_cell(lattice: Any) -> bool:
    """Return whether a lattice is one of `CELLS`, by name; others are complete, or given by pairs of sites."""
    return isinstance(lattice, str) and lattice in CELLS


def sizes_of(shape: Any) -> tuple[int, ...]:
    """Return the number of cells along each axis."""
    return tuple(np.atleast_1d(shape).tolist())


def lattice_positions(lattice: str, shape: Any) -> Floats:
    """Return the positions of all sites in space, (sites, 2 or 3), cell by cell, along the last axis first."""
    edges, sites = (np.array(part) for part in CELLS[lattice][:2])
    return np.asarray(((_cells(shape) @ edges)[:, None] + sites).reshape(-1, edges.shape[1]))


def cell_coordinates(lattice: str, shape: Any) -> Floats:
    """Return the positions of all sites in units of the edges of the cell, (sites, axes)."""
    edges, sites = (np.array(part) for part in CELLS[lattice][:2])
    within = (sites @ np.linalg.pinv(edges)).round(15)
    return np.asarray((_cells(shape)[:, None] + within).reshape(-1, len(edges)))


def reciprocal_edges(lattice: str) -> Floats:
    """Return the edges b of the reciprocal cell, (axes, 2 or 3): a_i . b_j = 2 pi delta_ij."""
    return np.asarray(2.0 * np.pi * np.linalg.pinv(np.array(CELLS[lattice].edges)).T)


def _cells(shape: Any) -> Floats:
    sizes = sizes_of(shape)
    return np.indices(sizes).reshape(len(sizes), -1).T.astype(np.float64)


def graph(lattice: Any, shape: Any, periodic: Any) -> tuple[int, Integers]:
    """Return the number of sites of a lattice (a name of `NAMES`, or pairs of sites), and its edges, (edges, 2)."""
    # `shape` counts cells along each axis, or sites if edges are given; `periodic` joins the last cell to the first.
    # Cells are numbered with the last axis fastest, sites by cells; edges are ordered by bonds, then by first cell.
    what, advice = "lattice", ""
    if not isinstance(lattice, str):
        count = read_integer(shape, "shape, the number of sites where edges are given,", 1, MAX_SITES)
        read_flags(periodic, 1)
        edges = _read_edges(lattice, count)
    elif read_choice(lattice, "lattice", NAMES) == "complete":
        count = read_integer(shape, "shape of a complete graph, its number of sites,", 1, MAX_SITES)
        read_flags(periodic, 1)
        check_available_memory(BYTES_PER_EDGE * count * (count - 1) / 2, f"a complete graph of {short(count)} sites")
        edges = np.stack(np.triu_indices(count, 1), axis=1).astype(np.int64)
    else:
        cell, closed = CELLS[lattice], lattice == "ring" or periodic
        axes = len(cell.edges)
        sizes = read_sizes(shape, axes, "shape", f" for a lattice that is {lattice}")
        count = len(cell.sites) * math.prod(sizes)
        check_available_memory(BYTES_PER_EDGE * count * len(cell.bonds), f"a {lattice} lattice of {short(count)} sites")
        flags = read_flags(closed, axes)
        edges = np.concatenate(edges_of_bonds(len(cell.sites), cell.bonds, sizes, flags))
        if all(size >= 3 for size, flag in zip(sizes, flags, strict=True) if flag):
            return count, edges
        what, advice = (
            f"a periodic {lattice} lattice of shape {short(shape)}",
            "; take 3 or more cells along periodic axes",
        )
    _check_simple(edges, count, what, advice)
    return count, edges


def read_sizes(shape: Any, axes: int, what: str, where: str = "") -> tuple[int, ...]:
    """Return the number of cells along each axis, validated."""
    rule = f"give {axes} whole numbers" if axes > 1 else "give one whole number"
    sizes = (shape,) if axes == 1 and not isinstance(shape, tuple | list) else read_list(shape, what, rule)
    if len(sizes) != axes:
        raise ValueError(f"{what} is {short(shape)}; {rule}{where}")
    return tuple(read_integer(size, f"{what}[{axis}]") for axis, size in enumerate(sizes))


def read_flags(periodic: Any, axes: int) -> tuple[bool, ...]:
    """Return one flag for each axis."""
    if not isinstance(periodic, tuple | list):
        return (read_bool(periodic, "periodic"),) * axes
    if len(periodic) != axes:
        raise ValueError(f"periodic is {short(periodic)}; give one truth value, or {axes} of them")
    return tuple(read_bool(flag, f"periodic[{axis}]") for axis, flag in enumerate(periodic))


def edges_of_bonds(
    sites: int, bonds: Iterable[tuple[int, int, tuple[int, ...]]], sizes: tuple[int, ...], periodic: tuple[bool, ...]
) -> list[Integers]:
    """Return the edges (edges, 2) of each bond of a cell of some sites, for all cells."""
    numbers = np.arange(math.prod(sizes), dtype=np.int64).reshape(sizes)
    edges = []
    for first, second, step in bonds:
        cells, others = numbers, numbers
        for axis, (shift, size, closed) in enumerate(zip(step, sizes, periodic, strict=True)):
            others = np.roll(others, -shift, axis) if shift else others
            if shift and not closed:
                inside = slice(max(0, -shift), max(0, size - max(0, shift)))
                index = (slice(None),) * axis + (inside,)
                cells, others = cells[index], others[index]
        edges.append(np.stack([cells.ravel() * sites + first, others.ravel() * sites + second], axis=1))
    return edges


def _read_edges(edges: Any, count: int) -> Integers:
    array = to_array(edges, "lattice")
    if array.size == 0:
        return np.zeros((0, 2), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != 2 or array.dtype.kind not in "iu":
        raise ValueError(
            f"lattice is {short(edges, 60)}; give pairs of sites, whole numbers of shape (edges, 2), or one of "
            f"{', '.join(NAMES)}"
        )
    outside = np.argwhere((array < 0) | (array >= count))
    if outside.size:
        edge, end = outside[0].tolist()
        raise ValueError(f"edge {edge} has the site {array[edge, end]}; sites are numbered from 0 to {count - 1}")
    return array.astype(np.int64)


def _check_simple(edges: Integers, count: int, what: str, advice: str) -> None:
    """Raise ValueError for an edge from a site to itself, and for two edges between the same sites."""
    low, high = np.minimum(*edges.T), np.maximum(*edges.T)
    loops = np.flatnonzero(low == high)
    if loops.size:
        raise ValueError(f"{what} joins site {low[loops[0]]} to itself{advice or '; give pairs of different sites'}")
    keys = np.sort(low * count + high)
    duplicates = np.flatnonzero(keys[1:] == keys[:-1])
    if duplicates.size:
        i, j = divmod(int(keys[duplicates[0]]), count)
        raise ValueError(f"{what} joins the sites {i} and {j} twice{advice or '; give every pair once'}")
