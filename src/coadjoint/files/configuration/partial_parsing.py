"""Partial parsing of invalid configuration files, so that all their errors can be reported together."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from coadjoint.errors import nearest
from coadjoint.methods import registry
from coadjoint.systems.registry import ready_made_systems

if TYPE_CHECKING:
    from pydantic import ValidationError

    from coadjoint.files.configuration.models import File

PLACEHOLDERS: Mapping[str, Any] = {"run": {"t_span": [0.0, 1.0], "step": 1.0}, "initial": {"x": "unread.npy"}}
"""Placeholders for required tables that are invalid; they are not validated."""
SYSTEM_TABLES = frozenset({"name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces"})


@dataclass(frozen=True)
class ValidTables:
    """The valid part of a file.

    `file` holds the tables, with misspelled keys under the nearest known name; `messages` the errors, with dotted keys;
    `invalid` the invalid top-level tables and keys, to be skipped.
    """

    file: File | None
    messages: tuple[str, ...] = ()
    invalid: frozenset[str] = frozenset()

    @property
    def has_system(self) -> bool:
        """Whether everything that defines the system is valid."""
        return not self.invalid & SYSTEM_TABLES

    def has(self, table: str) -> bool:
        """Whether a table is valid."""
        return table not in self.invalid


def valid_tables(raw: Mapping[str, Any]) -> ValidTables:
    """Return the valid part of the tables of a file, and the errors of the rest.

    Examples
    --------
    >>> found = valid_tables({"initial": {"x": [1.0]}, "run": {"t_span": [0, 1], "stpe": 0.1}, "method": {"name": 3}})
    >>> found.messages, found.file.run.step
    (("run.stpe: unknown key; did you mean 'step'?",), 0.1)
    """
    from pydantic import ValidationError

    from coadjoint.files.configuration.models import File, all_errors

    messages: list[str] = []
    invalid: set[str] = set()
    rest = _correct_parameter_names(raw, messages)
    file = None
    # As written; then with unknown keys corrected; then without invalid tables.
    for _ in range(3):
        try:
            file = File.model_validate(rest)
            break
        except ValidationError as error:
            messages += all_errors(error)
            rest, wrong = _repair(rest, error)
            invalid |= wrong
    return ValidTables(file, tuple(dict.fromkeys(messages)), frozenset(invalid))


def _correct_parameter_names(raw: Mapping[str, Any], messages: list[str]) -> Mapping[str, Any]:
    """Correct unknown parameter names of the system and of the scheme; append the errors to `messages`."""
    system, method = raw.get("system"), raw.get("method")
    known: dict[tuple[str, ...], Iterable[str]] = {}
    if isinstance(system, Mapping) and isinstance(name := system.get("name"), str) and name in ready_made_systems():
        known["system", "parameters"] = inspect.signature(ready_made_systems()[name]).parameters
    if isinstance(method, Mapping) and isinstance(name := method.get("name"), str) and name in registry.names():
        known["method",] = (*registry.parameters_of(name), "name", "parameters")
    from coadjoint.files.configuration.models import unknown_key

    for place, names in known.items():
        table = _at(raw, place)
        if not isinstance(table, Mapping):
            continue
        for key in [key for key in table if key not in names]:
            told = [name for name in names if place != ("method",) or name not in ("name", "parameters")]
            messages.append(f"{'.'.join(place)}.{key}: {unknown_key(key, told)}")
            raw = _rename_key(raw, (*place, key), names)
    return raw


def _repair(raw: Mapping[str, Any], error: ValidationError) -> tuple[Mapping[str, Any], set[str]]:
    """Correct unknown keys and replace invalid tables; return also the names of the latter."""
    from coadjoint.files.configuration.models import known_keys

    invalid: set[str] = set()
    for entry in error.errors():
        place = tuple(str(key) for key in entry["loc"])
        if entry["type"] == "extra_forbidden":
            raw = _rename_key(raw, place, known_keys(place[:-1]))
        elif place:
            invalid.add(place[0])
    kept = {key: value for key, value in raw.items() if key not in invalid}
    return {**kept, **{key: PLACEHOLDERS[key] for key in invalid if key in PLACEHOLDERS}}, invalid


def _at(raw: Any, place: Iterable[str]) -> Any:
    for key in place:
        raw = raw.get(key) if isinstance(raw, Mapping) else None
    return raw


def _rename_key(raw: Mapping[str, Any], place: tuple[str, ...], known: Iterable[str]) -> Mapping[str, Any]:
    """Rename an unknown key to the nearest known name, or drop it if there is none or it is taken."""
    key = place[0]
    if len(place) > 1:
        return {**raw, key: _rename_key(raw[key], place[1:], known)}
    near = nearest(key, known)
    if near is None or near in raw:
        return {name: value for name, value in raw.items() if name != key}
    return {near if name == key else name: value for name, value in raw.items()}
