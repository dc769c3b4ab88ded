"""Validation of untrusted files before they are read: no external references, and no content longer than declared.

NetCDF 4 is HDF5, which can refer to other files and load plugins as filters; a Zarr store selects its codecs, one of
which unpickles. Files written by this library and by xarray use none of these.
"""

from __future__ import annotations

import json
import os
import re
import stat
import zlib
from collections.abc import Iterator, Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.memory import UNCHECKED_BYTES, check_available_memory
from coadjoint.short_repr import short

DEFLATE, SHUFFLE, FLETCHER = 1, 2, 3
"""Built-in filters of HDF5, as opposed to plugins."""
CHECKSUM_BYTES = 4
"""Bytes that a checksum adds to a chunk."""
MAX_FILES = 10**6  # of a store, whose names are held in memory
METADATA_FILES = (".zgroup", ".zattrs", ".zarray", ".zmetadata", "zarr.json")
NUMERIC_TYPE = re.compile(r"[<>|]?(?:[fiu][1248]|b1|U\d{1,6}|S\d{1,6})|float(?:32|64)|u?int(?:8|16|32|64)|bool")
COMPRESSORS, UNCOMPRESSED_CODECS = ("blosc", "zstd"), ("bytes", "crc32c", "vlen-utf8")


def check_hdf5(path: Path) -> None:
    """Raise ValueError for an HDF5 file with links, external data, other filters, or chunks longer than declared."""
    import h5py

    size = path.stat().st_size
    with h5py.File(path, "r") as file:
        total = 0
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise ValueError(f"{short(name)} is a link, which the library does not write")
            variable = file[name]
            if not isinstance(variable, h5py.Dataset):
                raise ValueError(f"{short(name)} is no variable")
            total += _check_variable(variable, name, size)
        for item in (file, *file.values()):
            for name in item.attrs:
                attribute = item.attrs.get_id(name)
                if attribute.dtype.kind == "O":  # each text may be as long as the file
                    total += size * prod(attribute.shape)
        check_available_memory(2 * total, "the content")


def _check_variable(variable: Any, name: str, size: int) -> int:
    """Validate a variable of HDF5; return its size in bytes."""
    import h5py

    plist = variable.id.get_create_plist()
    if variable.is_virtual or plist.get_external_count():
        raise ValueError(f"{short(name)} is in other files, which the library does not write")
    filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    if not {DEFLATE, SHUFFLE, FLETCHER}.issuperset(filters) or len(set(filters)) < len(filters):
        raise ValueError(f"{short(name)} has the filters {short(filters)}, which the library does not write")
    if h5py.check_string_dtype(variable.dtype) is None and variable.dtype.kind not in "iuf":
        raise ValueError(f"{short(name)} contains neither numbers nor text")
    count, chunk = prod(variable.shape or ()), prod(variable.chunks or (0,)) * variable.dtype.itemsize
    # Many texts may share the same bytes of the file.
    size_of_each = 100 if variable.dtype.kind == "O" else variable.dtype.itemsize
    check_available_memory(2 * max(count * size_of_each, chunk), short(name))
    if DEFLATE in filters:
        _check_deflated(variable, name, filters, chunk, size)
    if variable.dtype.kind == "O":
        length = 0
        for first in range(0, count, step := max(1, UNCHECKED_BYTES // max(1, size))) if variable.ndim == 1 else ():
            length += sum(map(len, variable[first : first + step]))
            if length > size:
                raise ValueError(f"{short(name)} has more text than the file is long")
        if variable.ndim != 1:
            raise ValueError(f"{short(name)} has texts over {variable.ndim} dimensions")
    return count * int(variable.dtype.itemsize)


def _check_deflated(variable: Any, name: str, filters: list[int], length: int, size: int) -> None:
    """Reject chunks that do not decompress to the chunk size `length`, or claim more than the `size` of the file."""
    for k in range(variable.id.get_num_chunks()):
        chunk = variable.id.get_chunk_info(k)
        if chunk.size > size:
            raise ValueError(f"{short(name)} has a chunk that is longer than the file")
        skipped, packed = variable.id.read_direct_chunk(chunk.chunk_offset)
        if skipped:
            raise ValueError(f"{short(name)} has a chunk without all of its filters")
        # A checksum applied before the compression is part of the compressed data.
        checksum_is_last = FLETCHER in filters and filters.index(FLETCHER) > filters.index(DEFLATE)
        unpacked = zlib.decompressobj().decompress(
            packed[:-CHECKSUM_BYTES] if checksum_is_last else packed, length + CHECKSUM_BYTES + 1
        )
        if len(unpacked) != length + (CHECKSUM_BYTES if FLETCHER in filters and not checksum_is_last else 0):
            raise ValueError(f"{short(name)} has a chunk of another length than declared")


def check_zarr(folder: Path) -> None:
    """Raise ValueError or OSError for a Zarr store with links, unknown codecs, or chunks longer than declared."""
    arrays = dict[str, dict[str, Any]]()
    files = []
    for count, name in enumerate(_files(folder)):
        if count > MAX_FILES:
            raise ValueError(f"there are more than {MAX_FILES} files")
        array_path, _, file_name = name.rpartition("/")
        if file_name not in METADATA_FILES:
            files.append(name)
            continue
        metadata = json.loads((folder / name).read_bytes().decode("utf-8"))
        consolidated = metadata.get("metadata") if file_name == ".zmetadata" else None
        if file_name == "zarr.json":
            consolidated = (metadata.get("consolidated_metadata") or {}).get("metadata")
        for key, entry in (consolidated or {}).items():
            _register_array(arrays, key.removesuffix("/.zarray"), entry)
        _register_array(arrays, array_path, metadata)
    for name in files:
        array_name = name.partition("/")[0]
        if array_name in arrays:
            _check_chunk(folder / name, name, arrays[array_name])


def _files(folder: Path, before: str = "") -> Iterator[str]:
    """Yield all files below a folder; reject links and special files."""
    with os.scandir(folder) as entries:
        for entry in entries:
            status = entry.stat(follow_symlinks=False)
            if stat.S_ISDIR(status.st_mode):
                yield from _files(Path(entry.path), f"{before}{entry.name}/")
            elif stat.S_ISREG(status.st_mode):
                yield f"{before}{entry.name}"
            else:
                raise ValueError(f"{short(before + entry.name)} is a link, or no file")


def _register_array(arrays: dict[str, dict[str, Any]], name: str, metadata: Mapping[str, Any]) -> None:
    """Register an array of a Zarr store (format 2 or 3) from its metadata; reject what plain xarray does not write."""
    if "shape" not in metadata:
        return
    if not name.isidentifier():
        raise ValueError(f"an array is called {short(name)}, which is no plain name")
    if "codecs" in metadata:
        codecs = [entry["name"] for entry in metadata["codecs"]]
        data_type, chunk = metadata["data_type"], metadata["chunk_grid"]["configuration"]["chunk_shape"]
        if isinstance(data_type, dict) and data_type["name"] in ("fixed_length_utf32", "null_terminated_bytes"):
            item_size = data_type["configuration"]["length_bytes"]
        else:
            item_size = 0 if data_type == "string" else _item_size(data_type)
        storage_transformers = metadata.get("storage_transformers")
    else:
        codecs = [entry["id"] for entry in (metadata["filters"] or [])]
        codecs += [metadata["compressor"]["id"]] if metadata["compressor"] else []
        if "pickle" in codecs:
            raise ValueError(
                f"the array {short(name)} is stored by pickle, which can run code; store it by another codec"
            )
        data_type, chunk, storage_transformers = metadata["dtype"], metadata["chunks"], None
        item_size = 0 if codecs[:1] == ["vlen-utf8"] else _item_size(data_type)
    packers = [codec for codec in codecs if codec in COMPRESSORS]
    if storage_transformers or len(packers) > 1 or not {*COMPRESSORS, *UNCOMPRESSED_CODECS}.issuperset(codecs):
        raise ValueError(
            f"the codecs of {short(name)} are {short(codecs)}; those of a run are {', '.join(COMPRESSORS)}"
        )
    if any(type(size) is not int or size < 0 for size in (*metadata["shape"], *chunk, item_size)):
        raise ValueError(f"the shape of {short(name)} is {short(metadata['shape'])}, in chunks of {short(chunk)}")
    length = prod(chunk) * max(item_size, 1)
    if length > max(UNCHECKED_BYTES, prod(metadata["shape"]) * item_size):
        raise ValueError(f"the chunks of {short(name)} are larger than the array")
    check_available_memory(2 * length, f"a chunk of {short(name)}")
    packer_index = codecs.index(packers[0]) if packers else len(codecs)
    inside, outside = (CHECKSUM_BYTES * part.count("crc32c") for part in (codecs[:packer_index], codecs[packer_index:]))
    declaration = {
        "packer": packers[0] if packers else "",
        "text": item_size == 0,
        "length": length,
        "sums": (inside, outside),
    }
    if arrays.setdefault(name, declaration) != declaration:
        raise ValueError(f"the metadata of {short(name)} contradict each other")


def _item_size(kind: Any) -> int:
    if not isinstance(kind, str) or not NUMERIC_TYPE.fullmatch(kind):
        raise ValueError(f"an array holds {short(kind)}, which is neither numbers nor text")
    return int(np.dtype(kind).itemsize)


def _check_chunk(file: Path, name: str, array: Mapping[str, Any]) -> None:
    """Reject a chunk that decompresses to more than the chunk size."""
    with open(file, "rb") as content:
        length = _decompressed_length(content.read(32), array["packer"])
        if array["text"]:
            if length is None or 0 <= length <= UNCHECKED_BYTES:
                content.seek(0)
                decode_texts(_decompress(content.read(), array["packer"], *array["sums"]), array["length"])
                return
        elif length is None or length == array["length"] + array["sums"][0]:
            return
    raise ValueError(f"the chunk {short(name)} has another length than its array declares")


def _decompressed_length(head: bytes, compressor: str) -> int | None:
    """Return the decompressed length from the header of a chunk; None if it is not compressed, -1 if not declared."""
    if not compressor:
        return None
    if compressor == "blosc":
        return int.from_bytes(head[4:8], "little")
    flags = head[4] if head[:4] == b"\x28\xb5\x2f\xfd" and len(head) > 4 else 0
    single = flags >> 5 & 1
    size = (single, 2, 4, 8)[flags >> 6]
    first = 6 - single + (0, 1, 2, 4)[flags & 3]
    return int.from_bytes(head[first : first + size], "little") + (256 if size == 2 else 0) if size else -1


def _decompress(content: bytes, compressor: str, inside: int, outside: int) -> bytes:
    """Decompress a chunk without its checksums, of `inside` and `outside` bytes relative to the compression."""
    if compressor:
        import numcodecs

        content = bytes(numcodecs.get_codec({"id": compressor}).decode(content[: len(content) - outside]))
    return content[: len(content) - inside]


def decode_texts(content: bytes, count: int) -> list[str]:
    """Decode a known number of vlen-utf8 texts; ValueError if they are damaged."""
    texts, end = [], 4
    if int.from_bytes(content[:4], "little") != count or 4 * count > len(content):
        raise ValueError("a chunk of the archive is damaged: it has another number of texts")
    for _ in range(count):
        begin = end + 4
        end = begin + int.from_bytes(content[end:begin], "little")
        texts.append(content[begin:end].decode("utf-8"))
    if end != len(content):
        raise ValueError("a chunk of the archive is damaged: its texts have other lengths")
    return texts
