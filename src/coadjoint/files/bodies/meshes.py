"""Meshes: OBJ, STL, PLY and glTF, which trimesh reads, with a mass or a density."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.files.bodies.gltf import files_of_gltf
from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import content_of
from coadjoint.systems.bodies.closed_surfaces import moments_of
from coadjoint.systems.bodies.mass_properties import ROUNDING, MassProperties
from coadjoint.validation import read_positive

Floats = npt.NDArray[np.float64]

MAX_MESH_BYTES = 2**32
"""Largest file of a mesh (bytes)."""
MEMORY_FACTOR = 32
"""Memory for reading a mesh over the size of its file: text, vertices, edges and their order."""
GLTF = (".gltf", ".glb")


def properties_of_mesh(path: Path, scale: Any, mass: Any, density: Any) -> MassProperties:
    """Return the mass properties of a homogeneous body with a closed surface."""
    suffix = path.suffix.lower()
    if (mass is None) == (density is None):
        given = "neither mass nor density was given, and a mesh has none"
        given = given if mass is None else "mass and density were both given"
        raise ValueError(f"{path}: {given}; give one of them")
    if scale is None and suffix not in GLTF:
        raise ValueError(
            f"{path}: scale is needed, since {suffix[1:].upper()} files have no unit; give the length of its unit, "
            "such as scale=0.001 for a file in millimetres and results in metres"
        )
    length = 1.0 if scale is None else read_positive(scale, "scale")
    amount = read_positive(density, "density") if mass is None else read_positive(mass, "mass")
    require_packages(f"reading the mesh {path.name}", "trimesh")
    vertices, faces = _surface(path, suffix)
    moments = moments_of(vertices * length, faces, str(path))
    total = amount * moments.volume if mass is None else amount
    second = total * moments.second
    # Products of a body that is symmetric in these axes are what rounding leaves of them.
    second[np.abs(second) <= ROUNDING * np.abs(second).max()] = 0.0
    frame = "glTF axes, +Y up" if suffix in GLTF else "axes and origin of the file"
    lengths = "m" if scale is None else f"{length:g} times the unit of the file"
    return MassProperties(
        total,
        np.trace(second) * np.eye(3) - second,
        moments.centre,
        f"{frame}, of {path}",
        f"length: {lengths}; mass: that of the given {'mass' if density is None else 'density'}",
        moments.radius,
        total * moments.third,
        total * moments.fourth,
        (moments.points, moments.triangles),
    )


def _surface(path: Path, suffix: str) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Return the vertices and triangles of a file, those of all its parts together."""
    import trimesh

    content = content_of(path, MAX_MESH_BYTES, "a mesh", MEMORY_FACTOR)
    files = files_of_gltf(content, path) if suffix in GLTF else {}
    try:
        scene = trimesh.load_scene(
            io.BytesIO(content), file_type=suffix[1:], resolver=files, process=False, skip_materials=True
        )
        mesh = scene.to_mesh()
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except MemoryError:
        raise
    except Exception as error:  # damaged files raise arbitrary errors
        raise ValueError(
            f"{path} is no mesh in the format {suffix[1:].upper()}: {type(error).__name__}: {error}"
        ) from None
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"{path} has no triangles in space; its vertices need three coordinates")
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise ValueError(f"{path} has a triangle with a vertex that is not in the file")
    return vertices, faces
