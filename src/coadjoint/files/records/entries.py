"""Entries of records: validating accessors whose errors contain the path of the entry."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import accumulate, chain
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import fits
from coadjoint.errors import in_one_line
from coadjoint.short_repr import short
from coadjoint.validation import is_integer, is_real

# Prefixes of missing functions without which a run can be repeated, since they do not affect the motion.
CASIMIR, EXACT, INTEGRAL = "casimir: ", "exact solution: ", "integral: "
STREAM, ENERGY = "stream: ", "energy: "
MAX_DEPTH = 32
MAX_NESTING = 64  # of JSON, more than the library writes
MAX_CHARACTERS = 2000
MAX_INTEGER = 2**62
Value = TypeVar("Value")
_STRING, _BRACKET = re.compile(r'"(?:[^"\\]|\\.)*"'), re.compile(r"[\[{\]}]")
_QUOTIENT = re.compile(r"(-?\d{1,400})/(\d{1,1500})")


class Entry:
    """An unvalidated value of a record from a file, and its path in the record for messages."""

    def __init__(self, value: Any, path: str, depth: int = 0) -> None:
        self.value, self.path, self._depth = value, path, depth
        if depth > MAX_DEPTH:
            raise ValueError(f"{path} is nested deeper than {MAX_DEPTH} lists and tables")

    def invalid_error(self, expected: str) -> ValueError:
        """Return the error that the value must be `expected`."""
        return ValueError(f"{self.path} is {short(self.value, 60)}; it must be {expected}")

    def instance(self, kind: type[Value], expected: str) -> Value:
        """Return the value if it is of a class, or raise the error that it must be `expected`."""
        if not isinstance(self.value, kind):
            raise self.invalid_error(expected)
        return self.value

    @property
    def is_table(self) -> bool:
        """Whether the value is a table."""
        return isinstance(self.value, dict)

    def table(self) -> dict[str, Entry]:
        """Return a table of entries."""
        return {
            key: Entry(value, f"{self.path}.{in_one_line(key, 40)}", self._depth + 1)
            for key, value in self.instance(dict, "a table").items()
        }

    def __contains__(self, key: str) -> bool:
        return key in self.table()

    def __getitem__(self, key: str) -> Entry:
        table = self.table()
        if key not in table:
            raise ValueError(f"{self.path} has no {key!r}")
        return table[key]

    def optional(self, key: str, read: Callable[[Entry], Value]) -> Value | None:
        """Return what `read` makes of an entry of a table; None if there is no such entry."""
        table = self.table()
        return read(table[key]) if key in table else None

    def reject_unknown(self, *known: str) -> Entry:
        """Reject unknown keys, whose meaning would be lost; return the entry itself."""
        for key, entry in self.table().items():
            if key not in known:
                raise ValueError(f"{entry.path} is an unknown key; the known keys are {', '.join(known)}")
        return self

    def entries(self, length: int | None = None) -> list[Entry]:
        """Return a list of entries, of the given length if any."""
        expected = "a list" if length is None else f"a list of {length} entries"
        values = self.instance(list, expected)
        if length is not None and len(values) != length:
            raise self.invalid_error(expected)
        return [Entry(value, f"{self.path}[{i}]", self._depth + 1) for i, value in enumerate(values)]

    def texts(self, length: int | None = None) -> list[str]:
        """Return a list of texts, of the given length if any."""
        return [entry.text() for entry in self.entries(length)]

    def integers(self, maximum: int, length: int | None = None) -> list[int]:
        """Return a list of integers from 0 to `maximum`, of the given length if any."""
        value = self.value
        listed = isinstance(value, list) and set(map(type, value)) <= {int} and (length is None or len(value) == length)
        if not listed or (value and not 0 <= min(value) <= max(value) <= maximum):
            raise self.invalid_error(
                f"a list of {'' if length is None else f'{length} '}whole numbers from 0 to {maximum}"
            )
        return list(value)

    def numbers(self, length: int) -> NDArray[np.float64]:
        """Return an array of `length` finite numbers."""
        return self._array(f"a list of {length} finite numbers", length)

    def rows(self, *bounds: int) -> NDArray[np.float64]:
        """Return an array of rows: integers below the bounds, then a finite number."""
        expected = f"rows of {len(bounds)} whole numbers below {', '.join(map(str, bounds))} and a finite number"
        if self.value == []:
            return np.zeros((0, len(bounds) + 1))
        table = self._array(expected, None, len(bounds) + 1)
        for column, bound in zip(table.T, bounds, strict=False):
            if not ((column >= 0) & (column < bound) & (column == np.floor(column))).all():
                raise self.invalid_error(expected)
        return table

    def _array(self, expected: str, *shape: int | None) -> NDArray[np.float64]:
        try:
            array = np.array(self.value)
        except (ValueError, TypeError, OverflowError, RecursionError):
            raise self.invalid_error(expected) from None
        fits_shape = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
        if not isinstance(self.value, list) or array.dtype.kind not in "if" or not fits_shape:
            raise self.invalid_error(expected)
        entries = self.value if array.ndim == 1 else chain.from_iterable(self.value)
        # NumPy converts a boolean among numbers to a number.
        if not {bool, np.bool_}.isdisjoint(map(type, entries)) or not np.isfinite(array).all():
            raise self.invalid_error(expected)
        return array.astype(np.float64)

    def text(self, most: int = MAX_CHARACTERS) -> str:
        """Return the value as text of at most `most` characters."""
        text = self.instance(str, "text")
        if len(text) > most:
            raise self.invalid_error(f"text of at most {most} letters")
        return text

    def integer(self, minimum: int = 0, maximum: int = MAX_INTEGER) -> int:
        """Return the value as an integer between bounds."""
        if not is_integer(self.value) or not minimum <= self.value <= maximum:
            raise self.invalid_error(
                f"a whole number from {minimum} " + ("up" if maximum == MAX_INTEGER else f"to {maximum}")
            )
        return int(self.value)

    def number(self) -> float:
        """Return the value as a finite float."""
        if not is_real(self.value) or not fits(self.value):
            raise self.invalid_error("a finite number")
        return float(self.value)

    def exact(self) -> int | float | Fraction:
        """Return the value as an exact number: an integer, a float, or a quotient of integers."""
        if isinstance(self.value, str):
            match = _QUOTIENT.fullmatch(self.value)
            if match is None or not int(match[2]):
                raise self.invalid_error("a number, or a quotient such as '1/3'")
            quotient = Fraction(int(match[1]), int(match[2]))
            if not fits(quotient):
                raise self.invalid_error("a quotient that float64 holds")
            return quotient
        self.number()
        return self.value

    def flag(self) -> bool:
        """Return the value as a bool, which a file may hold as 1 or 0."""
        value = self.value.item() if isinstance(self.value, np.generic) else self.value
        if not isinstance(value, bool | int) or value not in (0, 1):
            raise self.invalid_error("0 or 1")
        return bool(value)

    def plain(self) -> Any:
        """Return the value unconverted: tables, lists, text, booleans and finite numbers, of limited depth."""
        match self.value:
            case dict():
                return self.plain_table()
            case list() as row if self._depth < MAX_DEPTH and {*map(type, row)} == {float} and np.isfinite(row).all():
                return list(row)  # of a large table
            case list():
                return [entry.plain() for entry in self.entries()]
            case str():
                return self.text()
            case bool() | None:
                return self.value
            case int():
                return self.integer(-MAX_INTEGER)
        self.number()
        return self.value

    def plain_table(self) -> dict[str, Any]:
        """Return a table unconverted, as `plain` does."""
        return {key: entry.plain() for key, entry in self.table().items()}


def parsed(value: Any, path: str) -> Entry:
    """Parse an attribute that contains JSON."""
    text = Entry(value, path).instance(str, "text, JSON")
    try:
        return Entry(decode_json(text), path)
    except ValueError as reason:
        problem = in_one_line(str(reason), 120)
    raise ValueError(f"{path} is {short(value, 60)}, which is no JSON: {problem}")


def decode_json(text: str, **options: Any) -> Any:
    """Decode JSON; ValueError for deep nesting, and RecursionError only where the caller is what is nested."""
    try:
        return json.loads(text, **options)
    except RecursionError:
        depths = accumulate(1 if bracket in "[{" else -1 for bracket in _BRACKET.findall(_STRING.sub("", text)))
        if max(depths, default=0) <= MAX_NESTING:
            raise
    raise ValueError("lists or tables are nested too deeply")


@contextmanager
def as_value_errors(entry: Entry) -> Iterator[None]:
    """Convert errors of the library inside the context to ValueError with the path of the entry."""
    try:
        with np.errstate(all="ignore"):  # overflows are rejected here or in the run
            yield
    except (ValueError, TypeError) as reason:
        raise ValueError(f"{entry.path}: {in_one_line(str(reason), 300)}") from reason
    except (ArithmeticError, RecursionError, MemoryError) as reason:
        raise ValueError(f"{entry.path}: {type(reason).__name__}: {in_one_line(str(reason), 300)}") from reason
