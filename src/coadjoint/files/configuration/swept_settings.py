"""Settings of the keys of a sweep: listed values, grids, random numbers, rows of an array."""

from __future__ import annotations

import math
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.configuration.initial_states import array_of_file
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import normal_deviates, random_words
from coadjoint.validation import is_real, read_finite, read_number

if TYPE_CHECKING:
    from coadjoint.files.configuration.sweep_models import SettingsTable, SweepTable

BYTES_PER_SETTING = 64  # a number as a Python object in lists; measured, with a margin
SAMPLES = "samples"
MAX_TERMS = 400
"""Limit on the terms of the series of a group element; each factor converges long before."""


def settings_group(key: str, settings: SettingsTable) -> str:
    """Return the group of a key: all random keys, all columns of a file, or the key alone."""
    if settings.file is not None:
        return f"file {settings.file}"
    return SAMPLES if settings.kind in ("uniform", "normal", "sphere", "orbit") else f"key {key}"


def settings_of(key: str, settings: SettingsTable, sweep: SweepTable, value: Any, folder: Path) -> Any:
    """Return the settings of a key: a list, or an array with the settings along its first axis.

    `value` is the value in the file, which defines the shape of random numbers, or None; relative names of files
    begin at `folder`. Settings of an orbit are elements of the algebra that move the given state, (samples, n).
    """
    kind = settings.kind
    if settings.values is not None:
        return settings.values
    if settings.file is not None:
        return _read_rows(settings.file, settings.column, folder)
    if kind in ("linear", "logarithmic"):
        assert settings.count is not None
        check_available_memory(BYTES_PER_SETTING * settings.count, f"a grid of {short(settings.count)} values")
        return _grid(kind, getattr(settings, kind), settings.count)
    assert sweep.samples is not None and sweep.seed is not None
    shape = np.shape(read_finite(value, "what the file has here")) if value is not None else ()
    check_available_memory(BYTES_PER_SETTING * sweep.samples * math.prod(shape), f"{short(sweep.samples)} samples")
    return random_settings(kind, getattr(settings, kind), key, sweep.seed, sweep.samples, shape)


def _grid(kind: str, ends: list[Any], count: int) -> list[float] | list[int]:
    first, last = (read_number(end, kind) for end in ends)
    if count == 1:
        raise ValueError(f"count is 1, and a grid has the two ends {ends}; give a list of one value")
    if all(isinstance(end, int) for end in ends) and kind == "linear" and (ends[1] - ends[0]) % (count - 1) == 0:
        return [ends[0] + k * ((ends[1] - ends[0]) // (count - 1)) for k in range(count)]
    fractions = [k / (count - 1) for k in range(count)]
    if kind == "linear":
        return [first + (last - first) * part for part in fractions[:-1]] + [last]
    if not first * last > 0.0:
        raise ValueError(f"logarithmic is {ends}; both ends must be different from zero, and of one sign")
    return [first] + [first * (last / first) ** part for part in fractions[1:-1]] + [last]


def _read_rows(file_name: str, column: int | None, folder: Path) -> NDArray[Any]:
    values = array_of_file(folder / file_name, file_name)
    if values.ndim == 0 or not len(values):
        raise ValueError(
            f"{short(file_name)} holds an array of shape {values.shape}; its first axis must be the settings"
        )
    if column is None:
        return values
    if values.ndim != 2 or column >= values.shape[1]:
        raise ValueError(f"{short(file_name)} holds an array of shape {values.shape}, which has no column {column}")
    return np.ascontiguousarray(values[:, column])


def random_settings(
    kind: str, spread: Any, key: str, seed: int, samples: int, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Return random settings, (samples, ...), each a function of the seed, the key and the sample number alone.

    `spread` holds both ends (uniform), mean and standard deviation (normal), the radius (sphere), or the standard
    deviation of the components of an element of the algebra (orbit). Settings of different keys are independent.

    Examples
    --------
    >>> few = random_settings("uniform", [2.0, 3.0], "initial.x", 7, 2, (3,))
    >>> bool((few == random_settings("uniform", [2.0, 3.0], "initial.x", 7, 5, (3,))[:2]).all())
    True
    """
    count, stream = math.prod(shape), int.from_bytes(sha256(key.encode()).digest()[:7], "little")
    if kind == "uniform":
        words = np.stack([random_words(seed, stream, float(s), 0, count) for s in range(samples)])
        first, last = _number_pair(spread, "an end", shape)
        fractions = (words >> np.uint64(11)).astype(np.float64).reshape(samples, *shape) * 2.0**-53
        return np.asarray(first + (last - first) * fractions)
    deviates = np.stack([normal_deviates(seed, stream, float(s), 0, count) for s in range(samples)])
    deviates = deviates.reshape(samples, *shape)
    if kind == "normal":
        mean, deviation = _number_pair(spread, "mean or deviation", shape)
        return np.asarray(mean + deviation * deviates)
    if len(shape) != 1:
        raise ValueError(f"{kind} applies to states that are vectors; the value in the file has the shape {shape}")
    if kind == "orbit":
        return np.asarray(spread * deviates)
    lengths = np.array([math.hypot(*row) for row in deviates.tolist()])
    return np.asarray(spread * (deviates / lengths[:, None]))


def _number_pair(values: list[Any], what: str, shape: tuple[int, ...]) -> tuple[Any, Any]:
    """Return two numbers, or two arrays of the shape of a setting."""
    pair = []
    for value in values:
        numbers = read_number(value, what) if is_real(value) else read_finite(value, what)
        if np.shape(numbers) not in ((), shape):
            raise ValueError(f"{what} has the shape {np.shape(numbers)}; the value in the file has the shape {shape}")
        pair.append(numbers)
    return pair[0], pair[1]


def move_on_orbit(algebra: Any, x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exp(K) x on the same coadjoint orbit, K y = J(y) u: the motion of H = u.y for the time 1.

    The series is summed in index order, in pieces of the exponent short enough to converge quickly.

    Examples
    --------
    >>> import coadjoint as co
    >>> turned = move_on_orbit(co.algebras.so(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, np.pi / 2]))
    >>> bool(np.allclose(abs(turned), [0.0, 1.0, 0.0]))
    True
    """
    i, j, k, c = algebra.triples
    n, y = len(x), np.array(x)

    def action(z: NDArray[np.float64]) -> NDArray[np.float64]:
        entries = c * z[k]
        return np.asarray(np.bincount(i, entries * u[j], n) - np.bincount(j, entries * u[i], n), dtype=np.float64)

    norm = float(np.bincount(i, abs(c * u[j]), n).max(initial=0.0) + np.bincount(j, abs(c * u[i]), n).max(initial=0.0))
    pieces = max(1, math.ceil(norm))
    if pieces > MAX_TERMS:
        raise ValueError(f"orbit moves a state by exponents of size {norm:.3g}; give less than {MAX_TERMS}")
    for _ in range(pieces):
        term, order = y, 1
        while order < MAX_TERMS and np.any(term):
            term = action(term) / (order * pieces)
            if np.all(y + term == y):
                break
            y, order = y + term, order + 1
    return y
