"""NumPy implementation of the normal deviates of the kernels."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray


def normal_deviates(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.float64]:
    """Return `count` independent normal deviates, a pure function of seed, stream (0 to 2^63 - 1), time and part.

    By Philox4x64-10 and the inverse distribution function; equal to those of the kernels to round-off. `part` numbers
    the draws that begin at the same time.
    """
    from scipy.special import ndtri

    words = random_words(seed, stream, moment, part, count)
    size = -ndtri((np.asarray(words >> np.uint64(12), dtype=np.float64) + 0.5) * 2.0**-53)
    return np.asarray(np.where(words & np.uint64(1), -size, size))


def random_words(seed: int, stream: int, moment: float, part: int, count: int) -> NDArray[np.uint64]:
    """Return the random words of the deviates, 64 bits each."""
    (when,) = struct.unpack("<Q", struct.pack("<d", moment + 0.0))
    # NumPy increments the counter before its first block.
    counter = (((part << 192) | (stream << 128) | (when << 64)) - 1) % (1 << 256)
    words = np.random.Philox(key=seed, counter=counter).random_raw(-(-count // 4) * 4)
    return np.asarray(words[:count], dtype=np.uint64)
