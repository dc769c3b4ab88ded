"""The normal deviates of the kernels, read in NumPy: the same numbers."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray


def normal_deviates(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.float64]:
    """Return independent normal deviates, a function of the seed, the stream, the moment and the part alone.

    Parameters
    ----------
    seed, stream : int
        From 0 to 2^63 - 1.
    moment : float
        A time.
    part : int
        Of what begins at that time.
    count : int
        How many.

    Returns
    -------
    ndarray, shape (count,)
        By Philox4x64-10 and the inverse of the distribution function, to round-off those of the kernels.

    Examples
    --------
    >>> normal_deviates(1, 0, 0.5, 0, 5)[:3].tolist() == normal_deviates(1, 0, 0.5, 0, 3).tolist()
    True
    """
    from scipy.special import ndtri

    words = words_of(seed, stream, moment, part, count)
    size = -ndtri((np.asarray(words >> np.uint64(12), dtype=np.float64) + 0.5) * 2.0**-53)
    return np.asarray(np.where(words & np.uint64(1), -size, size))


def words_of(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.uint64]:
    """Return the random bits behind the deviates, 64 for each."""
    (when,) = struct.unpack("<Q", struct.pack("<d", moment + 0.0))
    # NumPy raises the counter by one before its first block.
    counter = (((part << 192) | (stream << 128) | (when << 64)) - 1) % (1 << 256)
    words = np.random.Philox(key=seed, counter=counter).random_raw(-(-count // 4) * 4)
    return np.asarray(words[:count], dtype=np.uint64)
