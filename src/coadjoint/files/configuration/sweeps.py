"""Sweeps of configuration files: members are copies of the file with other values at some keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import ConfigurationError
from coadjoint.files.configuration.models import (
    DISTRIBUTIONS,
    STATE_KEY,
    File,
    SweepTable,
    array_of_file,
    parse_key,
    section,
    system_of_file,
    validate,
)
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forces.base import normal_deviates, random_words
from coadjoint.systems.forces.orbit_flow import bracket_of
from coadjoint.validation import is_integer, is_real, read_finite, read_number

BYTES_PER_MEMBER = 200  # settings and state of a member, for each key; measured, with a margin
BYTES_PER_SETTING = 64  # a number as a Python object in lists; measured, with a margin
BYTES_PER_SYSTEM = 4000  # a system of its own for a member; measured, with a margin
MAX_EXPONENT = 400  # of a group element, whose series needs a substep for each unit


@dataclass(frozen=True)
class SettingsSweep:
    """Members of a configuration file: the tables of the file with other values at some keys.

    `values` has the value of each key for each member. Those of `orbits` are elements of the algebra that move the
    state in the file.
    """

    name: str
    raw: Mapping[str, Any]
    values: Mapping[str, Sequence[Any]]
    orbits: Sequence[str] = ()

    def file(self, member: int, only: str = "") -> File:
        """Return the validated tables of one member, or one of them; a state on an orbit stays as written."""
        tables = {key: deepcopy(table) for key, table in self.raw.items() if only in ("", key)}
        for key, values in self.values.items():
            path = parse_key(key)
            if key not in self.orbits and only in ("", path[0]):
                with section(self.name, f"sweep.over.{key}"):
                    _replace(tables, path, values[member])
        return validate(self.name, tables, only)

    def each(self, keys: Sequence[str], function: Callable[[int], Any]) -> list[Any]:
        """Return `function(member)` for every member, evaluated once for equal values of these keys."""
        results: dict[str, Any] = {}
        count = len(next(iter(self.values.values())))
        members = [repr([self.values[key][member] for key in keys]) for member in range(count)]
        for member, values in enumerate(members):
            if values not in results:
                try:
                    results[values] = function(member)
                except ConfigurationError as reason:
                    raise ConfigurationError(f"{reason} (member {member} of the sweep)") from reason
        return [results[values] for values in members]

    def system(self, file: File) -> Any:
        """Return the common system of all members, or a `Batch` if the sweep changes it; `file` is the first one."""
        keys = [key for key in self.values if not key.startswith("initial")]
        if not keys:
            return system_of_file(self.name, file)
        systems = self.each(keys, lambda member: system_of_file(self.name, self.file(member)))
        with section(self.name, "sweep.over"):
            return Batch(systems)

    def states(self, system: Any) -> Any:
        """Return the initial states of the members, (members, ...), as `integrate` takes them."""
        folder = Path(self.name).parent

        def state_of(member: int) -> Any:
            initial, own = self.file(member, "initial").initial, system.of_member(member)
            with section(self.name, "initial"):
                state = np.asarray(initial.state(own, folder))
                if not momenta_of(own, state)[1]:
                    raise ValueError(f"x0 has the shape {state.shape}, already an ensemble; sweep over one state")
                for key in self.orbits:
                    state = _move_on_orbit(own, state.astype(np.float64), np.array(self.values[key][member]))
            return state

        # Named states and orbits depend on the system.
        of_system = self.orbits or "kind" in self.raw.get("initial", ())
        states = self.each([key for key in self.values if of_system or key.startswith("initial")], state_of)
        with section(self.name, "initial"):
            return np.stack(states)


def _replace(tables: Any, path: Sequence[str | int], value: Any) -> None:
    """Set the value at a key; tables within tables are created, and entries of lists must exist."""
    try:
        for key in path[:-1]:
            tables = tables[key] if isinstance(key, int) else tables.setdefault(key, {})
        if isinstance(path[-1], int):
            tables[path[-1]]
        tables[path[-1]] = value
    except (LookupError, TypeError, AttributeError):
        raise ValueError(f"the file has no entry {path[-1]} here; write all entries, and sweep over some") from None


def read_sweep(name: str, raw: Mapping[str, Any], sweep: SweepTable) -> SettingsSweep:
    """Return the sweep of a file from its validated table, with random settings drawn and files read."""
    settings: dict[str, Sequence[Any]] = {}
    groups: dict[str, str] = {}
    for key, table in sweep.over.items():
        with section(name, f"sweep.over.{key}"):
            # Random keys are set together, and so are the columns of a file.
            groups[key] = "samples" if table.kind in DISTRIBUTIONS else f"file {table.file}" if table.file else key
            settings[key] = _settings_of(key, sweep, raw, Path(name).parent)
    lengths = {group: len(settings[key]) for key, group in groups.items()}
    with section(name, "sweep.over"):
        members, changes_system = math.prod(lengths.values()), any(not key.startswith("initial") for key in groups)
        needed = BYTES_PER_SYSTEM if changes_system else BYTES_PER_MEMBER
        check_available_memory(needed * len(groups) * members, f"a sweep of {short(members)} members")
    numbers = dict(zip(lengths, np.unravel_index(np.arange(members), tuple(lengths.values())), strict=True))
    values = {key: [settings[key][k] for k in numbers[group].tolist()] for key, group in groups.items()}
    return SettingsSweep(name, raw, values, [key for key in groups if sweep.over[key].kind == "orbit"])


def _settings_of(key: str, sweep: SweepTable, raw: Mapping[str, Any], folder: Path) -> list[Any]:
    """Return the settings of a key; its value in the file has their shape."""
    table = sweep.over[key]
    if table.values is not None:
        return table.values
    if table.file is not None:
        return list(_read_rows(table.file, table.column, folder).tolist())
    count, value = table.count or sweep.samples or 0, None
    if table.count is None:
        value = _value_at(raw, key)
        if key == STATE_KEY and value is None:
            raise ValueError("initial.x is missing; give a state, which has the length of the random ones")
        if key == STATE_KEY and isinstance(value, str):
            value = array_of_file(folder / value, value)
    shape = () if value is None else np.shape(read_finite(value, "what the file has here"))
    check_available_memory(BYTES_PER_SETTING * count * math.prod(shape), f"{short(count)} settings")
    if table.count is not None:
        return _grid(table.kind, getattr(table, table.kind), count)
    assert sweep.seed is not None
    return list(random_settings(table.kind, getattr(table, table.kind), key, sweep.seed, count, shape).tolist())


def _value_at(raw: Any, key: str) -> Any:
    try:
        for part in parse_key(key):
            raw = raw[part]
    except (LookupError, TypeError):
        return None
    return raw


def _grid(kind: str, ends: list[Any], count: int) -> list[float] | list[int]:
    first, last = (read_number(end, kind) for end in ends)
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


def _move_on_orbit(system: Any, x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exp(K) x, K y = J(y) u, the motion of H = u.y for the time 1."""
    if not system.has_structure_constants:
        raise ValueError(f"{system.name} has no structure constants, and no orbits; sweep over values")
    bracket = bracket_of(system.algebra, 1)
    norm = np.abs(bracket.generator(u)).sum(axis=0).max(initial=0.0)
    if norm > MAX_EXPONENT:
        raise ValueError(f"orbit moves a state by exponents of size {norm:.3g}; give less than {MAX_EXPONENT}")
    return bracket.exponential(u, x)
