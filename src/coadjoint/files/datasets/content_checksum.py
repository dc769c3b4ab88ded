"""Checksum of the content of a dataset, independent of file format, layout and compression."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray

CHECKSUM = "content_sha256"
"""Attribute with the checksum."""
EXCLUDED_ATTRIBUTES = (CHECKSUM, "coordinates", "_FillValue")
"""Attributes that are not content, since readers remove them."""
BUFFER_BYTES = 2**20  # of each piece of an array, for its copy in a fixed byte order


def with_checksum(dataset: xarray.Dataset) -> xarray.Dataset:
    """Add the checksum of a dataset to its attributes."""
    return dataset.assign_attrs({CHECKSUM: checksum_of(dataset)})


def checksum_of(dataset: xarray.Dataset) -> str:
    """Return SHA-256 of the names, dimensions, types (integers as int64), values and attributes of a dataset."""
    digest = hashlib.sha256(_attributes(dataset.attrs))
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = np.asarray(variable.values)
        kind = {"i": "int64", "u": "int64", "b": "bool"}.get(values.dtype.kind, values.dtype.name)
        text = values.dtype.kind not in "iubf"
        head = [name, list(map(str, variable.dims)), list(values.shape), "text" if text else kind]
        digest.update(json.dumps(head).encode() + _attributes(variable.attrs))
        flat = values.reshape(-1)
        for first in range(0, flat.size, BUFFER_BYTES):
            piece = flat[first : first + BUFFER_BYTES]
            if text:
                digest.update(json.dumps(list(map(_text, piece.tolist()))).encode())
            else:
                digest.update(np.ascontiguousarray(piece, dtype=np.dtype(kind).newbyteorder("<")).tobytes())
    return digest.hexdigest()


def _attributes(attributes: Mapping[Any, Any]) -> bytes:
    content = {str(name): _to_json(value) for name, value in attributes.items() if name not in EXCLUDED_ATTRIBUTES}
    return json.dumps(content, sort_keys=True).encode()


def _to_json(value: Any) -> Any:
    """Convert an attribute to JSON; arrays of one number become scalars, since files do not distinguish them."""
    if isinstance(value, str | bytes):
        return _text(value)
    array = np.asarray(value)
    if array.dtype.kind not in "iubf":
        return list(map(_text, array.reshape(-1).tolist()))
    numbers = [int(number) if isinstance(number, bool) else number for number in array.reshape(-1).tolist()]
    return numbers[0] if len(numbers) == 1 else numbers


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
