"""Tables of dipolar energies and their gradients, which the kernels compute by FFT on cells."""

from __future__ import annotations

import ctypes
import itertools
import math
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt

from coadjoint.kernels.library import kernels
from coadjoint.memory import check_available_memory
from coadjoint.systems.lattices.dipoles import DipolarFunction

LANES, ROWS = 8, 16  # waves side by side, and rows that are transformed together, in `source/matrices`


@dataclass(frozen=True, eq=False)
class PackedTensors:
    """Tensors as the kernels read them: the order of the three axes, and a bound of their norm."""

    given: npt.NDArray[np.complex128]
    axes: tuple[int, ...]
    norm: float
    numbers: npt.NDArray[np.float64]


_PACKED: WeakValueDictionary[int, PackedTensors] = WeakValueDictionary()
"""Those in use, which an energy and its gradient share, by the identity of the given tensors."""


def convolution_fields(function: DipolarFunction, factor: float) -> tuple[dict[str, Any], PackedTensors]:
    """Return the fields of the table of a multiple of a dipolar energy or its gradient, and its tensors."""
    cells, tensors = function.cells, _PACKED.get(id(function.tensors))
    sizes, padded = _of_three(cells.sizes), _of_three(cells.padded)
    if tensors is None:
        tensors = _packed(len(cells.sites), sizes, padded, function.tensors)
        _PACKED[id(function.tensors)] = tensors
    cell = 3 * len(cells.sites)
    steps = (cell * sizes[1] * sizes[2], cell * sizes[2], cell)
    order = list(tensors.axes)
    place = np.zeros(0, np.int64) if cells.occupied is None else np.ascontiguousarray(cells.occupied, np.int64)
    factors = np.zeros(0) if cells.factors is None else np.ascontiguousarray(cells.factors, np.float64)
    strength = factor * function.strength
    largest = 1.0 if cells.factors is None else float(np.max(factors**2, initial=0.0))
    fields = {
        "code": ctypes.cast(kernels().convolve_cells, ctypes.c_void_p).value,
        "norm": abs(strength) * largest * tensors.norm if function.order else 0.0,
        "summed": function.order == 0,
        "vectors": len(place) if cells.occupied is not None else math.prod(sizes) * len(cells.sites),
        "sites": len(cells.sites),
        "sizes": np.array(sizes, np.int64)[order],
        "padded": np.array(padded, np.int64)[order],
        "steps": np.array(steps, np.int64)[order],
        "placed": cells.occupied is not None,
        "place": place,
        "scaled": cells.factors is not None,
        "factor": factors,
        "strength": strength,
        "tensors": tensors.numbers,
    }
    return fields, tensors


def _of_three(lengths: tuple[int, ...]) -> tuple[int, ...]:
    return (1,) * (3 - len(lengths)) + tuple(lengths)


def _packed(
    sites: int, sizes: tuple[int, ...], padded: tuple[int, ...], given: npt.NDArray[np.complex128]
) -> PackedTensors:
    """Return the upper triangles for eight waves side by side, of the first half of the waves of the last axis."""
    axes = min(itertools.permutations(range(3)), key=lambda one: _work(3 * sites, sizes, padded, one))
    a, b, c = (padded[axis] for axis in axes)
    groups, several = c // 2 // LANES + 1, sites > 1
    pairs = list(itertools.combinations_with_replacement(range(3 * sites), 2))
    entries = len(pairs) * (2 if several else 1)
    needed = 8 * LANES * groups * a * b * (entries + 6 * sites) + 64 * math.prod(padded)
    check_available_memory(needed, "dipolar tensors of all pairs of sites of cells, for the kernels")
    numbers = np.zeros((b, groups, a, entries, LANES))
    # The inverse transform is divided by the number of waves, and the two rows that are transformed as one by two.
    scale = 0.5 / math.prod(padded)
    for entry, (i, j) in enumerate(pairs):
        whole = _all_waves(given[i // 3, j // 3, i % 3, j % 3].reshape(*padded[:2], -1), padded)
        half = scale * whole.transpose(axes)[..., : c // 2 + 1]
        half = np.pad(half, ((0, 0), (0, 0), (0, groups * LANES - half.shape[2])))
        in_groups = half.reshape(a, b, groups, LANES).transpose(1, 2, 0, 3)
        if several:
            numbers[..., 2 * entry, :] = in_groups.real
            numbers[..., 2 * entry + 1, :] = 0.0 if i == j else in_groups.imag
        else:  # a lattice is its own inversion
            numbers[..., entry, :] = in_groups.real
    squares = np.sum(given.real**2 + given.imag**2, axis=(0, 1, 2, 3))
    mantissa, exponent = math.frexp(math.sqrt(float(squares.max())))
    return PackedTensors(given, axes, math.ldexp(math.ceil(16 * mantissa) / 16, exponent), numbers)


def _all_waves(half: npt.NDArray[np.complex128], padded: tuple[int, ...]) -> npt.NDArray[np.complex128]:
    """Return all waves of real numbers from those of the first half of the last axis."""
    waves = np.empty(padded, dtype=np.complex128)
    count = half.shape[2]
    waves[..., :count] = half
    first, second = (-np.arange(length) % length for length in padded[:2])
    last = padded[2] - np.arange(count, padded[2])
    waves[..., count:] = np.conj(half[np.ix_(first, second, last)])
    return waves


def _work(fields: int, sizes: tuple[int, ...], padded: tuple[int, ...], axes: tuple[int, ...]) -> int:
    """Return about how many numbers are transformed and moved, of axes in this order."""
    (a, b, _), (long_a, long_b, long_c) = ([lengths[axis] for axis in axes] for lengths in (sizes, padded))
    groups = long_c // 2 // LANES + 1
    rows = -(-b * fields // ROWS) * LANES
    return a * rows * long_c * (3 + long_c.bit_length()) + fields * groups * LANES * long_b * (
        a * (3 + long_b.bit_length()) + long_a * (3 + long_a.bit_length())
    )
