"""glTF 2.0: checks of what would be left out in silence, and the files of its buffers."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from coadjoint.regular_files import content_of
from coadjoint.short_repr import short

MAGIC = b"glTF"
TRIANGLES, STRIP = 4, 5
MAX_BUFFER_BYTES = 2**32
"""Largest buffer (bytes)."""
NUMBER_OF_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
"""Code of a type of components -> its bytes."""
MODES = ("points", "lines", "a loop of lines", "a strip of lines", "triangles", "a strip of triangles", "a fan")


def files_of_gltf(content: bytes, path: Path) -> dict[str, bytes]:
    """Return the files of the buffers by their URI; ValueError for what makes the surface another one than is read."""
    text = content
    if content[:4] == MAGIC:
        length = struct.unpack_from("<I", content, 12)[0] if len(content) >= 20 else 0
        text = content[20 : 20 + length]
    try:
        header = json.loads(text)
        _check(header, path)
        return _buffers(header, path)
    except (AttributeError, KeyError, TypeError, IndexError, RecursionError, UnicodeDecodeError, json.JSONDecodeError):
        raise ValueError(f"{path} is no file of glTF 2.0") from None


def _check(header: dict[str, Any], path: Path) -> None:
    def refuse(where: str, reason: str) -> None:
        raise ValueError(f"{path}: {where} {reason}")

    if not str(header["asset"]["version"]).startswith("2"):
        refuse("asset.version", f"is {short(header['asset']['version'], 20)}; files of glTF 2.0 are read")
    if header.get("extensionsRequired"):
        refuse("extensionsRequired", f"has {short(header['extensionsRequired'], 60)}; export the mesh without them")
    if header.get("skins") and any("skin" in node for node in header.get("nodes", ())):
        refuse("nodes", "have skins, and the surface depends on their pose; apply it")
    views, accessors = header.get("bufferViews", []), header.get("accessors", [])
    for k, accessor in enumerate(accessors):
        if "sparse" in accessor:
            refuse(f"accessors[{k}]", "is sparse, which is not read; export the mesh in full")
        size = _whole(accessor["count"]) * NUMBER_OF_COMPONENTS[accessor["type"]] * BYTES[accessor["componentType"]]
        if "bufferView" not in accessor:
            refuse(f"accessors[{k}]", "has no bufferView")
        if size > _whole(views[accessor["bufferView"]]["byteLength"]):
            refuse(f"accessors[{k}]", "is longer than its bufferView")
    for k, mesh in enumerate(header.get("meshes", ())):
        for n, primitive in enumerate(mesh["primitives"]):
            mode, where = primitive.get("mode", TRIANGLES), f"meshes[{k}].primitives[{n}]"
            if mode not in (TRIANGLES, STRIP):
                refuse(where, f"is {MODES[mode] if mode in range(7) else mode}; give triangles or strips of them")
            if primitive.get("targets"):
                refuse(where, "has morph targets, on whose weights the surface depends; apply them")
            if any(name.endswith("draco_mesh_compression") for name in primitive.get("extensions", ())):
                refuse(where, "is compressed by Draco; export the mesh without it")
    if len(header.get("scenes", ())) > 1 and "scene" not in header:
        refuse("scenes", f"are {len(header['scenes'])} without a default; give the number of one as scene")


def _whole(value: Any) -> int:
    """Return a whole number of the header; TypeError for anything else."""
    if type(value) is not int or value < 0:
        raise TypeError(value)
    return value


def _buffers(header: dict[str, Any], path: Path) -> dict[str, bytes]:
    """Return the files of buffers, which are in the folder of the main one, by their URI."""
    found: dict[str, bytes] = {}
    for k, buffer in enumerate(header.get("buffers", ())):
        uri = buffer.get("uri", "data:")
        if uri.startswith("data:"):
            continue
        if "\0" in unquote(uri):
            raise TypeError(uri)
        file = (path.parent / unquote(uri)).resolve()
        if "://" in uri or not file.is_relative_to(path.resolve().parent):
            raise ValueError(f"{path}: buffers[{k}] is {short(uri, 60)}, which is not in the folder of the file")
        try:
            found[uri] = content_of(file, MAX_BUFFER_BYTES, "a buffer of glTF", 2)
        except OSError as error:
            raise ValueError(f"{path}: buffers[{k}] is {short(uri, 60)}, which cannot be read: {error}") from None
    return found
