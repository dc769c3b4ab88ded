"""Vector fields on rectangular meshes in the XML formats of VTK, read and written."""

from __future__ import annotations

import base64
import binascii
import math
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from coadjoint.files.bodies.xml_elements import Element, elements_of
from coadjoint.files.output.output_files import VTKS, check_target, pending
from coadjoint.files.ovf import KINDS, OvfField, moments_on_mesh
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_choice, read_path, read_title

Floats = npt.NDArray[np.float64]

MAX_BYTES, MAX_NODES = 2**31, 2**30
TYPES = {"Float32": "f4", "Float64": "f8"}
HEADERS = {"UInt32": "u4", "UInt64": "u8"}
ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
GRIDS = ("ImageData", "StructuredGrid")
EVEN = 1e-4  # largest deviation of points from an even mesh, in edges of a cell: points have seven digits


@suggest_keywords
def read_vtk(path: str | Path) -> OvfField:
    """Return the vector field in an XML file of VTK, such as those of mumax3-convert, ParaView and this library.

    Parameters
    ----------
    path : str or pathlib.Path
        Image data (``.vti``) or an even structured grid (``.vts``), with one array of three components at points or in
        cells, as text or base64 without compression. If there are several, the one that is named as ``Vectors``.

    Returns
    -------
    OvfField
        As of `read_ovf`, without a unit of length.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        Another format, several pieces, compressed or appended data, uneven points, or numbers that are not finite.

    See Also
    --------
    coadjoint.spins.write_vtk : Write such a file.

    References
    ----------
    "VTK XML file formats", in the documentation of VTK 9, docs.vtk.org.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np, coadjoint as co
    >>> file = pathlib.Path(tempfile.mkdtemp(), "m.vti")
    >>> co.spins.write_vtk(file, np.tile((0.6, 0.0, 0.8), 8), (4, 2), cell=(4e-9, 4e-9, 1e-9))
    >>> co.spins.read_vtk(file).spins((8, 4)).shape
    (96,)
    """
    file = read_path(path, "path")
    root = elements_of(file, "an XML file of VTK", MAX_BYTES)
    kind = root.attributes.get("type", "")
    if root.tag != "VTKFile" or kind not in GRIDS:
        root.refuse(f"is {short(kind or root.tag)}; give a VTKFile of {' or '.join(GRIDS)}")
    if "compressor" in root.attributes:
        root.refuse("has compressed data; save it as text, or binary without compression")
    grid = root.needed(kind)
    pieces = grid.all("Piece")
    if len(pieces) != 1:
        grid.refuse(f"has {len(pieces)} pieces; save the mesh as one")
    order = ORDERS.get(root.attributes.get("byte_order", "LittleEndian"))
    header = HEADERS.get(root.attributes.get("header_type", "UInt32"))
    if order is None or header is None:
        root.refuse("has another byte_order or header_type than those of VTK")
    extent = [int(one) for one in grid.numbers("WholeExtent", 6)]
    points = tuple(high - low + 1 for low, high in zip(extent[::2], extent[1::2], strict=True))
    if min(points) < 1 or math.prod(points) > MAX_NODES:
        grid.refuse(f"has the WholeExtent {extent}; give a mesh of at most {MAX_NODES} points")
    array, at_points = _vectors(pieces[0])
    nodes = points if at_points else tuple(max(1, count - 1) for count in points)
    values = _numbers(array, order, header).reshape(-1, 3)
    if len(values) != math.prod(nodes):
        array.refuse(f"has {len(values)} vectors, and the mesh {' x '.join(map(str, nodes))}; write the file again")
    cell = _spacing(grid) if kind == "ImageData" else _spacing_of_points(pieces[0], points, order, header)
    field = np.ascontiguousarray(values.reshape(*nodes[::-1], 3).transpose(2, 1, 0, 3))
    return OvfField(field, cell, "", ("1",) * 3, array.attributes.get("Name", ""), None)


@suggest_keywords
def write_vtk(
    path: str | Path,
    spins: npt.ArrayLike,
    shape: npt.ArrayLike,
    *,
    cell: npt.ArrayLike,
    data: str = "binary 8",
    title: str = "m",
) -> None:
    """Write the state of a lattice with one spin a cell as image data of VTK, for ParaView and other viewers.

    The vectors are the moments, m = -S, in the cells of the mesh.

    Parameters
    ----------
    path : str or pathlib.Path
        Name of the file, ``.vti``, replaced atomically.
    spins : (3 sites,) array_like
        Spins of any length, in the order of `co.systems.spin_lattice`.
    shape : int or tuple of int
        Number of cells along x, y, z; missing axes have one cell.
    cell : (3,) array_like
        Lengths of the edges of a cell along x, y, z, in metres.
    data : {"binary 8", "binary 4", "text"}
        Numbers of 8 or 4 bytes in base64, or text of 17 digits.
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
    coadjoint.spins.read_vtk : Read such a file.

    Examples
    --------
    See `read_vtk`.
    """
    target = check_target(path, VTKS)
    nodes, edges, moments = moments_on_mesh(spins, shape, cell)
    kind, name = read_choice(data, "data", KINDS), read_title(title, "title")
    for plain, escaped in (("&", "&amp;"), ("<", "&lt;"), ('"', "&quot;")):
        name = name.replace(plain, escaped)
    width = "4" if kind == "binary 4" else "8"
    extent, form = " ".join(f"0 {count}" for count in nodes), "ascii" if kind == "text" else "binary"
    if kind == "text":
        body = "\n".join(" ".join(map(repr, row)) for row in moments.tolist()).encode()
    else:
        raw = moments.astype(f"<f{width}").tobytes()
        body = base64.b64encode(np.array(len(raw), dtype="<u8").tobytes() + raw)
    head = f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{" ".join(map(repr, edges.tolist()))}">
<Piece Extent="{extent}">
<CellData Vectors="{name}">
<DataArray type="Float{8 * int(width)}" Name="{name}" NumberOfComponents="3" format="{form}">
"""
    with pending(target) as unfinished, open(unfinished.path, "wb") as file:
        file.write(head.encode())
        file.write(body)
        file.write(b"\n</DataArray>\n</CellData>\n</Piece>\n</ImageData>\n</VTKFile>\n")


def _vectors(piece: Element) -> tuple[Element, bool]:
    """Return the array of vectors of a piece, and whether it is at points."""
    found = []
    for place in ("PointData", "CellData"):
        block = piece.one(place)
        arrays = [] if block is None else block.all("DataArray")
        vectors = [one for one in arrays if one.attributes.get("NumberOfComponents", "1").strip() == "3"]
        named = [one for one in vectors if block and one.attributes.get("Name") == block.attributes.get("Vectors")]
        found += [(one, place == "PointData") for one in (named if len(named) == 1 else vectors)]
    if len(found) != 1:
        piece.refuse(f"has {len(found)} arrays of three components; name one of them as its Vectors")
    return found[0]


def _numbers(array: Element, order: str, header: str) -> Floats:
    """Return the finite numbers of an array."""
    form, kind = array.attributes.get("format", "ascii"), TYPES.get(array.attribute("type"))
    if kind is None or form not in ("ascii", "binary"):
        array.refuse(
            f"has type={short(array.attribute('type'))}, format={short(form)}; save Float32 or Float64 as text "
            "(ascii) or in base64 (binary)"
        )
    try:
        if form == "ascii":
            values = np.array(array.text.split(), dtype=np.float64)
        else:
            # The length and the data are encoded together, or one after the other.
            text = "".join(array.text.split())
            raw = b"".join(base64.b64decode(part, validate=True) for part in re.findall(r"[^=]+=*", text))
            size = int(header[-1])
            count = int(np.frombuffer(raw[:size], order + header)[0])
            values = np.frombuffer(raw[size : size + count], order + kind).astype(np.float64)
    except (ValueError, IndexError, binascii.Error):
        array.refuse("holds what is no number; write the file again")
    if len(values) % 3 or not np.isfinite(values).all():
        array.refuse("holds numbers that are not finite, or no whole vectors; write the file again")
    return values


def _spacing(grid: Element) -> tuple[float, float, float]:
    direction = grid.numbers("Direction", 9, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    if direction != (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0):
        grid.refuse("has another Direction than x, y, z; save it without rotation")
    x, y, z = grid.numbers("Spacing", 3)
    if not min(x, y, z) > 0.0:
        grid.refuse("has a Spacing that is not positive")
    return x, y, z


def _spacing_of_points(piece: Element, points: tuple[int, ...], order: str, header: str) -> tuple[float, float, float]:
    """Return the distances of the points of an even grid along its axes, NaN of an axis with one point."""
    array = piece.needed("Points").needed("DataArray")
    places = _numbers(array, order, header).reshape(-1, 3)
    if len(places) != math.prod(points):
        array.refuse(f"has {len(places)} points; the grid has {' x '.join(map(str, points))}")
    grid = places.reshape(*points[::-1], 3).transpose(2, 1, 0, 3)
    last = tuple(count - 1 for count in points)
    span = (grid[last] - grid[0, 0, 0]) / [max(count, 1) for count in last]
    even = grid[0, 0, 0] + np.moveaxis(np.indices(points), 0, -1) * span
    many = np.array(points) > 1
    if not (span[many] > 0.0).all() or np.abs(grid - even).max() > EVEN * span[many].min(initial=np.inf):
        array.refuse("has points that are not those of an even mesh along x, y, z; interpolate the field to one")
    x, y, z = np.where(many, span, np.nan).tolist()
    return x, y, z
