"""Columns of text tables: their names, units, and which of them the user names."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from coadjoint.errors import unknown_name
from coadjoint.files.ccsds import TextLine
from coadjoint.short_repr import short

MAX_COLUMNS = 10_000
MAX_NAME_LENGTH = 200  # characters of the name of a column
SEPARATORS = ";\t,"  # of as many, an earlier one separates, since decimal commas may stand beside it
COMMENTS = "#%"

UNITS: dict[str, dict[str, float]] = {
    "rad/s": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "rpm": math.pi / 30,
        "rev/s": 2 * math.pi,
        "Hz": 2 * math.pi,
        "deg/h": math.pi / 648000,
    },
    "s": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1e-9,
        "ps": 1e-12,
        "fs": 1e-15,
        "min": 60.0,
        "h": 3600.0,
        "d": 86400.0,
    },
    "m": {"m": 1.0, "km": 1e3, "nm": 1e-9, "ft": 0.3048, "angstrom": 1e-10},
    "m/s": {"m/s": 1.0, "km/s": 1e3, "ft/s": 0.3048},
    "1": {"1": 1.0},
    "1/s": {"1/s": 1.0},
}
"""SI unit -> units that are converted to it, with their sizes."""

SPELLINGS = {
    "s": ("sec", "seconds"),
    "ms": ("msec", "millis", "milliseconds"),
    "us": ("usec", "micros", "microseconds", "\N{MICRO SIGN}s", "\N{GREEK SMALL LETTER MU}s"),
    "ns": ("nsec", "nanos", "nanoseconds"),
    "min": ("minutes",),
    "h": ("hours",),
    "d": ("days",),
    "rad/s": ("rad_per_sec", "rad_per_s", "rad_sec", "rad/sec", "rad_s", "radps"),
    "deg/s": ("deg_per_sec", "deg_per_s", "deg_sec", "deg/sec", "deg_s", "degps", "dps", "\N{DEGREE SIGN}/s"),
}
"""Unit -> other spellings, in brackets or at the end of a name; longer ones first."""

TIMES = ("t", "time", "times", "timestamp", "seconds", "simtime", "elapsedtime", "date", "epoch", "utc")
"""Names of the time, without signs and in small letters."""

TIME_ENDINGS = "s", "ms", "us", "ns"
"""Units of the time that may end its name without brackets; "t_h" and such may be something else."""

AMBIGUOUS = ("min", "h", "d", "hz", "nm")
"""Units, in small letters, that a name may mean otherwise: a minimum, a height, a sampling rate, nautical miles."""

_CANONICAL = {text: unit for unit, texts in SPELLINGS.items() for text in texts}
_RATE_ENDINGS = {f"_{text}": unit for unit in ("rad/s", "deg/s") for text in SPELLINGS[unit] if "/" not in text}


class TextTable(NamedTuple):
    """The rows of a text table as text, with the numbers of their lines, names of columns (or none), and comments."""

    names: list[str]
    rows: list[list[str]]
    numbers: list[int]
    comments: list[str]


def text_table(file: str, lines: Sequence[TextLine]) -> TextTable:
    """Return the cells of a table with commas, semicolons, tabs or spaces; ValueError with file and line.

    The names of columns are in the first line, or in the last comment.
    """
    comments = [line.text.lstrip() for line in lines if line.text.lstrip()[0] in COMMENTS]
    kept = [line for line in lines if line.text.lstrip()[0] not in COMMENTS]
    if not kept:
        raise ValueError(f"{file}: has no rows, and so no line of numbers")
    most = max(SEPARATORS, key=kept[0].text.count)
    separator = most if most in kept[0].text else None
    rows = [_cells(file, line, separator) for line in kept]
    numbers, names = [line.number for line in kept], list[str]()
    if not (is_number(rows[0][-1]) and any(each.isdigit() for each in rows[0][0])):
        names, rows, numbers = rows[0], rows[1:], numbers[1:]
        if not rows:
            raise ValueError(f"{file}: has no rows, only a line of names and no line of numbers")
    elif comments:
        found = _cells(file, TextLine(0, comments[-1].lstrip(f"{COMMENTS} ")), separator)
        names = found if len(found) == len(rows[0]) and not any(map(is_number, found)) else []
    width = len(names or rows[0])
    if width > MAX_COLUMNS:
        raise ValueError(f"{file}: has {width} columns; give at most {MAX_COLUMNS}")
    if any(len(name) > MAX_NAME_LENGTH for name in names):
        raise ValueError(f"{file}: the name of a column has more than {MAX_NAME_LENGTH} characters; give a shorter one")
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != width:
            raise ValueError(f"{file}, line {number}: has {len(row)} columns, and the first line {width}")
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise ValueError(f"{file}: two columns have the name {short(repeated)}; rename one")
    return TextTable(names, rows, numbers, comments)


def _cells(file: str, line: TextLine, separator: str | None) -> list[str]:
    if separator is None:
        return line.text.split()
    if '"' not in line.text:
        return [entry.strip() for entry in line.text.split(separator)]
    try:
        found = next(csv.reader([line.text], delimiter=separator, skipinitialspace=True))
    except csv.Error as reason:
        raise ValueError(f"{file}, line {line.number}: {reason}") from None
    return [entry.strip() for entry in found]


def is_number(text: str) -> bool:
    """Return whether text is a number, without signs between its digits."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # which Python allows between digits


def bare(name: str) -> str:
    """Return a name in small letters without its unit and signs."""
    return "".join(each for each in split_unit(name)[0].lower() if each.isascii() and each.isalnum())


def split_unit(name: str) -> tuple[str, str]:
    """Return a name and its unit, or "": that in brackets, or of "p_deg_s", "bodyRate_deg_s_Roll" and "t_ms"."""
    text = name.strip()
    begin = max(text.rfind("["), text.rfind("("))
    if text.endswith(("]", ")")) and begin >= 0:
        return text[:begin].rstrip(), canonical_unit(text[begin + 1 : -1].strip())
    lower = text.lower()
    for ending, unit in _RATE_ENDINGS.items():
        if lower.endswith(ending) or f"{ending}_" in lower:
            place = lower.find(ending)
            return text[:place] + text[place + len(ending) :], unit
    first, _, last = lower.rpartition("_")
    if first in TIMES and canonical_unit(last) in TIME_ENDINGS:
        return text[: len(first)], canonical_unit(last)
    return text, ""


def canonical_unit(text: str) -> str:
    """Return the spelling of a unit in `UNITS`; text that is none as it is."""
    known = {unit for units in UNITS.values() for unit in units}
    return text if text in known else _CANONICAL.get(text.lower(), text.lower() if text.lower() in known else text)


def _unit_of_chosen(column: str, name: str, si: str) -> str:
    """Return the unit in a name that the user gave for a column, or ""; ValueError if it may mean something else."""
    stated = split_unit(name)[1]
    if stated:
        return stated
    words = f"_{_in_words(name)}_"
    units = {_in_words(text): unit for unit in UNITS.get(si, {}) for text in (unit, *SPELLINGS.get(unit, ()))}
    found = sorted((text for text in units if f"_{text}_" in words), key=len, reverse=True)
    last = next((text for text in found if words.endswith(f"_{text}_")), None)
    if last is not None and last not in AMBIGUOUS:
        return units[last]
    unit = next((units[text] for text in found if units[text] != si), None)
    if unit is not None:
        raise ValueError(
            f"columns: {short(column)}={short(name)}, whose unit may be {unit}; give it in brackets, "
            f"{short(f'{name}[{unit}]')} or {short(f'{name}[{si}]')}"
        )
    return ""


def _in_words(name: str) -> str:
    """Return a name in small letters with _ between its words."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])|[\W_]+", "_", name).lower()


def unit_size(column: str, name: str, unit: str, si: str) -> float:
    """Return the size of a unit; ValueError for one that is no unit of this quantity."""
    if unit in ("", si, "-"):
        return 1.0
    known = UNITS.get(si, {si: 1.0})
    if unit not in known:
        raise ValueError(f"{column}: {short(name)} has the unit {short(unit)}; give one of {', '.join(known)}")
    return known[unit]


def given_columns(names: Sequence[str], needed: Mapping[str, str], given: Any) -> dict[str, tuple[str, str]]:
    """Return the columns that the user named, of those needed: column -> (name in the table, unit or "")."""
    sources: dict[str, tuple[str, str]] = {}
    for column, text in () if given is None else _pairs_of(given, names):
        if column not in needed:
            raise unknown_name("column", column, needed)
        name, unit = (text, "") if text in names else split_unit(text)
        if name not in names:
            raise ValueError(
                f"columns: {short(column)}={short(text)}, and the table has no column {short(name)}; it has "
                f"{short(', '.join(names))}"
            )
        if column in sources or any(name == other for other, _ in sources.values()):
            raise ValueError(f"columns: {short(column)}={short(text)} names a column again; name each once")
        sources[column] = name, unit or _unit_of_chosen(column, name, needed[column])
    return sources


def _pairs_of(given: Any, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of a known column and a name in the table, with a unit in brackets if one was given."""
    if hasattr(given, "items"):
        return [(str(column), str(name)) for column, name in given.items()]
    try:
        entries = [entry.strip() for entry in str.split(given, ",") if entry.strip()]
    except TypeError:
        raise TypeError(f"columns is {short(given)}; give a mapping of names, or text such as wx=p[deg/s]") from None
    if any("=" in entry for entry in entries):
        return [(left.strip(), right.strip()) for left, _, right in (entry.partition("=") for entry in entries)]
    if len(entries) != len(names):
        raise ValueError(f"columns names {len(entries)} columns in their order; the table has {len(names)}")
    split = [(*split_unit(entry), name) for entry, name in zip(entries, names, strict=True) if entry != "-"]
    return [(column, f"{name}[{unit}]" if unit else name) for column, unit, name in split]
