"""Vector fields in the format OVF 2.0 of OOMMF and mumax3, read and written."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.files.output.output_files import OVFS, OutputError, check_target, pending
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import (
    read_choice,
    read_finite,
    read_integer,
    read_number,
    read_path,
    read_title,
    reject_lost_labels,
)

Floats = npt.NDArray[np.float64]

FIRST_LINE = "oommf ovf 2.0"
AXES = ("x", "y", "z")
MESHES = ("chain", "ring", "square", "cubic")  # lattices of `spin_lattice` with one spin in a rectangular cell
EXTENT = 1e-3  # largest relative difference of the extents of a mesh and a model
PICOSECOND = 1e-12
# The first number of binary data tells the order of their bytes.
CHECKS = {"4": ("<f4", 1234567.0), "8": ("<f8", 123456789012345.0)}
# Blocks of data by the names of the argument.
KINDS = {"text": "Text", "binary 4": "Binary 4", "binary 8": "Binary 8"}
LARGEST_FILE, LONGEST_HEADER = 2**34, 2**16
TIME = re.compile(r"total simulation time:\s*(\S+)\s+s\b", re.IGNORECASE)


@dataclass(frozen=True)
class OvfField:
    """A field of three components on a rectangular mesh, as `read_ovf` and `read_vtk` return it.

    Attributes
    ----------
    values : (nx, ny, nz, 3) ndarray
        The vectors at the centres of the cells, as in the file.
    cell : tuple of float
        Lengths of the edges of a cell along x, y, z, in `length_unit`; NaN along an axis of one node without a length.
    length_unit : str
        Unit of the mesh, such as ``"m"``; empty in VTK, which has none.
    units : tuple of str
        Units of the three components: ``"1"`` for directions, ``"A/m"`` for a magnetization.
    title : str
        What the file calls it.
    time : float or None
        The time in seconds, where the description has one as mumax3 writes it.
    """

    values: Floats
    cell: tuple[float, float, float]
    length_unit: str
    units: tuple[str, ...]
    title: str
    time: float | None

    def __repr__(self) -> str:
        nodes = " x ".join(map(str, self.values.shape[:3]))
        return f"<{self.title or 'field'} on {nodes} cells, {' '.join(dict.fromkeys(self.units))}>"

    @suggest_keywords
    def spins(self, shape: npt.ArrayLike | SpinModel) -> Floats:
        """Return the state of a lattice with one spin a cell: the directions of the spins, opposite to the moments.

        Spins are angular momenta, S = -m for moments m. A cell without a moment, outside of the material, keeps a spin
        of length zero, which neither moves nor acts on others.

        Parameters
        ----------
        shape : int or tuple of int, or SpinModel
            Number of cells of the lattice along x, y, z, as for `co.systems.spin_lattice`; missing axes have one cell.
            Either that of the mesh, or proportional to it: then the directions are interpolated linearly between the
            centres of the cells, and at the edges continued. Or a model with a spin in each cell of a rectangular
            mesh, such as `co.spins.micromagnetic`: it must have the extent of the file, and states of positive g are
            along the moments.

        Returns
        -------
        (3 nx ny nz,) ndarray
            The spins cell by cell, with the last axis fastest.

        Raises
        ------
        ValueError
            A lattice of other proportions than the mesh.

        Examples
        --------
        See `read_ovf`.
        """
        model, nodes = shape if isinstance(shape, SpinModel) else None, self.values.shape[:3]
        sign: Any = -1.0
        if model is None:
            wanted = read_mesh(shape)  # type: ignore[arg-type]
        else:
            wanted, edges, signs = mesh_of(model)
            sign = signs[:, None]
            self._check_extent(edges, wanted)
        if len({Fraction(new, old) for new, old in zip(wanted, nodes, strict=True) if max(new, old) > 1}) > 1:
            raise ValueError(
                f"the file has another mesh, {product_text(nodes)} cells, than the lattice, {product_text(wanted)}; "
                "give a lattice that has as many cells along each axis, or all of them in one proportion"
            )
        moments = self.values
        for axis, count in enumerate(wanted):
            moments = _resampled(moments, axis, count)
        lengths = np.linalg.norm(moments, axis=-1, keepdims=True)
        state = sign * (moments / np.where(lengths > 0.0, lengths, 1.0)).reshape(-1, 3)
        return (state if model is None else state[occupied_of(model)]).ravel()

    def _check_extent(self, edges: Floats | None, wanted: tuple[int, int, int]) -> None:
        """Raise ValueError unless the mesh of a model is as large as that of the file, where both have lengths."""
        if edges is None or self.length_unit != "m":
            return
        own, other = (np.multiply(a, b) for a, b in ((self.cell, self.values.shape[:3]), (edges, wanted)))
        if np.any(np.abs(own - other) > EXTENT * other):
            raise ValueError(
                f"the file has a mesh of {' x '.join(f'{one:.6g}' for one in own)} m, and the model one of "
                f"{' x '.join(f'{one:.6g}' for one in other)} m; give a model of the same extent, or a shape"
            )


@suggest_keywords
def read_ovf(path: str | Path) -> OvfField:
    """Return the vector field in a file OVF 2.0, text or binary, as mumax3, OOMMF and others write it.

    Choose it to start spins from a state of a micromagnetic simulation, or to compare with one.

    Parameters
    ----------
    path : str or pathlib.Path
        A file with a rectangular mesh and three components.

    Returns
    -------
    OvfField
        With ``values``, ``cell``, ``length_unit``, ``units``, ``time``, and ``spins(shape)``, the state of a lattice.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        Files of other formats (OVF 1.0 by name), irregular meshes, other numbers of components, data that end early, or
        numbers that are not finite, with their cell.

    See Also
    --------
    coadjoint.spins.write_ovf : Write such a file.

    References
    ----------
    M. J. Donahue, D. G. Porter, "OOMMF User's Guide", NISTIR 6376 (1999), in later versions with OVF 2.0.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import coadjoint as co
    >>> film = co.systems.spin_lattice("square", (4, 2))
    >>> x0 = np.tile((0.6, 0.0, 0.8), 8)
    >>> file = pathlib.Path(tempfile.mkdtemp(), "m.ovf")
    >>> co.spins.write_ovf(file, x0, (4, 2), cell=(4e-9, 4e-9, 1e-9))
    >>> field = co.spins.read_ovf(file)
    >>> field
    <m on 4 x 2 x 1 cells, 1>
    >>> bool(np.allclose(field.spins((4, 2)), x0)), field.spins((8, 4)).shape
    (True, (96,))
    """
    content = content_of(read_path(path, "path"), LARGEST_FILE, "an OVF file", factor=3)
    start = re.search(
        rb"(?im)^#[ \t]*begin:[ \t]*data[ \t]+(text|binary[ \t]*[48])[ \t]*\r?\n", content[:LONGEST_HEADER]
    )
    lines = (content[: start.start()] if start else content[:LONGEST_HEADER]).decode("utf-8", "replace").splitlines()
    first = lines[0].lstrip("# \t").strip().lower() if lines else ""
    if not first.startswith(FIRST_LINE):
        other = "is of another version than 2.0" if "oommf" in first else "is no OVF 2.0 file"
        raise ValueError(f"{path} {other}: its first line is {short(lines[0] if lines else '')}; write it as OVF 2.0")
    if start is None:
        raise ValueError(f"{path} has no block of data, text, binary 4 or binary 8, after a header of at most 64 kB")
    head = _Header(path, lines)
    nodes = tuple(head.integer(f"{axis}nodes") for axis in AXES)
    if head.text("meshtype") != "rectangular" or head.integer("valuedim") != 3:
        raise ValueError(
            f"{path} has a mesh that is {head.text('meshtype')} with {head.text('valuedim')} components; three on a "
            "rectangular mesh are spins"
        )
    count = 3 * nodes[0] * nodes[1] * nodes[2]
    kind = b"".join(start.group(1).lower().split()).decode()
    values = (
        _values_of_text(content, start.end()) if kind == "text" else _binary(path, content, start.end(), kind, count)
    )
    if values is None or values.size != count:
        found = "holds what is no number" if values is None else f"has {values.size} numbers"
        raise ValueError(
            f"{path}: its data {found}, and {product_text(nodes)} cells need {count}; write the file again"
        )
    field = values.reshape(*nodes[::-1], 3).transpose(2, 1, 0, 3)
    if not np.isfinite(field).all():
        cell = tuple(int(k) for k in np.argwhere(~np.isfinite(field))[0][:3])
        raise ValueError(f"{path}: the vector of cell {cell}, from 0 along x, y, z, is not finite")
    units = tuple((head.values.get("valueunits") or "1").split())
    time = TIME.search(" ".join(head.described))
    return OvfField(
        np.ascontiguousarray(field, dtype=np.float64),
        (head.number("xstepsize"), head.number("ystepsize"), head.number("zstepsize")),
        head.text("meshunit"),
        units if len(units) == 3 else units[:1] * 3,
        head.values.get("title", ""),
        _finite(time.group(1)) if time else None,
    )


@suggest_keywords
def write_ovf(
    path: str | Path,
    spins: npt.ArrayLike,
    shape: npt.ArrayLike,
    *,
    cell: npt.ArrayLike,
    data: str = "binary 8",
    time: float | None = None,
    title: str = "m",
) -> None:
    """Write the state of a lattice with one spin a cell as OVF 2.0, for mumax3, OOMMF, Ubermag and viewers.

    The file has the directions of the moments, m = -S. The states of a run are written one by one, as in
    ``for k, x in enumerate(sol.x): co.spins.write_ovf(f"m{k:06}.ovf", x, shape, cell=cell)``.

    Parameters
    ----------
    path : str or pathlib.Path
        Name of the file, ``.ovf`` or ``.omf``, replaced atomically.
    spins : (3 sites,) array_like
        Spins of any length, in the order of `co.systems.spin_lattice`.
    shape : int or tuple of int
        Number of cells along x, y, z; missing axes have one cell.
    cell : (3,) array_like
        Lengths of the edges of a cell along x, y, z, in metres.
    data : {"binary 8", "binary 4", "text"}
        Numbers of 8 or 4 bytes, or text of 17 digits.
    time : float, optional
        Time of the state in seconds, for the description.
    title : str
        Name of the field.

    Raises
    ------
    TypeError, ValueError
        Spins that are not finite or not three numbers for each cell, or edges that are not positive.
    OutputError
        A path with another suffix, or one that cannot be written.

    See Also
    --------
    coadjoint.spins.read_ovf : Read such a file.

    Examples
    --------
    See `read_ovf`.
    """
    target = check_target(path, OVFS)
    nodes, edges, moments = moments_on_mesh(spins, shape, cell)
    kind = read_choice(data, "data", KINDS)
    name = read_title(title, "title")
    lines = ["OOMMF OVF 2.0", "Segment count: 1", "Begin: Segment", "Begin: Header", f"Title: {name}"]
    lines += ["meshtype: rectangular", "meshunit: m"]
    lines += [
        f"{axis}{end}: {value!r}"
        for end, times in (("min", 0), ("max", 1))
        for axis, value in zip(AXES, (edges * nodes * times).tolist(), strict=True)
    ]
    lines += ["valuedim: 3", "valuelabels: m_x m_y m_z", "valueunits: 1 1 1"]
    if time is not None:
        lines.append(f"Desc: Total simulation time:  {read_number(time, 'time')!r}  s")
    for key, values in (("base", edges / 2), ("nodes", nodes), ("stepsize", edges)):
        lines += [f"{axis}{key}: {value!r}" for axis, value in zip(AXES, np.asarray(values).tolist(), strict=True)]
    lines += ["End: Header", f"Begin: Data {KINDS[kind]}"]
    head, end = (
        "".join(f"# {line}\n" for line in some) for some in (lines, [f"End: Data {KINDS[kind]}", "End: Segment"])
    )
    with pending(target) as unfinished, open(unfinished.path, "wb") as file:
        file.write(head.encode())
        if kind == "text":
            np.savetxt(file, moments, fmt="%.17g")
        else:
            form, check = CHECKS[kind[-1]]
            file.write(np.array(check, dtype=form).tobytes())
            file.write(moments.astype(form).tobytes())
            file.write(b"\n")
        file.write(end.encode())


class _Header:
    """The labels and values of a header; case, spaces and tabs in labels do not count."""

    def __init__(self, path: str | Path, lines: list[str]) -> None:
        self.path, self.described = path, list[str]()
        self.values: dict[str, str] = {}
        for line in lines[1:]:
            label, colon, value = line.partition("##")[0].lstrip("# \t").partition(":")
            key = "".join(label.split()).lower()
            if key == "desc":
                self.described.append(value.strip())
            elif colon:
                self.values[key] = value.strip()

    def text(self, key: str) -> str:
        if key not in self.values:
            raise ValueError(f"{self.path} has no {key!r} in its header; an OVF 2.0 file needs it")
        return self.values[key]

    def integer(self, key: str) -> int:
        value = self.text(key)
        if not re.fullmatch(r"[0-9]{1,9}", value) or int(value) == 0:
            raise ValueError(f"{self.path}: {key} is {short(value)}; it must be an integer from 1 to 999999999")
        return int(value)

    def number(self, key: str) -> float:
        value = _finite(self.text(key))
        if value is None or not value > 0.0:
            raise ValueError(f"{self.path}: {key} is {short(self.text(key))}; it must be a positive number")
        return value


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _values_of_text(content: bytes, begin: int) -> Floats | None:
    """Return the numbers of a block of text up to its end or the next label; None if it holds anything else."""
    words: list[bytes] = []
    for line in content[begin:].splitlines():
        if re.match(rb"(?i)\s*#\s*end", line):
            break
        words += line.partition(b"#")[0].split()
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        return None


def _binary(path: str | Path, content: bytes, begin: int, kind: str, count: int) -> Floats:
    """Return the numbers of a block of binary data, as many as there are up to a count."""
    form, check = CHECKS[kind[-1]]
    size = int(form[-1])
    if content[begin : begin + size] != np.array(check, dtype=form).tobytes():
        raise ValueError(f"{path}: its binary data do not begin with {check:.0f}, the check of OVF 2.0; write it again")
    there = min(count, (len(content) - begin - size) // size)
    return np.frombuffer(content, form, there, begin + size)


def moments_on_mesh(
    spins: npt.ArrayLike, shape: npt.ArrayLike, cell: npt.ArrayLike
) -> tuple[tuple[int, int, int], Floats, Floats]:
    """Return the nodes and edges of a mesh, and the moments of spins on it, (cells, 3) with x fastest."""
    nodes, edges = read_mesh(shape), read_finite(cell, "cell")
    if edges.shape != (3,) or not (edges > 0.0).all():
        raise ValueError(f"cell is {short(cell)}; it must be three positive lengths in metres, along x, y, z")
    states = read_finite(spins, "spins")
    if states.shape != (3 * nodes[0] * nodes[1] * nodes[2],):
        raise ValueError(
            f"spins has the shape {states.shape}; {product_text(nodes)} cells have three numbers each, in a row"
        )
    return nodes, edges, -states.reshape(*nodes, 3).transpose(2, 1, 0, 3).reshape(-1, 3)


def read_mesh(shape: npt.ArrayLike) -> tuple[int, int, int]:
    """Return the numbers of cells along x, y, z."""
    reject_lost_labels(shape, "shape")
    given = shape.tolist() if isinstance(shape, np.ndarray) else shape
    given = given if isinstance(given, tuple | list) else (given,)
    if not 1 <= len(given) <= 3:
        raise ValueError(f"shape is {short(shape)}; it must be one to three numbers of cells, along x, y, z")
    nx, ny, nz = (*(read_integer(one, "shape", 1) for one in given), 1, 1)[:3]
    return nx, ny, nz


def mesh_of(system: Any) -> tuple[tuple[int, int, int], Floats | None, Floats]:
    """Return the cells of a system with one spin in each, its edges in metres, and the sign of each cell's moment.

    Edges are None where the system has no unit of length; moments are opposite to the spins of `spin_lattice`.
    """
    if isinstance(system, SpinModel):
        system._check_directions("OVF")
        lattice, count = system.crystal.lattice, len(system.crystal.labels)
        edges = lattice.diagonal()
        if count > 1 or np.abs(lattice - np.diag(edges)).max() > 1e-9 * np.abs(edges).max() or not (edges > 0.0).all():
            raise ValueError(
                f"{system!r} has no rectangular mesh with one spin in a cell; OVF needs lattice vectors along x, y, z"
            )
        signs = np.full(math.prod(system.size), np.sign(system.moments[0]))
        signs[occupied_of(system)] = np.sign(system.moments)
        return system.size, edges * 1e-10 if system.units == "meV" else None, signs
    name, shape = (system.layout.get(key) for key in ("lattice", "shape"))
    if name not in MESHES or shape is None:
        raise ValueError(
            f"{system.name} has no rectangular mesh with one spin in a cell; OVF takes models of co.systems.spins "
            "(which co.load takes as system=, since archives have no crystals), and spin_lattice with one of "
            f"{', '.join(MESHES)}"
        )
    cells = read_mesh(shape)
    return cells, None, np.full(math.prod(cells), -1.0)


def occupied_of(model: SpinModel) -> npt.NDArray[np.int64]:
    """Return the numbers of the cells of a model that have a spin."""
    return np.asarray(np.ravel_multi_index(tuple(model.cells.T), model.size))


@suggest_keywords
def ovf_of_run(
    solution: Any, path: str | Path, cell: npt.ArrayLike | None, member: int | None, data: str
) -> tuple[Path, ...]:
    """Write the states of a run; `Solution.to_ovf`."""
    place, ensemble = read_path(path, "path"), solution.failed is not None
    if ensemble != (member is not None):
        raise ValueError(
            f"the run has {len(solution.failed)} members; give the number of one as member="
            if ensemble
            else f"member is {short(member)}, and the run has no members; leave it out"
        )
    one = None if member is None else read_integer(member, "member", 0, len(solution.failed) - 1)
    system = solution.system.of_member(one or 0).unforced
    shape, edges, signs = mesh_of(system)
    if (edges is None) == (cell is None):
        raise ValueError(
            f"{system.name} has no unit of length; give the edges of a cell in metres as cell="
            if cell is None
            else f"cell is {short(cell)}, and the cells of {system.name} have the edges {edges} m; leave it out"
        )
    occupied = occupied_of(system) if isinstance(system, SpinModel) else np.arange(len(signs))
    second = PICOSECOND if edges is not None else None
    lone = place.suffix in OVFS
    if not lone:
        try:
            place.mkdir(exist_ok=True)
        except OSError as reason:
            raise OutputError(f"{path}: no folder can be made ({reason.strerror}); give another one") from None
    written = []
    for k in [len(solution.t) - 1] if lone else range(len(solution.t)):
        spins = np.zeros((len(signs), 3))
        spins[occupied] = np.asarray(solution.x[k] if one is None else solution.x[k, one]).reshape(-1, 3)
        target = place if lone else place / f"m{k:06d}.ovf"
        time = None if second is None else float(solution.t[k]) * second
        state = (-signs[:, None] * spins).ravel()
        lengths: Any = edges if cell is None else cell
        write_ovf(target, state, shape, cell=lengths, data=data, time=time)
        written.append(target)
    return tuple(written)


def product_text(nodes: tuple[int, ...]) -> str:
    """Return numbers of cells as text."""
    return " x ".join(map(str, nodes))


def _resampled(values: Floats, axis: int, count: int) -> Floats:
    """Return values at the centres of other cells of the same extent along an axis, linear between those given."""
    given = values.shape[axis]
    if count == given:
        return values
    places = np.clip((np.arange(count) + 0.5) * given / count - 0.5, 0.0, given - 1.0)
    left = np.minimum(places.astype(np.int64), max(given - 2, 0))
    part = (places - left).reshape(-1, *(1,) * (values.ndim - axis - 1))
    lower, upper = np.take(values, left, axis), np.take(values, np.minimum(left + 1, given - 1), axis)
    return lower + part * (upper - lower)
