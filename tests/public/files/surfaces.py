"""Closed surfaces of sums and differences of convex bodies, written as meshes by the conventions of each format.

The reference integrates over tetrahedra of Delaunay, which no surface enters, by Gauss quadrature.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

BOX = np.array(list(product((-1.0, 1.0), repeat=3)))


def prism(sides: int, height: float = 1.0) -> np.ndarray:
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (0.0, height)])


# Of float32, which binary formats hold.
BODIES: dict[str, list[tuple[int, np.ndarray]]] = {
    "box": [(1, BOX * (1.0, 2.0, 0.5))],
    "tetrahedron": [(1, np.array([(0, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 3.0)]))],
    "wedge": [(1, np.array([(0, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 1), (0, 1, 1.0)]))],
    "octahedron": [(1, np.concatenate([np.eye(3), -np.eye(3)]) * (1.0, 2.0, 3.0))],
    "pyramid": [(1, np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0), (0.5, 0, 2.0)]))],
    "hexagonal prism": [(1, prism(6, 0.5))],
    "hollow box": [(1, 2.0 * BOX), (-1, BOX + (0.5, 0.25, 0.0))],
    "two apart": [(1, BOX), (1, 0.5 * BOX + (4.0, 1.0, 0.0))],
    "ball in a shell": [(1, 4.0 * BOX), (-1, 3.0 * BOX), (1, prism(8))],
    "far away": [(1, prism(5) + (1000.0, -2000.0, 500.0))],
}
BODIES = {name: [(sign, p.astype(np.float32).astype(float)) for sign, p in body] for name, body in BODIES.items()}


class Surface(NamedTuple):
    """Vertices and triangles, outward."""

    vertices: np.ndarray
    triangles: np.ndarray

    def flipped(self) -> Surface:
        return Surface(self.vertices, self.triangles[:, ::-1])


def joined(*parts: Surface) -> Surface:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    triangles = [part.triangles + begin for part, begin in zip(parts, starts, strict=False)]
    return Surface(np.concatenate([part.vertices for part in parts]), np.concatenate(triangles))


def surface(body: list[tuple[int, np.ndarray]]) -> Surface:
    """Return the surface of a body, by the hulls of its parts."""
    parts = []
    for sign, points in body:
        hull = ConvexHull(points)
        corners = points[hull.simplices]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
        triangles = np.where((inward ^ (sign < 0))[:, None], hull.simplices[:, ::-1], hull.simplices)
        parts.append(Surface(points, triangles))
    return joined(*parts)


def integral(body: list[tuple[int, np.ndarray]], f: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Return the integral of a function of points, (n, 3), exact for polynomials up to degree 6."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    nodes, weights = (nodes + 1) / 2, weights / 2
    a, b, c = (array.ravel() for array in np.meshgrid(nodes, nodes, nodes, indexing="ij"))
    w = np.einsum("i,j,k->ijk", weights, weights, weights).ravel() * a * a * b
    total: Any = 0.0
    for sign, points in body:
        for corners in points[Delaunay(points).simplices]:
            # From the cube to the tetrahedron (Duffy).
            edges = corners[1:] - corners[0]
            at = corners[0] + np.outer(a * (1 - b), edges[0]) + np.outer(a * b * (1 - c), edges[1])
            at = at + np.outer(a * b * c, edges[2])
            total = total + sign * abs(np.linalg.det(edges)) * np.tensordot(w, f(at), axes=(0, 0))
    return total


# Writers: of each format in several of its ways. Each takes a path and a surface, and returns the path of the file.


def obj_plain(path: Path, mesh: Surface) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in one) for one in mesh.triangles.tolist()]
    path.write_text("# exported\nmtllib none.mtl\no body\n" + "\n".join(lines) + "\n")


def obj_negative(path: Path, mesh: Surface) -> None:
    """Indices from the end, with normals and groups."""
    count = len(mesh.vertices)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()] + ["vn 0 0 1", "g a", "usemtl grey", "s off"]
    lines += ["f " + " ".join(f"{i - count}//-1" for i in one) for one in mesh.triangles.tolist()]
    path.write_text("\n".join(lines))


def obj_textured(path: Path, mesh: Surface) -> None:
    """Vertices with texture and normal, CRLF, and a continued line."""
    lines = [f"v {x!r} {y!r} \\\n{z!r}" for x, y, z in mesh.vertices.tolist()] + ["vt 0.5 0.5", "vn 1 0 0"]
    lines += ["f " + " ".join(f"{i + 1}/1/1" for i in one) for one in mesh.triangles.tolist()]
    path.write_bytes("\r\n".join(lines).replace("\\\n", "\\\r\n").encode())


def stl_text(path: Path, mesh: Surface) -> None:
    lines = ["solid body"]
    for corners in mesh.vertices[mesh.triangles].tolist():
        lines += [" facet normal 0 0 0", "  outer loop"]
        lines += [f"   vertex {x:.16e} {y:.16e} {z:.16e}" for x, y, z in corners]
        lines += ["  endloop", " endfacet"]
    path.write_text("\n".join([*lines, "endsolid body"]) + "\n")


def stl_binary(path: Path, mesh: Surface) -> None:
    """A header that begins with solid, as some programs write it."""
    rows = [struct.pack("<12fH", 0, 0, 0, *corners.ravel(), 0) for corners in mesh.vertices[mesh.triangles]]
    path.write_bytes(b"solid binary".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows))


PLY = "ply\nformat {} 1.0\ncomment {}\nelement vertex {}\n{}element face {}\nproperty list uchar int {}\nend_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"


def ply_text(path: Path, mesh: Surface) -> None:
    lines = [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += ["3 " + " ".join(map(str, one)) for one in mesh.triangles.tolist()]
    head = PLY.format("ascii", "by hand", len(mesh.vertices), XYZ, len(mesh.triangles), "vertex_indices")
    path.write_text(head + "\n".join(lines) + "\n")


def ply_binary(path: Path, mesh: Surface, order: str = "<", name: str = "binary_little_endian") -> None:
    """Binary, with colours of vertices, and the other name of the list."""
    more = XYZ + "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head = PLY.format(name, "TextureFile none.png", len(mesh.vertices), more, len(mesh.triangles), "vertex_index")
    data = b"".join(struct.pack(f"{order}3f3B", *point, 1, 2, 3) for point in mesh.vertices)
    data += b"".join(struct.pack(f"{order}B3i", 3, *one) for one in mesh.triangles.tolist())
    path.write_bytes(head.encode() + data)


def ply_big(path: Path, mesh: Surface) -> None:
    ply_binary(path, mesh, ">", "binary_big_endian")


def gltf_parts(mesh: Surface, indices: str = "H") -> tuple[dict[str, Any], bytes]:
    """Return header and buffer with positions, and with indices unless `indices` is empty."""
    points = (mesh.vertices if indices else mesh.vertices[mesh.triangles].reshape(-1, 3)).astype("<f4")
    listed = mesh.triangles.astype(f"<u{struct.calcsize(indices or 'H')}").tobytes() if indices else b""
    data = points.tobytes() + listed
    code = {"B": 5121, "H": 5123, "I": 5125}.get(indices)
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3", "min": low, "max": high}
    ]
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes}]
    primitive: dict[str, Any] = {"attributes": {"POSITION": 0}}
    if indices:
        accessors.append({"bufferView": 1, "componentType": code, "count": mesh.triangles.size, "type": "SCALAR"})
        views.append({"buffer": 0, "byteOffset": points.nbytes, "byteLength": len(listed)})
        primitive["indices"] = 1
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    return header, data


def gltf_inside(path: Path, mesh: Surface) -> None:
    """The buffer in the file, with a node that is moved and turned back by its child."""
    header, data = gltf_parts(mesh)
    header["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    header["nodes"] = [
        {"children": [1], "translation": [1, 2, 3], "rotation": [0, 0, 1, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [-0.5, 0, 0, 0, 0, -0.5, 0, 0, 0, 0, 0.5, 0, 0.5, 1, -1.5, 1]},
    ]
    path.write_text(json.dumps(header))


def gltf_beside(path: Path, mesh: Surface) -> None:
    """The buffer in a file beside it, whose name has a space."""
    header, data = gltf_parts(mesh, "B")
    header["buffers"][0]["uri"] = "the%20buffer.bin"
    (path.parent / "the buffer.bin").write_bytes(data)
    path.write_text(json.dumps(header))


def glb(path: Path, mesh: Surface, indices: str = "I") -> None:
    header, data = gltf_parts(mesh, indices)
    text = json.dumps(header).encode()
    text, data = text.ljust(-(-len(text) // 4) * 4), data.ljust(-(-len(data) // 4) * 4, b"\0")
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(data)) + b"BIN\0" + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)


def glb_without_indices(path: Path, mesh: Surface) -> None:
    glb(path, mesh, "")


WRITERS: dict[str, list[Callable[[Path, Surface], None]]] = {
    ".obj": [obj_plain, obj_negative, obj_textured],
    ".stl": [stl_text, stl_binary],
    ".ply": [ply_text, ply_binary, ply_big],
    ".gltf": [gltf_inside, gltf_beside],
    ".glb": [glb, glb_without_indices],
}
