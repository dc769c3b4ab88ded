"""Statements of C: unrolled if they are few, otherwise a loop over a constant table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any, NamedTuple

FEW = 8
"""Statements that are written out; more of them are a loop."""
WIDTH = 120
VECTORS = "double *v, unsigned long vectors"
INDENT = "    "

Value = int | float | str
Columns = Mapping[str, Sequence[Value]]


class Inputs(NamedTuple):
    """How functions declare the inputs of a run after other arguments, and pass them on; empty without inputs."""

    declared: str = ""
    passed: str = ""


def literal(value: Value) -> str:
    """Return a number as C reads it, with the same bits; text is an expression."""
    return str(value) if type(value) is str else repr(value)


def indented(lines: Sequence[str]) -> list[str]:
    """Return lines one level deeper."""
    return [INDENT + line if line else line for line in lines]


def block(head: str, lines: Sequence[str]) -> list[str]:
    """Return lines in braces after a head."""
    return [f"{head} {{".lstrip(), *indented(lines), "}"]


def function(name: str, arguments: str, body: Sequence[str]) -> list[str]:
    r"""Return a function without result, after an empty line. Arguments that the body does not mention are allowed.

    Examples
    --------
    >>> print("\n".join(function("rest", "double *x, double h", ["x[0] = 0.0;"])))
    <BLANKLINE>
    static inline void coadjoint_rest(double *x, double h) {
        x[0] = 0.0;
        (void)h;
    }
    """
    named, text = re.findall(r"(\w+)(?:\[\w*\])?(?:,|$)", arguments), "\n".join(body)
    unused = [f"(void){one};" for one in named if not re.search(rf"\b{one}\b", text)]
    return ["", *block(f"static inline void coadjoint_{name}({arguments})", [*body, *unused])]


def numbers(kind: str, name: str, values: Sequence[Value]) -> list[str]:
    """Return the declaration of a constant array."""
    text = ", ".join(map(literal, values)) if len(values) else "0"
    line = f"static const {kind} {name}[{max(1, len(values))}] = {{{text}}};"
    return (
        [line] if len(line) <= WIDTH - 8 else [f"static const {kind} {name}[{len(values)}] = {{", *_filled(text), "};"]
    )


def _filled(text: str) -> list[str]:
    return fill(
        text, WIDTH - 8, initial_indent=INDENT, subsequent_indent=INDENT, break_on_hyphens=False, break_long_words=False
    ).splitlines()


def repeated(template: str, columns: Columns) -> list[str]:
    r"""Return the statement `template` for each row of `columns`, in order.

    In a loop, a column of equal values is written out, one of equally spaced integers is computed, and others are read
    from a table. Expressions are never put into a table.

    Examples
    --------
    >>> repeated("x[{i}] += {w};", {"i": [0, 2], "w": [0.5, 1.0]})
    ['x[0] += 0.5;', 'x[2] += 1.0;']
    >>> print("\n".join(repeated("x[{i}] += {w};", {"i": range(0, 20, 2), "w": [0.5] * 10})))
    for (unsigned long k = 0; k < 10; ++k) {
        x[2 * k] += 0.5;
    }
    """
    count = len(next(iter(columns.values())))
    found, stored = {}, {}
    for name, values in columns.items():
        form = _formula(values)
        if form is None:
            stored[name] = values
        found[name] = f"list[k].{name}" if form is None else form
    if count <= FEW or any(type(value) is str for values in stored.values() for value in values):
        rows = (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))
        return [line for row in rows for line in _statements(template, {n: literal(v) for n, v in row.items()})]
    loop = block(f"for (unsigned long k = 0; k < {count}; ++k)", _statements(template, found))
    if not stored:
        return loop
    kinds = {name: "double" if type(values[0]) is float else "coadjoint_index" for name, values in stored.items()}
    fields = " ".join(f"{kind} {name};" for name, kind in kinds.items())
    rows_text = ", ".join("{" + ", ".join(map(literal, row)) + "}" for row in zip(*stored.values(), strict=True))
    head = f"static const struct {{ {fields} }} list[{count}] = {{"
    return block("", [head, *_filled(rows_text), "};", *loop])


def _statements(template: str, fields: Mapping[str, str]) -> list[str]:
    return template.format(**fields).split("\n")


def _formula(values: Sequence[Value]) -> str | None:
    """Return an expression in k for a column; None if there is none."""
    first = values[0]
    if all(type(value) is type(first) and literal(value) == literal(first) for value in values):
        return literal(first)
    if any(type(value) is not int for value in values):
        return None
    start, step = int(first), int(values[1]) - int(first)
    if step <= 0 or any(value != start + step * k for k, value in enumerate(values)):
        return None
    product = "k" if step == 1 else f"{step} * k"
    return product if start == 0 else f"{start} + {product}"


def wrapped(line: str) -> str:
    """Return a line of code, broken at spaces if it is too long."""
    if len(line) <= WIDTH or line.startswith(("#", "/*")):
        return line
    start = line[: len(line) - len(line.lstrip())]
    return fill(
        line.strip(),
        WIDTH,
        initial_indent=start,
        subsequent_indent=start + 2 * INDENT,
        break_on_hyphens=False,
        break_long_words=False,
    )


def runs_of(keys: Sequence[Any]) -> Iterator[tuple[int, int]]:
    """Yield the ranges of equal neighbours."""
    first = 0
    for position in range(1, len(keys) + 1):
        if position == len(keys) or keys[position] != keys[first]:
            yield first, position
            first = position
