"""Parsing of configuration files: TOML with line and column in errors, messages about keys, the valid part of files."""

from __future__ import annotations

import inspect
import math
import re
import tomllib
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from coadjoint.algebra.exact.numbers import parse_decimal
from coadjoint.errors import ConfigurationError, in_one_line, nearest
from coadjoint.files.configuration.models import MAX_SHOWN_LENGTH, File
from coadjoint.keyword_hints import vocabulary
from coadjoint.methods import registry
from coadjoint.short_repr import short
from coadjoint.systems.registry import ready_made_systems

MAX_BYTES = 2**28  # of a file; longer ensembles are given in Python
MAX_NESTING = 64
_STRING = r"""\"{3}(?:[^\\]|\\.)*?\"{3}|'{3}.*?'{3}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'"""
_NESTING = re.compile(rf"{_STRING}|\#[^\n]*|[\[{{\]}}]", re.DOTALL)
# tomllib needs cubic time in the number of parts of a dotted key.
_LONG_KEY = re.compile(rf"(?<![\w.])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{MAX_NESTING}}}")
_LONG_NUMBER = re.compile(r"\d[\d_]{3999,}")


def read_utf8(path: str | Path) -> str:
    """Read a file as UTF-8 with normalized line ends, without a byte-order mark.

    Raise ConfigurationError if it is unreadable, too long, or no UTF-8.
    """
    try:
        with open(path, "rb") as file:
            # Devices may be endless, and a dataset given by mistake may be huge.
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as reason:
        raise ConfigurationError(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    if len(content) > MAX_BYTES:
        raise ConfigurationError(f"{path}: is longer than {MAX_BYTES} bytes; give long ensembles in Python")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as reason:
        raise ConfigurationError(f"{path}: is not text in UTF-8 (byte {reason.start}); save it as such") from None


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Parse TOML; ConfigurationError with line and column. `name` is that of the file."""
    match = _LONG_KEY.search(text)
    if match is not None:
        raise _syntax_error(name, text, match.start(), f"a key has more than {MAX_NESTING} parts")

    def number(literal: str) -> float:
        value = float(literal)
        try:
            return parse_decimal(literal) if math.isfinite(value) else value  # others are refused by their keys
        except ValueError as reason:
            raise _syntax_error(name, text, text.find(literal), str(reason)) from None

    try:
        return tomllib.loads(text, parse_float=number)
    except tomllib.TOMLDecodeError as reason:
        problem = str(reason)
    except ConfigurationError:
        raise
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


CLOSE = 0.75
"""Smallest similarity of an unknown key and the key of another table that is suggested."""


def keys_by_table() -> dict[str, Iterable[str]]:
    """Return the keys of each table of a file; names and parameters, which several have, are omitted."""
    tables: dict[str, Iterable[str]] = {"the top of the file": ["sign"], "[[forces]]": []}
    tables |= {f"[{key}]": [] for key in File.model_fields if key not in ("name", "sign", "forces")}
    for key in ("algebra", "hamiltonian", "initial", "run", "output"):
        tables[f"[{key}]"] = [name for name in known_keys((key,)) if name not in ("name", "parameters")]
    return tables


def places_of(key: str, elsewhere: Mapping[str, Iterable[str]]) -> tuple[str | None, list[str]]:
    """Return the table of this name, and the tables that have a key of this name."""
    own_table = next((table for table in elsewhere if table.strip("[]") == key), None)
    return own_table, [table for table, keys in elsewhere.items() if key in keys]


PLACES: Mapping[str, str] = types.MappingProxyType(
    {
        "x0": "[initial] x",
        "system": "[system] name",
        "method": "[method] name",
        "t_span": "[run] t_span",
        "step": "[run] step",
        "accuracy": "[run] accuracy",
        "t_eval": "[run] t_eval",
        "save_every": "[run] save_every",
        "threads": "[run] threads",
        "events": "[events.NAME] g",
        "observe": "[observe] NAME",
        "archive": "[output] archive",
        "inertia": "[system.parameters] inertia",
        "parameters": "[system.parameters]",
        "file": "[output] file",
        "figure": "[output] figure",
        "movie": "[output] movie",
        "polynomial": "[hamiltonian] polynomial",
        "samples": "[sweep] samples",
    }
)
"""Argument of `integrate`, or key of a file -> its place in a file."""


def place_meant(key: str) -> str | None:
    """Return the place in a file of what an argument or a usual name means, or None."""
    argument = vocabulary("keys of files").get(key) or vocabulary("arguments").get(key, key).partition("=")[0]
    return PLACES.get(argument)


def unknown_key(key: str, known: Iterable[str], elsewhere: Mapping[str, Iterable[str]]) -> str:
    """Describe an unknown key, with its place, the nearest known one, or all known ones if none is near."""
    own_table, tables = places_of(key, elsewhere)
    if own_table is not None:
        return f"unknown key; {key!r} is a table of its own, {own_table}"
    if tables:
        return f"unknown key; {key!r} belongs to {' or '.join(tables)}"
    if (place := place_meant(key)) is not None:
        return f"unknown key; give {place}"
    names = sorted(known)
    near = nearest(key, names)
    if near is not None:
        return f"unknown key; did you mean {near!r}?"
    for table, keys in elsewhere.items():
        near = nearest(key, keys, CLOSE)
        if near is not None:
            return f"unknown key; did you mean {near!r}, which belongs to {table}?"
    return f"unknown key; known here: {', '.join(names)}" if names else "unknown key; there are none here"


def known_keys(table_path: Sequence[str | int], value: Any = None) -> list[str]:
    """Return the keys that a table of a file may have; in the file itself those of tables, if the value is one."""
    is_table = not table_path and isinstance(value, Mapping)
    return [key for key in _table_at(table_path).model_fields if not is_table or key not in ("name", "sign")]


def all_errors(error: ValidationError, elsewhere: Mapping[str, Iterable[str]], table: Sequence[str] = ()) -> list[str]:
    """Return the errors in a file, or in its `table`, dotted key and reason: unknown keys first."""
    # A missing key is omitted if an unknown one is its misspelling.
    rank = {"extra_forbidden": 0, "missing": 2}
    entries = sorted(error.errors(), key=lambda entry: rank.get(entry["type"], 1))
    messages: dict[str, str] = {}
    for entry in entries:
        # pydantic appends "[key]" for an invalid key of a table.
        key_path = [*table, *(key for key in entry["loc"] if key != "[key]")]
        path = "".join(
            f"[{key}]" if isinstance(key, int) else f".{in_one_line(key, MAX_SHOWN_LENGTH)}" for key in key_path
        )
        path = path.lstrip(".")
        reason = _reason(entry["type"], entry["msg"], entry["input"], entry.get("ctx", {}), key_path, elsewhere)
        misspelled = entry["type"] == "missing" and _is_named(key_path, messages.values())
        # For a union, pydantic lists one error per alternative; report the first.
        if not misspelled:
            messages.setdefault(".".join(map(str, key_path[:2])), f"{path}: {reason}" if path else f": {reason}")
    return list(messages.values())


def _is_named(key_path: Sequence[int | str], messages: Iterable[str]) -> bool:
    """Return whether messages about unknown keys name a missing key or table as the one that is meant."""
    path = ".".join(map(str, key_path))
    table, _, key = path.rpartition(".")
    names = (f"did you mean {key!r}?", f"give [{table}] {key}", f"give [{path}] ")
    return any(name in message for name in names for message in messages)


def _reason(
    kind: str,
    message: str,
    value: Any,
    context: Mapping[str, Any],
    key_path: list[int | str],
    elsewhere: Mapping[str, Iterable[str]],
) -> str:
    if kind == "extra_forbidden":
        return unknown_key(str(key_path[-1]), known_keys(key_path[:-1], value), elsewhere)
    if kind == "missing":
        return "is missing; give it"
    if kind == "value_error":
        return str(context["error"])
    expected = {
        "string_type": "text in quotes",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "float_type": "a number",
        "bool_type": "true or false",
        "list_type": "a list",
        "dict_type": "a table",
        "model_type": "a table",
        "model_attributes_type": "a table",
        "greater_than": f"greater than {context.get('gt')}",
        "greater_than_equal": f"{context.get('ge')} or more",
        "finite_number": "finite",
    }.get(kind)
    # A name in place of a table.
    place = PLACES.get(str(key_path[-1])) if expected == "a table" and isinstance(value, str) and key_path else None
    return (
        f"must be {expected}, not {short(value, MAX_SHOWN_LENGTH)}" + (f"; give {place}" if place else "")
        if expected
        else f"{message[:1].lower()}{message[1:]}, not {short(value, MAX_SHOWN_LENGTH)}"
    )


def _table_at(table_path: Sequence[int | str]) -> type[BaseModel]:
    table: type[BaseModel] = File
    keys = iter(table_path)
    for key in keys:
        annotation: Any = table.model_fields[str(key)].annotation
        if typing.get_origin(annotation) is dict:  # tables by name
            next(keys)
            annotation = typing.get_args(annotation)[1]
        options = typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
        table = next(option for option in options if isinstance(option, type) and issubclass(option, BaseModel))
    return table


PLACEHOLDERS: Mapping[str, Any] = {"run": {"t_span": [0.0, 1.0], "step": 1.0}, "initial": {"x": "unread.npy"}}
"""Placeholders for required tables that are invalid; they are not validated."""
SYSTEM_TABLES = frozenset({"name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces"})


def valid_tables(raw: Mapping[str, Any], report: Callable[[str], None]) -> tuple[File | None, set[str]]:
    """Return the valid part of a file, under corrected keys, and the invalid top-level keys; report their errors."""
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
    for message in dict.fromkeys(messages):
        report(message)
    return file, invalid


def _parameters(raw: Mapping[str, Any]) -> dict[tuple[str, ...], list[str]]:
    """Return the parameter names of the system and of the scheme, by the tables to which they belong."""
    names: dict[tuple[str, ...], list[str]] = {}
    if (name := named_in(raw, "system")) in ready_made_systems():
        names["system", "parameters"] = list(inspect.signature(ready_made_systems()[name]).parameters)
    if (name := named_in(raw, "method")) in registry.names():
        names["method",] = list(registry.parameters_of(name))
    return names


def named_in(raw: Mapping[str, Any], table: str) -> str:
    """Return the name in a table of a file, or '' if there is no text."""
    name = _value_at(raw, (table, "name"))
    return name if isinstance(name, str) else ""


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
