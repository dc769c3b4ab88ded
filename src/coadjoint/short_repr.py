"""Representations of arbitrary values: short ones in one line for messages, and plain ones for JSON and TOML."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from fractions import Fraction
from functools import singledispatch
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import numpy as np

MAX_SHOWN_LENGTH = 120
"""Longest text of one part of a representation, such as a Hamiltonian; longer ones are summarized."""
MAX_DEPTH = 6
"""Maximum depth of nested containers shown; deeper levels are elided."""


def short(value: Any, limit: int = 80) -> str:
    """Return a representation of at most `limit` (>= 4) characters, in one line.

    `repr` for small values; larger containers, arrays, strings and integers are read only as far as they are shown, in
    bounded time. An object whose ``__repr__`` fails is shown by its type.
    """
    text = ""
    for piece in _pieces(value, limit, MAX_DEPTH):
        text += piece
        if len(text) > limit:
            text = f"{text[: limit - 3]}..."
            break
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def short_rest(text: str, limit: int) -> str:
    """Return where a text cannot be parsed, in words for a message, by its rest from there."""
    rest = text.strip()
    return f"from {short(rest, limit)} on" if rest else "at its end"


def distinct(*values: float) -> tuple[str, ...]:
    """Return numbers as text of six digits, or of as many as show which of them differ.

    >>> distinct(0.0, 30.0), distinct(0.0, 30.0, 30.000000000013678)
    (('0', '30'), ('0', '30', '30.00000000001'))
    """
    count = len(set(values))
    texts = tuple(f"{value:.6g}" for value in values)
    for digits in range(7, 18):  # 17 digits distinguish all numbers
        if len(set(texts)) >= count:
            break
        texts = tuple(f"{value:.{digits}g}" for value in values)
    return texts


def html_table(title: str, rows: Mapping[str, Any]) -> str:
    """Return a small HTML table for notebooks: a title, and rows of a name and one value or a tuple of values."""
    from html import escape

    lines = []
    for name, value in rows.items():
        cells = value if isinstance(value, tuple) else (value,)
        entries = "".join(f"<td>{escape(str(cell))}</td>" for cell in cells)
        lines.append(f"<tr><th>{escape(name)}</th>{entries}</tr>")
    return f"<table><caption><b>{escape(title)}</b></caption>{''.join(lines)}</table>"


def compact(value: Any, limit: int = 60) -> str:
    """Return a representation in one line; arrays and nested numbers beyond `limit` are shown by their shape, not cut.

    >>> compact((0.0, 0.0, 1.0)), compact(np.eye(12)), compact([[0.5] * 8] * 8)
    ('(0.0, 0.0, 1.0)', '<array of shape (12, 12), float64>', '<list of shape (8, 8)>')
    """
    text = short(value, limit)
    if isinstance(value, np.ndarray) and text.endswith("..."):
        return f"<array of shape {value.shape}, {value.dtype.name}>"
    if type(value).__repr__ not in _BRACKETS or not text.endswith("..."):
        return text
    shape: list[int] = []
    entry = value
    while isinstance(entry, list | tuple) and entry and len(shape) < MAX_DEPTH:
        shape.append(len(entry))
        entry = entry[0]
    kind = type(value).__name__
    return f"<{kind} of shape ({', '.join(map(str, shape))})>" if len(shape) > 1 else f"<{kind} of {len(value)}>"


def record_repr(instance: Any) -> str:
    """Return the repr of a dataclass or named tuple, with functions shown by name, and large values by their shape."""
    names = getattr(instance, "_fields", None) or [field.name for field in fields(instance) if field.repr]
    entries = (f"{name}={compact(getattr(instance, name))}" for name in names if name[0] != "_")
    return f"{type(instance).__name__}({', '.join(entries)})"


def function_name(function: Any) -> str:
    """Return the name of a function, without its address."""
    inner = getattr(function, "func", None)
    if inner is not None and not hasattr(function, "__name__"):
        return f"partial of {function_name(inner)}"
    return getattr(function, "__name__", None) or f"a {type(function).__name__}"


def _pieces(value: Any, limit: int, depth: int) -> Iterator[str]:
    """Yield the representation lazily in pieces."""
    repr_method: Any = type(value).__repr__
    if repr_method in (str.__repr__, bytes.__repr__, bytearray.__repr__):
        yield repr(value[:limit])
        if len(value) > limit:
            yield "..."
    elif repr_method is int.__repr__:
        digits = value.bit_length() * 0.30103
        yield repr(value) if digits < limit else f"<int of about {int(digits) + 1} digits>"
    elif repr_method in _BRACKETS:
        yield from _container(value, limit, depth)
    elif isinstance(value, _FUNCTIONS):
        name = getattr(value, "__name__", "?")
        yield "a lambda" if name == "<lambda>" else f"the function {name}"
    elif isinstance(value, np.ndarray):
        yield from _array(value, limit, depth)
    else:
        yield _truncated_repr(value, limit)


_FUNCTIONS = (FunctionType, BuiltinFunctionType, MethodType, np.ufunc, type(np.linalg.norm))
MAX_NAMED_FUNCTIONS = 3
"""Maximum number of functions in a container shown individually; otherwise their count."""
_BRACKETS: dict[Any, tuple[str, str]] = {
    list.__repr__: ("[", "]"),
    tuple.__repr__: ("(", ")"),
    dict.__repr__: ("{", "}"),
    set.__repr__: ("{", "}"),
    frozenset.__repr__: ("frozenset({", "})"),
}


def _container(value: Any, limit: int, depth: int) -> Iterator[str]:
    repr_method: Any = type(value).__repr__
    opening, closing = _BRACKETS[repr_method]
    is_table = repr_method is dict.__repr__
    contents = value.values() if is_table else value
    if len(value) > MAX_NAMED_FUNCTIONS and all(_is_of_functions(entry) for entry in contents):
        yield f"{len(value)} functions"
        return
    if not value and opening.endswith("{") and not is_table:
        yield f"{type(value).__name__}()"
        return
    yield opening
    if depth == 0 and value:
        yield "..."
    else:
        entries: Iterable[Any] = value.items() if is_table else ((None, entry) for entry in value)
        for number, (key, entry) in enumerate(entries):
            if number:
                yield ", "
            if is_table:
                yield from _pieces(key, limit, depth - 1)
                yield ": "
            yield from _pieces(entry, limit, depth - 1)
    if opening == "(" and len(value) == 1:
        yield ","
    yield closing


def _is_of_functions(value: Any) -> bool:
    """Return whether a value is a function, or a tuple or list of functions."""
    if type(value) in (tuple, list):
        return bool(value) and all(isinstance(entry, _FUNCTIONS) for entry in value)
    return isinstance(value, _FUNCTIONS)


def _array(value: Any, limit: int, depth: int) -> Iterator[str]:
    plain, small = type(value) is np.ndarray, value.size <= limit and value.ndim <= 3
    if small and value.dtype == object and plain and depth:
        yield "array("
        yield from _pieces(value.tolist(), limit, depth - 1)
        yield ", dtype=object)"
    elif small and value.dtype != object:
        yield _truncated_repr(value, limit)
    else:
        yield f"<{'array' if plain else type(value).__name__} of shape {value.shape}, {value.dtype.name}>"


def _truncated_repr(value: Any, limit: int) -> str:
    """Return the start of an object's own repr, or its type if repr fails."""
    try:
        return " ".join(repr(value)[: 8 * limit].split())
    except Exception:
        return f"<{type(value).__name__} object without a representation>"


@singledispatch
def plain(value: Any) -> Any:
    """Return the plain form of a value; classes register theirs beside their definition.

    Examples
    --------
    >>> plain({"inertia": np.array([1.0, 2.0]), "rate": Fraction(1, 3), "shift": (1, 1j)})
    {'inertia': [1.0, 2.0], 'rate': '1/3', 'shift': {'real': [1.0, 0.0], 'imaginary': [0.0, 1.0]}}
    """
    return value


@plain.register(np.ndarray)
@plain.register(np.generic)
def _(value: Any) -> Any:
    if value.dtype.kind == "c":
        return {"real": value.real.tolist(), "imaginary": value.imag.tolist()}
    return plain(value.tolist()) if value.dtype.kind == "O" else value.tolist()


@plain.register(tuple)
@plain.register(list)
def _(value: Any) -> Any:
    if REAL.issuperset(map(type, value)):
        return list(value)
    return plain(np.array(value)) if _has_complex(value) else [plain(entry) for entry in value]


REAL = frozenset({float, int})
"""Types of the rows of large tables, which are not searched number by number."""


def _has_complex(value: Any) -> bool:
    if not isinstance(value, tuple | list):
        return isinstance(value, complex)
    return not REAL.issuperset(map(type, value)) and any(map(_has_complex, value))


@plain.register(Mapping)
def _(value: Any) -> Any:
    return {str(key): plain(entry) for key, entry in value.items()}


@plain.register(Fraction)
def _(value: Any) -> Any:
    return f"{value.numerator}/{value.denominator}"
