"""Sweeps of configuration files: members are copies of the file with other values at some keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import ConfigurationError, in_one_line
from coadjoint.files.configuration.construction import (
    ErrorCollector,
    array_of_file,
    initial_state,
    section,
    state_by_name,
    system_of_file,
)
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forces.base import normal_deviates, random_words
from coadjoint.validation import is_integer, is_real, read_finite, read_number

if TYPE_CHECKING:
    from coadjoint.files.configuration.models import File, SettingsTable, SweepTable

KeyPath = tuple[str | int, ...]

BYTES_PER_MEMBER = 200  # settings and state of a member; measured, with a margin
STATE_KEY: KeyPath = ("initial", "x")
_PART = re.compile(r"([A-Za-z_][\w-]*)((?:\[\d{1,9}\])*)")
SWEPT_TABLES = ("system.parameters", "algebra.parameters", "hamiltonian", "forces", "initial")

BYTES_PER_SETTING = 64  # a number as a Python object in lists; measured, with a margin
SAMPLES = "samples"
MAX_TERMS = 400
"""Limit on the terms of the series of a group element; each factor converges long before."""


@dataclass(frozen=True)
class SettingsSweep:
    """Members of a configuration file: all combinations of the settings of its axes, the last axis the fastest.

    An axis has keys that are set together: key -> settings, all of one length.
    """

    name: str
    raw: Mapping[str, Any]
    axes: tuple[Mapping[str, Any], ...]
    orbits: frozenset[str] = frozenset()

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of settings of each axis."""
        return tuple(len(next(iter(axis.values()))) for axis in self.axes)

    @property
    def members(self) -> int:
        """Number of members."""
        return math.prod(self.lengths)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Setting of each axis for each member, (members, axes)."""
        indices = np.unravel_index(np.arange(self.members), self.lengths)
        return np.stack(indices, axis=1).astype(np.int64)

    @cached_property
    def values(self) -> dict[str, list[Any]]:
        """Key -> its value for each member."""
        values: dict[str, list[Any]] = {}
        for axis, numbers in zip(self.axes, self.numbers.T.tolist(), strict=True):
            for key, settings in axis.items():
                settings_list = settings.tolist() if isinstance(settings, np.ndarray) else settings
                values[key] = [settings_list[k] for k in numbers]
        return values

    def member_tables(self, member: int) -> dict[str, Any]:
        """Return the tables of one member; a state swept over an orbit stays as written."""
        changed = {key: values[member] for key, values in self.values.items() if key not in self.orbits}
        return replace_values(self.raw, changed, self.name)

    def each(self, axes: list[int], function: Callable[[int], Any]) -> list[Any]:
        """Return `function(member)` for every member, evaluated once for equal settings of the given axes."""
        results: dict[tuple[int, ...], Any] = {}
        values = []
        for member, numbers in enumerate(self.numbers[:, axes].tolist()):
            key = tuple(numbers)
            if key not in results:
                try:
                    results[key] = function(member)
                except ConfigurationError as reason:
                    raise ConfigurationError(f"{reason} (member {member} of the sweep)") from reason
            values.append(results[key])
        return values


def read_sweep(name: str, raw: Mapping[str, Any], sweep: SweepTable) -> SettingsSweep:
    """Return the sweep of a file from its validated table, with random settings drawn and files read."""
    axes: dict[str, dict[str, Any]] = {}
    errors = ErrorCollector(name)
    _check_keys(name, sweep.over, errors)
    errors.raise_collected()
    for key, table in sweep.over.items():
        with errors.collect(), section(name, f"sweep.over.{key}"):
            value = _file_value(raw, parse_key(key))
            is_random = settings_group(key, table) == SAMPLES
            if isinstance(value, str):
                state = parse_key(key) == STATE_KEY and is_random
                value = array_of_file(Path(name).parent / value, value) if state else None
            if value is None and parse_key(key) == STATE_KEY and is_random:
                raise ValueError("initial.x is missing; give a state, which has the length of the random ones")
            if table.kind == "orbit" and parse_key(key) != STATE_KEY:
                raise ValueError("orbit applies to states only; give it for 'initial.x'")
            settings = settings_of(key, table, sweep, value, Path(name).parent)
            axes.setdefault(settings_group(key, table), {})[key] = settings
    errors.raise_collected()
    orbits = frozenset(key for key, table in sweep.over.items() if table.kind == "orbit")
    found = SettingsSweep(name, raw, tuple(axes.values()), orbits)
    with section(name, "sweep.over"):
        needed = BYTES_PER_MEMBER * len(sweep.over) * found.members
        check_available_memory(needed, f"a sweep of {short(found.members)} members")
    return found


def parse_key(text: str) -> KeyPath:
    """Parse a key into names and indices."""
    parts: list[str | int] = []
    for part in text.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise ValueError(
                f"{short(text)} is no key of a file; give one such as 'initial.x[0]' or 'system.parameters.inertia[2]'"
            )
        parts += [match[1], *(int(number) for number in re.findall(r"\d+", match[2]))]
    return tuple(parts)


def _check_keys(name: str, over: Iterable[str], errors: ErrorCollector) -> None:
    paths: dict[str, KeyPath] = {}
    for key in over:
        with errors.collect(), section(name, f"sweep.over.{in_one_line(key, 60)}"):
            path = parse_key(key)
            if not any(key.startswith((f"{root}.", f"{root}[")) for root in SWEPT_TABLES):
                raise ValueError(f"only keys within {', '.join(SWEPT_TABLES)} can be swept")
            if path[:2] == ("initial", "attitude") or path == ("initial", "kind"):
                raise ValueError(f"initial.{path[1]} is the same for all members")
            for other, other_path in paths.items():
                if other_path[: len(path)] == path[: len(other_path)]:
                    raise ValueError(f"{other} is swept too, and one contains the other")
            paths[key] = path


def _file_value(raw: Any, path: KeyPath) -> Any:
    """Return the value of the file at a key, or None."""
    value: Any = raw
    for key in path:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def replace_values(raw: Mapping[str, Any], values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a copy of the tables of a file with other values at some keys; list entries must exist."""
    tables = {key: deepcopy(table) if key != "sweep" else table for key, table in raw.items()}
    for key_text, value in values.items():
        *outer, last = parse_key(key_text)
        with section(name, f"sweep.over.{key_text}"):
            table: Any = tables
            for key in outer:
                _check_key_exists(table, key)
                table = table.setdefault(key, {}) if isinstance(key, str) else table[key]
            _check_key_exists(table, last)
            table[last] = value
    return tables


def _check_key_exists(table: Any, key: str | int) -> None:
    if isinstance(key, str):
        if not isinstance(table, dict):
            raise ValueError(f"{key} is in no table of the file; write the table, and sweep over its keys")
    elif not isinstance(table, list) or key >= len(table):
        raise ValueError(f"the list in the file has no entry {key}; write all entries, and sweep over some")


def swept_system(sweep: SettingsSweep, file: File, check_tables: Callable[[dict[str, Any]], File]) -> Any:
    """Return the common system of all members, or a `Batch` if the sweep changes it; `file` is the first one."""
    axes = [k for k, axis in enumerate(sweep.axes) if any(parse_key(key)[0] != "initial" for key in axis)]
    if not axes:
        return system_of_file(sweep.name, file)
    systems = sweep.each(axes, lambda member: system_of_file(sweep.name, check_tables(sweep.member_tables(member))))
    with section(sweep.name, "sweep.over"):
        return Batch(systems)


def swept_states(sweep: SettingsSweep, file: File, system: Any, check_tables: Callable[[dict[str, Any]], File]) -> Any:
    """Return the initial states of the members, (members, ...), as `integrate` takes them."""
    name = sweep.name
    systems = [system.of_member(m) for m in range(sweep.members)]
    if file.initial.kind is not None:
        return np.stack(
            sweep.each(
                list(range(len(sweep.axes))),
                lambda member: state_by_name(name, check_tables(sweep.member_tables(member)).initial, systems[member]),
            )
        )
    with section(name, "initial.x"):
        base = np.asarray(initial_state(systems[0], file.initial.x, Path(name).parent))
        if not momenta_of(systems[0], base)[1]:
            raise ValueError(
                f"x0 has the shape {base.shape}, already an ensemble; give one state, and sweep over 'initial.x'"
            )
    states = np.repeat(base[None] if base.dtype.kind == "c" else base[None].astype(np.float64), sweep.members, axis=0)
    for axis, numbers in zip(sweep.axes, sweep.numbers.T, strict=True):
        for key, settings in axis.items():
            if parse_key(key)[:2] != STATE_KEY:
                continue
            with section(name, f"sweep.over.{key}"):
                _set_states(states, key, settings, numbers, systems, key in sweep.orbits)
    return states


def _set_states(states: Any, key: str, settings: Any, numbers: Any, systems: list[Any], orbit: bool) -> None:
    """Set a key of the states of all members."""
    path = parse_key(key)
    if orbit:
        for member, system in enumerate(systems):
            if not system.has_structure_constants:
                raise ValueError(f"{system.name} has no algebra with structure constants; sweep over values instead")
            states[member] = move_on_orbit(system.algebra, states[member], settings[numbers[member]])
        return
    values = initial_state(systems[0], settings, Path()) if path == STATE_KEY else settings
    array = np.asarray(values)
    if array.dtype.kind not in "iufc" or array.shape[1:] != states[(0, *path[2:])].shape:
        raise ValueError(f"each setting must be of shape {states[(0, *path[2:])].shape}, of numbers")
    states[(slice(None), *path[2:])] = array[numbers]


def settings_group(key: str, settings: SettingsTable) -> str:
    """Return the group of a key: all random keys, all columns of a file, or the key alone."""
    if settings.file is not None:
        return f"file {settings.file}"
    return SAMPLES if settings.kind in ("uniform", "normal", "sphere", "orbit") else f"key {key}"


def settings_of(key: str, settings: SettingsTable, sweep: SweepTable, value: Any, folder: Path) -> Any:
    """Return the settings of a key, as a list or along the first axis; `value`, in the file, has the shape."""
    kind = settings.kind
    if settings.values is not None:
        return settings.values
    if settings.file is not None:
        return _read_rows(settings.file, settings.column, folder)
    is_grid = kind in ("linear", "logarithmic")
    shape = () if is_grid or value is None else np.shape(read_finite(value, "what the file has here"))
    count = (settings.count if is_grid else sweep.samples) or 0
    check_available_memory(BYTES_PER_SETTING * count * math.prod(shape), f"a sweep of {short(count)} values")
    if is_grid:
        assert settings.count is not None
        return _grid(kind, getattr(settings, kind), settings.count)
    assert sweep.samples is not None and sweep.seed is not None
    return random_settings(kind, getattr(settings, kind), key, sweep.seed, sweep.samples, shape)


def _grid(kind: str, ends: list[Any], count: int) -> list[float] | list[int]:
    first, last = (read_number(end, kind) for end in ends)
    if count == 1:
        raise ValueError(f"count is 1, and a grid has the two ends {ends}; give a list of one value")
    if all(map(is_integer, ends)) and kind == "linear" and (ends[1] - ends[0]) % (count - 1) == 0:
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
    """Return random settings, (samples, ...), each a function of seed, key and sample number alone."""
    count, stream = math.prod(shape), int.from_bytes(sha256(key.encode()).digest()[:7], "little")
    if kind == "uniform":
        words = np.stack([random_words(seed, stream, float(s), 0, count) for s in range(samples)])
        first, last = _number_pair(spread, "an end", shape)
        with np.errstate(over="ignore"):
            if not np.all((first <= last) & np.isfinite(np.subtract(last, first))):
                raise ValueError(f"uniform is {short(spread)}; give the smaller end first, at a distance in float64")
        fractions = (words >> np.uint64(11)).astype(np.float64).reshape(samples, *shape) * 2.0**-53
        # A sum may be rounded up to the end, which is excluded.
        below = np.where(first < last, np.nextafter(last, first), first)
        return np.asarray(np.minimum(first + (last - first) * fractions, below))
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
    """Return exp(K) x, K y = J(y) u, the motion of H = u.y for the time 1, by a series in index order."""
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
