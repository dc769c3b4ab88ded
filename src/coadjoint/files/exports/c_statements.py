"""Statements of C, unrolled if they are few, else a loop over a table; and the functions of headers that they call."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

FEW = 8
"""Statements that are written out; more of them are a loop."""
WIDTH = 120
VECTORS = "double *v, unsigned long vectors"
INDENT = "    "
SECTION = re.compile(r"^/\* \[(\w+)\] \*/\n", re.MULTILINE)
NAME = re.compile(r"\bcoadjoint_\w+")
INCLUDES = """#ifndef COADJOINT_H
#define COADJOINT_H
#include <float.h>
#include <stdint.h>
#if !defined(__STDC_HOSTED__) || __STDC_HOSTED__
#include <math.h>
#else /* freestanding: the program that links this provides sqrt, and fma if the processor has it */
#ifdef __cplusplus
extern "C" {
#endif
double sqrt(double x);
double fma(double a, double b, double c);
#ifdef __cplusplus
}
#endif
#endif
#if DBL_MANT_DIG != 53 || (defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD < 0 || FLT_EVAL_METHOD == 2))
#error "double must have 53 bits, without excess precision: for 32-bit x86 give -msse2 -mfpmath=sse"
#endif
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math changes the meaning of sums; compile without it"
#endif
#if defined(__clang__) /* a product and a sum are fused only where this is written */
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
"""

FREE_BODY = Path(__file__).with_name("coadjoint.h")

Value = int | float | str
Columns = Mapping[str, Sequence[Value]]


class DeclaredInputs(NamedTuple):
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


def includes(defined: Sequence[str]) -> str:
    """Return the beginning of the code, with definitions."""
    return "\n".join([INCLUDES, *defined, ""])


@cache
def _sections() -> dict[str, str]:
    """Return the text of each section, in an order in which none calls a later one."""
    text = Path(__file__).with_name("step.h").read_text(encoding="utf-8")
    pieces = SECTION.split(text)
    found = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    inside = FREE_BODY.read_text(encoding="utf-8").partition("#elif defined(COADJOINT_BITS)")[2]
    body = inside.partition("\n")[2].rpartition("#endif")[0].replace("coadjoint_##", "coadjoint_free_##")
    body = body.replace("NAN", "coadjoint_nan()")
    found["free_body"] = f"#define COADJOINT_BITS 64\n{body}#define coadjoint_free_body\n"
    found["body_changes"] = found.pop("body_changes")
    return found


@cache
def _defined() -> dict[str, str]:
    """Return the section of each function and structure."""
    found = {}
    for section, text in _sections().items():
        for name in re.findall(
            r"^(?:static (?:inline )?[^(]*?|struct )\b(coadjoint_\w+)(?:\(| \{)", text, re.MULTILINE
        ):
            found[name] = section
    found["coadjoint_free_body_jacobian"] = "free_body"
    return found


def runtime(body: str) -> str:
    """Return the sections whose functions a text calls, and those that these call."""
    sections, needed, pending = _sections(), set(), [body]
    while pending:
        for name in set(NAME.findall(pending.pop())):
            section = _defined().get(name)
            if section is not None and section not in needed:
                needed.add(section)
                pending.append(sections[section])
    return "\n".join(sections[name].strip() + "\n" for name in sections if name in needed)


def free_body_header(name: str = FREE_BODY.name) -> str:
    """Return the header of free bodies for a file of this name, which includes itself by its name."""
    if not name.isprintable() or any(sign in name for sign in '"\\'):
        raise ValueError(f"{name!r} cannot be included; give a name without quotes, backslashes and control characters")
    return FREE_BODY.read_text(encoding="utf-8").replace(f'#include "{FREE_BODY.name}"', f'#include "{name}"')
