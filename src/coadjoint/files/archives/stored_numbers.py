"""Numbers and arrays by name as bytes, in the format of `numpy.savez`, read without pickle and in bounded memory."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

NPY_SUFFIX = ".npy"
MAX_AXES = 8


def serialize_numbers(numbers: Mapping[str, Any]) -> bytes:
    """Serialize numbers and arrays."""
    content = io.BytesIO()
    np.savez(content, **{name: np.asarray(value) for name, value in numbers.items()})  # type: ignore[arg-type]
    return content.getvalue()


def deserialize_numbers(raw: bytes) -> dict[str, NDArray[Any]]:
    """Deserialize the arrays of `serialize_numbers`; ValueError if they are damaged, compressed, or longer than their
    bytes.

    Examples
    --------
    >>> deserialize_numbers(serialize_numbers({"step": 3}))
    {'step': array(3)}
    """
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            files = archive.infolist()
            if any(file.compress_type != zipfile.ZIP_STORED or file.flag_bits & 1 for file in files):
                raise ValueError("it is compressed or encrypted")
            if sum(file.file_size for file in files) > len(raw):
                raise ValueError("its entries are longer than the file")
            return {file.filename.removesuffix(NPY_SUFFIX): _array_from(archive.read(file)) for file in files}
    except ValueError:
        raise
    except Exception as reason:  # zip and npy readers raise arbitrary errors for damaged bytes
        raise ValueError(f"{type(reason).__name__} while it was read") from reason


def _array_from(raw: bytes) -> NDArray[Any]:
    content = io.BytesIO(raw)
    version = npy.read_magic(content)
    if version != (1, 0):
        raise ValueError("it holds an array of an unknown version")
    shape, by_columns, dtype = npy.read_array_header_1_0(content)
    count = prod(shape)
    if dtype.kind not in "biuf" or min(shape, default=0) < 0 or len(shape) > MAX_AXES:
        raise ValueError("it contains an array that is not of numbers")
    if count * dtype.itemsize != len(raw) - content.tell():
        raise ValueError("it contains an array whose length contradicts its shape")
    found = np.frombuffer(raw, dtype, count, content.tell())
    return found.reshape(shape, order="F" if by_columns else "C").copy(order="K")
