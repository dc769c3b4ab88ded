"""Parsing of configuration files: TOML with line and column in errors, and the valid part of invalid files."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from coadjoint.errors import in_one_line, nearest
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.configuration.models import (
    File,
    all_errors,
    keys_by_table,
    known_keys,
    place_meant,
    places_of,
    unknown_key,
)
from coadjoint.methods import registry
from coadjoint.systems.registry import ready_made_systems

MAX_BYTES = 2**28  # of a file; longer ensembles are given in Python
MAX_NESTING = 64
_STRING = r"""\"{3}(?:[^\\]|\\.)*?\"{3}|'{3}.*?'{3}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'"""
_NESTING = re.compile(rf"{_STRING}|\#[^\n]*|[\[{{\]}}]", re.DOTALL)
# tomllib needs cubic time in the number of parts of a dotted key.
_LONG_KEY = re.compile(rf"(?<![\w.])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{MAX_NESTING}}}")
_LONG_NUMBER = re.compile(r"\d[\d_]{3999,}")


def read_utf8(path: str | Path) -> str:
    """Read a file as UTF-8 with normalized line ends; ConfigurationError if it is unreadable, too long, or no UTF-8."""
    try:
        with open(path, "rb") as file:
            # Devices may be endless, and a dataset given by mistake may be huge.
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as reason:
        raise ConfigurationError(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    if len(content) > MAX_BYTES:
        raise ConfigurationError(f"{path}: is longer than {MAX_BYTES} bytes; give long ensembles in Python")
    try:
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as reason:
        raise ConfigurationError(f"{path}: is not text in UTF-8 (byte {reason.start}); save it as such") from None


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Parse TOML; ConfigurationError with line and column. `name` is that of the file."""
    match = _LONG_KEY.search(text)
    if match is not None:
        raise _syntax_error(name, text, match.start(), f"a key has more than {MAX_NESTING} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as reason:
        problem = str(reason)
    except RecursionError:
        raise _syntax_error(
            name, text, _nesting_position(text), f"lists and tables are nested deeper than {MAX_NESTING}; nest less"
        ) from None
    except ValueError as reason:
        # Python limits the digits of integers.
        digits = _LONG_NUMBER.search(text)
        position = len(text) if digits is None else digits.start()
        raise _syntax_error(
            name, text, position, "a whole number has too many digits" if digits else str(reason)
        ) from None
    location = re.search(r" \(at line (\d+), column (\d+)\)$", problem)
    line, column = (int(location[1]), int(location[2])) if location else _line_and_column(text, len(text))
    problem = re.sub(r" \(at [^()]*\)$", "", problem)
    raise ConfigurationError(
        f"{name}: line {line}, column {column}: {problem[:1].lower()}{in_one_line(problem[1:], 300)}"
    )


def _syntax_error(name: str, text: str, position: int, problem: str) -> ConfigurationError:
    line, column = _line_and_column(text, position)
    key = re.match(r"\s*([\w.-]{1,60})\s*=", text[: position + 1].rpartition("\n")[2])
    return ConfigurationError(f"{name}: line {line}, column {column}: {key[1] + ': ' if key else ''}{problem}")


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    return text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)


def _nesting_position(text: str) -> int:
    """Return the position of the first bracket that is nested too deeply."""
    depth = 0
    for match in _NESTING.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(match[0], 0)
        if depth > MAX_NESTING:
            return match.start()
    return len(text)


PLACEHOLDERS: Mapping[str, Any] = {"run": {"t_span": [0.0, 1.0], "step": 1.0}, "initial": {"x": "unread.npy"}}
"""Placeholders for required tables that are invalid; they are not validated."""
SYSTEM_TABLES = frozenset({"name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces"})


@dataclass(frozen=True)
class ValidTables:
    """The valid part of a file, under corrected keys; the `messages` of the rest, and its `invalid` top-level keys."""

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
    """Return the valid part of the tables of a file, and the errors of the rest."""
    messages: list[str] = []
    invalid: set[str] = set()
    parameters = _parameters(raw)
    elsewhere = {**keys_by_table(), **{f"[{'.'.join(path)}]": names for path, names in parameters.items()}}
    tables = _correct_parameter_names(raw, parameters, elsewhere, messages)
    file = None
    # First as written, then with unknown keys corrected, then without invalid tables.
    for _ in range(3):
        try:
            file = File.model_validate(tables)
            break
        except ValidationError as error:
            messages += all_errors(error, elsewhere)
            tables, invalid_names = _repair(tables, error, elsewhere)
            invalid |= invalid_names
    return ValidTables(file, tuple(dict.fromkeys(messages)), frozenset(invalid))


def _parameters(raw: Mapping[str, Any]) -> dict[tuple[str, ...], list[str]]:
    """Return the parameter names of the system and of the scheme, by the tables to which they belong."""
    system, method = raw.get("system"), raw.get("method")
    names: dict[tuple[str, ...], list[str]] = {}
    if isinstance(system, Mapping) and isinstance(name := system.get("name"), str) and name in ready_made_systems():
        names["system", "parameters"] = list(inspect.signature(ready_made_systems()[name]).parameters)
    if isinstance(method, Mapping) and isinstance(name := method.get("name"), str) and name in registry.names():
        names["method",] = list(registry.parameters_of(name))
    return names


def _correct_parameter_names(
    raw: Mapping[str, Any],
    parameters: Mapping[tuple[str, ...], list[str]],
    elsewhere: Mapping[str, Iterable[str]],
    messages: list[str],
) -> Mapping[str, Any]:
    """Correct unknown parameter names of the system and of the scheme; append the errors to `messages`."""
    for table_path, names in parameters.items():
        table = _value_at(raw, table_path)
        if not isinstance(table, Mapping):
            continue
        known = {*names, "name", "parameters"} if table_path == ("method",) else {*names}
        for key in [key for key in table if key not in known]:
            messages.append(f"{'.'.join(table_path)}.{key}: {unknown_key(key, names, elsewhere)}")
            raw = _rename_key(raw, (*table_path, key), _correction((*table_path, key), known, elsewhere))
    return raw


def _correction(key_path: tuple[str, ...], known: Iterable[str], elsewhere: Mapping[str, Iterable[str]]) -> str | None:
    """Return the known key to which an unknown one is corrected; None if there is none, or it belongs elsewhere."""
    *table_path, key = key_path
    if any(places_of(key, elsewhere)):
        return None
    if (place := place_meant(key)) is not None:
        table, _, name = place.partition(" ")
        # An accuracy excludes a step, which the table may have.
        is_here = table == f"[{'.'.join(table_path)}]" and name != "accuracy"
        return name if is_here and name in known else None
    return nearest(key, known)


def _repair(
    raw: Mapping[str, Any], error: ValidationError, elsewhere: Mapping[str, Iterable[str]]
) -> tuple[Mapping[str, Any], set[str]]:
    """Correct unknown keys and replace invalid tables; return also the names of the latter."""
    invalid: set[str] = set()
    for entry in error.errors():
        key_path = tuple(str(key) for key in entry["loc"])
        if entry["type"] == "extra_forbidden":
            known = known_keys(key_path[:-1], entry["input"])
            raw = _rename_key(raw, key_path, _correction(key_path, known, elsewhere))
        elif key_path:
            invalid.add(key_path[0])
    valid = {key: value for key, value in raw.items() if key not in invalid}
    return {**valid, **{key: PLACEHOLDERS[key] for key in invalid if key in PLACEHOLDERS}}, invalid


def _value_at(raw: Any, table_path: Iterable[str]) -> Any:
    for key in table_path:
        raw = raw.get(key) if isinstance(raw, Mapping) else None
    return raw


def _rename_key(raw: Mapping[str, Any], key_path: tuple[str, ...], correct: str | None) -> Mapping[str, Any]:
    """Rename an unknown key, or drop it if there is no correct name or it is taken."""
    key = key_path[0]
    if len(key_path) > 1:
        return {**raw, key: _rename_key(raw[key], key_path[1:], correct)}
    if correct is None or correct in raw:
        return {name: value for name, value in raw.items() if name != key}
    return {correct if name == key else name: value for name, value in raw.items()}
