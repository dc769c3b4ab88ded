"""Sweeps of configuration files: members are copies of the file with other values at some keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import ConfigurationError
from coadjoint.files.configuration.models import DISTRIBUTIONS, File, SettingsTable, SweepTable
from coadjoint.files.configuration.parsing import Problems, parse_tables, section, system_of_file
from coadjoint.files.configuration.tables import array_of_file
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forces.base import normal_deviates, random_words
from coadjoint.validation import is_integer, is_real, read_finite, read_number

KeyPath = tuple[str | int, ...]

STATE_KEY = "initial.x"
_KEY = re.compile(r"[A-Za-z_][\w-]*(\[\d{1,9}\])*(\.[A-Za-z_][\w-]*(\[\d{1,9}\])*)*")
SWEPT_TABLES = ("system.parameters", "algebra.parameters", "hamiltonian", "forces", "initial")
BYTES_PER_MEMBER = 200  # settings and state of a member, for each key; measured, with a margin
BYTES_PER_SETTING = 64  # a number as a Python object in lists; measured, with a margin
BYTES_PER_SYSTEM = 4000  # a system of its own for a member; measured, with a margin
MAX_TERMS = 400
"""Limit on the terms of the series of a group element; each factor converges long before."""


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

    @property
    def members(self) -> int:
        """Number of members."""
        return len(next(iter(self.values.values())))

    def tables(self, member: int, *names: str) -> dict[str, Any]:
        """Return the tables of one member, or those with these names; a state on an orbit stays as written."""
        tables = {key: deepcopy(table) for key, table in self.raw.items() if not names or key in names}
        for key, values in self.values.items():
            path = parse_key(key)
            if key not in self.orbits and (not names or path[0] in names):
                with section(self.name, f"sweep.over.{key}"):
                    _replace(tables, path, values[member])
        return tables

    def file(self, member: int, *names: str) -> File:
        """Return the validated tables of one member, or those with these names."""
        problems = Problems(self.name)
        file = parse_tables(self.tables(member, *names), problems, names)
        problems.check()
        return file

    def each(self, keys: Iterable[str], function: Callable[[int], Any]) -> list[Any]:
        """Return `function(member)` for every member, evaluated once for equal values of these keys."""
        results: dict[str, Any] = {}
        members = [repr([self.values[key][member] for key in keys]) for member in range(self.members)]
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
                    if not own.has_structure_constants:
                        raise ValueError(f"{own.name} has no structure constants, and no orbits; sweep over values")
                    state = move_on_orbit(own.algebra, state.astype(np.float64), np.array(self.values[key][member]))
            return state

        # Named states and orbits depend on the system.
        of_system = self.orbits or "kind" in self.raw.get("initial", ())
        states = self.each([key for key in self.values if of_system or key.startswith("initial")], state_of)
        with section(self.name, "initial"):
            return np.stack(states)


def parse_key(text: str) -> KeyPath:
    """Return the names and indices of a key, such as 'initial.x[0]'."""
    if not _KEY.fullmatch(text):
        raise ValueError(
            f"{short(text)} is no key of a file; give one such as 'initial.x[0]' or 'system.parameters.inertia[2]'"
        )
    return tuple(int(part) if part.isdecimal() else part for part in re.findall(r"[\w-]+", text))


def _replace(tables: Any, path: KeyPath, value: Any) -> None:
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
    problems, folder = Problems(name), Path(name).parent
    lengths: dict[str, int] = {}
    groups: dict[str, str] = {}
    for key, table in sweep.over.items():
        with problems.at(f"sweep.over.{key}"):
            _check_key(key, table, sweep.over)
            # Random keys are set together, and so are the columns of a file.
            groups[key] = "samples" if table.kind in DISTRIBUTIONS else f"file {table.file}" if table.file else key
            listed = table.values or (() if table.file is None else _read_rows(table.file, table.column, folder))
            lengths[groups[key]] = len(listed) or table.count or sweep.samples or 0
    problems.check()
    with section(name, "sweep.over"):
        members, changes_system = math.prod(lengths.values()), any(not key.startswith("initial") for key in groups)
        needed = BYTES_PER_SYSTEM if changes_system else BYTES_PER_MEMBER
        check_available_memory(needed * len(groups) * members, f"a sweep of {short(members)} members")
    numbers = dict(zip(lengths, np.unravel_index(np.arange(members), tuple(lengths.values())), strict=True))
    values: dict[str, list[Any]] = {}
    for key, group in groups.items():
        with problems.at(f"sweep.over.{key}"):
            settings = _settings_of(key, sweep, raw, folder)
            settings = settings.tolist() if isinstance(settings, np.ndarray) else settings
            values[key] = [settings[k] for k in numbers[group].tolist()]
    problems.check()
    return SettingsSweep(name, raw, values, [key for key in groups if sweep.over[key].kind == "orbit"])


def _check_key(key: str, table: SettingsTable, others: Iterable[str]) -> None:
    path = parse_key(key)
    if not key.startswith(tuple(f"{root}{mark}" for root in SWEPT_TABLES for mark in ".[")):
        raise ValueError(f"only keys within {', '.join(SWEPT_TABLES)} can be swept")
    if path[:2] in (("initial", "attitude"), ("initial", "kind")):
        raise ValueError(f"{key} is the same for all members")
    if table.kind == "orbit" and key != STATE_KEY:
        raise ValueError("orbit applies to states only; give it for 'initial.x'")
    for other in others:
        if key.startswith((f"{other}.", f"{other}[")):
            raise ValueError(f"{other} is swept too, and contains it")


def _settings_of(key: str, sweep: SweepTable, raw: Mapping[str, Any], folder: Path) -> Any:
    """Return the settings of a key, as a list or along the first axis; its value in the file has their shape."""
    table = sweep.over[key]
    if table.values is not None:
        return table.values
    if table.file is not None:
        return _read_rows(table.file, table.column, folder)
    if table.count is not None:
        return _grid(table.kind, getattr(table, table.kind), table.count)
    assert sweep.samples is not None and sweep.seed is not None
    value: Any = raw
    try:
        for part in parse_key(key):
            value = value[part]
    except (LookupError, TypeError):
        value = None
    if key == STATE_KEY and value is None:
        raise ValueError("initial.x is missing; give a state, which has the length of the random ones")
    if key == STATE_KEY and isinstance(value, str):
        value = array_of_file(folder / value, value)
    shape = () if value is None else np.shape(read_finite(value, "what the file has here"))
    check_available_memory(BYTES_PER_SETTING * sweep.samples * math.prod(shape), f"{short(sweep.samples)} samples")
    return random_settings(table.kind, getattr(table, table.kind), key, sweep.seed, sweep.samples, shape)


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
