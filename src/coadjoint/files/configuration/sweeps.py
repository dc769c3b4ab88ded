"""Sweeps of configuration files: members are copies of the file with other values at some keys."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.files.configuration.construction import ConfigurationError, ErrorCollector, section, system_of_file
from coadjoint.files.configuration.initial_states import array_of_file, initial_state, state_by_name
from coadjoint.files.configuration.swept_settings import SAMPLES, move_on_orbit, settings_group, settings_of
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch

if TYPE_CHECKING:
    from collections.abc import Callable

    from coadjoint.files.configuration.models import File
    from coadjoint.files.configuration.sweep_models import SweepTable

KeyPath = tuple[str | int, ...]

BYTES_PER_MEMBER = 200  # settings and state of a member; measured, with a margin
STATE_KEY: KeyPath = ("initial", "x")
_PART = re.compile(r"([A-Za-z_][\w-]*)((?:\[\d{1,9}\])*)")
SWEPT_TABLES = ("system.parameters", "algebra.parameters", "hamiltonian", "forces", "initial")


@dataclass(frozen=True)
class Axis:
    """Keys that are set together: key -> settings, all of one length."""

    settings: Mapping[str, Any]
    length: int


@dataclass(frozen=True)
class Sweep:
    """Members of a configuration file: all combinations of the settings of its axes, the last axis the fastest.

    `raw` holds the tables of the file, not validated; `axes` are in the order of their first keys; `orbits` are the
    keys whose settings are elements of the algebra that move the given state.
    """

    name: str
    raw: Mapping[str, Any]
    axes: tuple[Axis, ...]
    orbits: frozenset[str] = frozenset()

    @property
    def members(self) -> int:
        """Number of members."""
        return math.prod(axis.length for axis in self.axes)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Setting of each axis for each member, (members, axes)."""
        indices = np.unravel_index(np.arange(self.members), [axis.length for axis in self.axes])
        return np.stack(indices, axis=1).astype(np.int64)

    @cached_property
    def values(self) -> dict[str, list[Any]]:
        """Key -> its value for each member."""
        values: dict[str, list[Any]] = {}
        for axis, numbers in zip(self.axes, self.numbers.T.tolist(), strict=True):
            for key, settings in axis.settings.items():
                settings_list = settings.tolist() if isinstance(settings, np.ndarray) else settings
                values[key] = [settings_list[k] for k in numbers]
        return values

    def axes_of(self, chosen: Callable[[KeyPath], bool]) -> list[int]:
        """Return the numbers of the axes with a key that satisfies `chosen`."""
        return [k for k, axis in enumerate(self.axes) if any(chosen(parse_key(key)) for key in axis.settings)]

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


def read_sweep(name: str, raw: Mapping[str, Any], sweep: SweepTable) -> Sweep:
    """Return the sweep of a file from its validated table, with random settings drawn and files read.

    `name` is the path of the file, from whose folder relative names begin. ConfigurationError: a key that cannot be
    swept, invalid settings, arrays of unequal lengths, or too many members.
    """
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
    sweep_axes = tuple(Axis(settings, len(next(iter(settings.values())))) for settings in axes.values())
    members = math.prod(axis.length for axis in sweep_axes)
    with section(name, "sweep.over"):
        check_available_memory(BYTES_PER_MEMBER * len(sweep.over) * members, f"a sweep of {short(members)} members")
    orbits = frozenset(key for key, table in sweep.over.items() if table.kind == "orbit")
    return Sweep(name, raw, sweep_axes, orbits)


def parse_key(text: str) -> KeyPath:
    """Parse a key into names and indices.

    Examples
    --------
    >>> parse_key("system.parameters.inertia[2]")
    ('system', 'parameters', 'inertia', 2)
    """
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
    """Return a copy of the tables of a file with other values at some keys; list entries must exist.

    Examples
    --------
    >>> replace_values({"initial": {"x": [1.0, 2.0]}}, {"initial.x[1]": 5.0}, "run.toml")
    {'initial': {'x': [1.0, 5.0]}}
    """
    tables = {key: deepcopy(table) if key != "sweep" else table for key, table in raw.items()}
    for key_text, value in values.items():
        *outer, last = parse_key(key_text)
        with section(name, f"sweep.over.{key_text}"):
            table: Any = tables
            for key in outer:
                table = _subtable(table, key)
            _check_key_exists(table, last)
            table[last] = value
    return tables


def _subtable(table: Any, key: str | int) -> Any:
    """Return a subtable, created if missing, or an entry of a list."""
    _check_key_exists(table, key)
    return table.setdefault(key, {}) if isinstance(key, str) else table[key]


def _check_key_exists(table: Any, key: str | int) -> None:
    if isinstance(key, str):
        if not isinstance(table, dict):
            raise ValueError(f"{key} is in no table of the file; write the table, and sweep over its keys")
    elif not isinstance(table, list) or key >= len(table):
        raise ValueError(f"the list in the file has no entry {key}; write all entries, and sweep over some")


BYTES_PER_SYSTEM = 4000  # a system of its own for a member; measured, with a margin


def swept_system(sweep: Sweep, file: File, check_tables: Callable[[dict[str, Any]], File]) -> Any:
    """Return the common system of all members, or a `Batch` if the sweep changes it.

    `file` is the first member; `check_tables` validates the tables of a member.
    """
    axes = sweep.axes_of(_is_system_key)
    if not axes:
        return system_of_file(sweep.name, file)
    with section(sweep.name, "sweep.over"):
        check_available_memory(BYTES_PER_SYSTEM * sweep.members, f"a sweep of {sweep.members} systems")
    systems = sweep.each(axes, lambda member: system_of_file(sweep.name, check_tables(sweep.member_tables(member))))
    with section(sweep.name, "sweep.over"):
        return Batch(systems)


def _is_system_key(path: KeyPath) -> bool:
    return path[0] != "initial"


def swept_states(sweep: Sweep, file: File, system: Any, check_tables: Callable[[dict[str, Any]], File]) -> Any:
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
        check_available_memory(3 * base.nbytes * sweep.members, f"the states of {sweep.members} members")
    states = np.repeat(base[None] if base.dtype.kind == "c" else base[None].astype(np.float64), sweep.members, axis=0)
    for axis, numbers in zip(sweep.axes, sweep.numbers.T, strict=True):
        for key, settings in axis.settings.items():
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
