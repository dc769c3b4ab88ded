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
from coadjoint.files.configuration.construction import ConfigurationError, section
from coadjoint.files.configuration.error_collector import ErrorCollector
from coadjoint.files.configuration.initial_states import array_of_file
from coadjoint.files.configuration.swept_settings import SAMPLES, settings_group, settings_of
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short

if TYPE_CHECKING:
    from coadjoint.files.configuration.sweep_models import SweepTable

KeyPath = tuple[str | int, ...]

BYTES_PER_MEMBER = 200
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
        places = np.unravel_index(np.arange(self.members), [axis.length for axis in self.axes])
        return np.stack(places, axis=1).astype(np.int64)

    @cached_property
    def values(self) -> dict[str, list[Any]]:
        """Key -> its value for each member."""
        found: dict[str, list[Any]] = {}
        for axis, numbers in zip(self.axes, self.numbers.T.tolist(), strict=True):
            for place, settings in axis.settings.items():
                plain = settings.tolist() if isinstance(settings, np.ndarray) else settings
                found[place] = [plain[k] for k in numbers]
        return found

    def axes_of(self, chosen: Callable[[KeyPath], bool]) -> list[int]:
        """Return the numbers of the axes with a key that satisfies `chosen`."""
        return [k for k, axis in enumerate(self.axes) if any(chosen(parse_key(place)) for place in axis.settings)]

    def member_tables(self, member: int) -> dict[str, Any]:
        """Return the tables of one member; a state swept over an orbit stays as written."""
        changed = {place: values[member] for place, values in self.values.items() if place not in self.orbits}
        return replace_values(self.raw, changed, self.name)

    def each(self, axes: list[int], make: Callable[[int], Any]) -> list[Any]:
        """Return `make(member)` for every member, evaluated once for equal settings of the given axes."""
        made: dict[tuple[int, ...], Any] = {}
        found = []
        for member, numbers in enumerate(self.numbers[:, axes].tolist()):
            key = tuple(numbers)
            if key not in made:
                try:
                    made[key] = make(member)
                except ConfigurationError as reason:
                    raise ConfigurationError(f"{reason} (member {member} of the sweep)") from reason
            found.append(made[key])
        return found


def read_sweep(name: str, raw: Mapping[str, Any], sweep: SweepTable) -> Sweep:
    """Return the sweep of a file from its validated table, with random settings drawn and files read.

    `name` is the path of the file, from whose folder relative names begin. ConfigurationError: a key that cannot be
    swept, invalid settings, arrays of unequal lengths, or too many members.
    """
    axes: dict[str, dict[str, Any]] = {}
    wrong = ErrorCollector(name)
    _check_places(name, sweep.over, wrong)
    wrong.raise_collected()
    for place, table in sweep.over.items():
        with wrong.collect(), section(name, f"sweep.over.{place}"):
            written = _file_value(raw, parse_key(place))
            random = settings_group(place, table) == SAMPLES
            if isinstance(written, str):
                state = parse_key(place) == STATE_KEY and random
                written = array_of_file(Path(name).parent / written, written) if state else None
            if written is None and parse_key(place) == STATE_KEY and random:
                raise ValueError("initial.x is missing; give a state, which has the length of the random ones")
            if table.kind == "orbit" and parse_key(place) != STATE_KEY:
                raise ValueError("orbit applies to states only; give it for 'initial.x'")
            settings = settings_of(place, table, sweep, written, Path(name).parent)
            axes.setdefault(settings_group(place, table), {})[place] = settings
    wrong.raise_collected()
    found = tuple(Axis(settings, len(next(iter(settings.values())))) for settings in axes.values())
    members = math.prod(axis.length for axis in found)
    with section(name, "sweep.over"):
        check_available_memory(BYTES_PER_MEMBER * len(sweep.over) * members, f"a sweep of {short(members)} members")
    orbits = frozenset(place for place, table in sweep.over.items() if table.kind == "orbit")
    return Sweep(name, raw, found, orbits)


def parse_key(written: str) -> KeyPath:
    """Parse a key into names and indices.

    Examples
    --------
    >>> parse_key("system.parameters.inertia[2]")
    ('system', 'parameters', 'inertia', 2)
    """
    found: list[str | int] = []
    for part in written.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise ValueError(
                f"{short(written)} is no key of a file; give one such as 'initial.x[0]' or "
                "'system.parameters.inertia[2]'"
            )
        found += [match[1], *(int(number) for number in re.findall(r"\d+", match[2]))]
    return tuple(found)


def _check_places(name: str, over: Iterable[str], wrong: ErrorCollector) -> None:
    places: dict[str, KeyPath] = {}
    for place in over:
        with wrong.collect(), section(name, f"sweep.over.{in_one_line(place, 60)}"):
            keys = parse_key(place)
            if not any(place.startswith((f"{root}.", f"{root}[")) for root in SWEPT_TABLES):
                raise ValueError(f"only keys within {', '.join(SWEPT_TABLES)} can be swept")
            if keys[:2] == ("initial", "attitude") or keys == ("initial", "kind"):
                raise ValueError(f"initial.{keys[1]} is the same for all members")
            for other, known in places.items():
                if known[: len(keys)] == keys[: len(known)]:
                    raise ValueError(f"{other} is swept too, and one contains the other")
            places[place] = keys


def _file_value(raw: Any, place: KeyPath) -> Any:
    """Return the value of the file at a key, or None."""
    found: Any = raw
    for key in place:
        try:
            found = found[key]
        except (KeyError, IndexError, TypeError):
            return None
    return found


def replace_values(raw: Mapping[str, Any], values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a copy of the tables of a file with other values at some keys; list entries must exist.

    Examples
    --------
    >>> replace_values({"initial": {"x": [1.0, 2.0]}}, {"initial.x[1]": 5.0}, "run.toml")
    {'initial': {'x': [1.0, 5.0]}}
    """
    found = {key: deepcopy(table) if key != "sweep" else table for key, table in raw.items()}
    for written, value in values.items():
        *outer, last = parse_key(written)
        with section(name, f"sweep.over.{written}"):
            table: Any = found
            for key in outer:
                table = _subtable(table, key)
            _check_there(table, last)
            table[last] = value
    return found


def _subtable(table: Any, key: str | int) -> Any:
    """Return a subtable, created if missing, or an entry of a list."""
    _check_there(table, key)
    return table.setdefault(key, {}) if isinstance(key, str) else table[key]


def _check_there(table: Any, key: str | int) -> None:
    if isinstance(key, str):
        if not isinstance(table, dict):
            raise ValueError(f"{key} is in no table of the file; write the table, and sweep over its keys")
    elif not isinstance(table, list) or key >= len(table):
        raise ValueError(f"the file has no entry {key} there; write all entries, and sweep over some")
