"""Text of configuration files, parsed as TOML; errors have line and column."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from coadjoint.errors import in_one_line
from coadjoint.files.configuration.construction import ConfigurationError

MAX_BYTES = 2**28
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
            # Devices may be endless, and datasets given by mistake huge.
            given = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as reason:
        raise ConfigurationError(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    if len(given) > MAX_BYTES:
        raise ConfigurationError(f"{path}: is longer than {MAX_BYTES} bytes; give long ensembles in Python")
    try:
        return given.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as reason:
        raise ConfigurationError(f"{path}: is not text in UTF-8 (byte {reason.start}); save it as such") from None


def parse_toml(name: str, text: str) -> dict[str, Any]:
    """Parse TOML; ConfigurationError with line and column. `name` is that of the file."""
    found = _LONG_KEY.search(text)
    if found is not None:
        raise _syntax_error(name, text, found.start(), f"a key has more than {MAX_NESTING} parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as reason:
        said = str(reason)
    except RecursionError:
        raise _syntax_error(
            name, text, _nesting_position(text), f"lists and tables are nested deeper than {MAX_NESTING}; nest less"
        ) from None
    except ValueError as reason:
        # Python limits the digits of integers.
        digits = _LONG_NUMBER.search(text)
        place = len(text) if digits is None else digits.start()
        raise _syntax_error(
            name, text, place, "a whole number has too many digits" if digits else str(reason)
        ) from None
    at = re.search(r" \(at line (\d+), column (\d+)\)$", said)
    line, column = (int(at[1]), int(at[2])) if at else _line_and_column(text, len(text))
    said = re.sub(r" \(at [^()]*\)$", "", said)
    raise ConfigurationError(f"{name}: line {line}, column {column}: {said[:1].lower()}{in_one_line(said[1:], 300)}")


def _syntax_error(name: str, text: str, place: int, said: str) -> ConfigurationError:
    line, column = _line_and_column(text, place)
    key = re.match(r"\s*([\w.-]{1,60})\s*=", text[: place + 1].rpartition("\n")[2])
    return ConfigurationError(f"{name}: line {line}, column {column}: {key[1] + ': ' if key else ''}{said}")


def _line_and_column(text: str, place: int) -> tuple[int, int]:
    return text.count("\n", 0, place) + 1, place - text.rfind("\n", 0, place)


def _nesting_position(text: str) -> int:
    """Return the position of the first bracket that is nested too deeply."""
    depth = 0
    for found in _NESTING.finditer(text):
        depth += {"[": 1, "{": 1, "]": -1, "}": -1}.get(found[0], 0)
        if depth > MAX_NESTING:
            return found.start()
    return len(text)
