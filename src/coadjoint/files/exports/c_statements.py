"""Statements of C, unrolled or as loops over tables; gradients of energies; the functions that headers call."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

from coadjoint.program.term_table import FUNCTION, LINEAR, Terms

FEW = 8
"""Statements that are written out; more of them are a loop."""
WIDTH = 120
VECTORS = "double *v, unsigned long vectors"
INDENT = "    "
SECTION = re.compile(r"^/\* \[(\w+)\] \*/\n", re.MULTILINE)
NAME = re.compile(r"\bcoadjoint_\w+")
FREE_BODY = Path(__file__).with_name("coadjoint.h")

Value = int | float | str
Columns = Mapping[str, Sequence[Value]]


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


def passed(declared: str) -> str:
    """Return declared arguments of a function as it passes them on; both begin with a comma after others.

    >>> passed("double *x, double h"), passed(", const double *u"), passed("")
    ('x, h', ', u', '')
    """
    return ", ".join(re.sub(r".*\W(?=\w)", "", argument) for argument in declared.split(", "))


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


def runs_of(keys: Sequence[Any]) -> Iterator[tuple[int, int]]:
    """Yield the ranges of equal neighbours."""
    first = 0
    for position in range(1, len(keys) + 1):
        if position == len(keys) or keys[position] != keys[first]:
            yield first, position
            first = position


@cache
def _sections() -> dict[str, str]:
    """Return the text of each section, in an order in which none calls a later one."""
    text = Path(__file__).with_name("step.h").read_text(encoding="utf-8")
    pieces = SECTION.split(text)
    found = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    inside = FREE_BODY.read_text(encoding="utf-8").partition("#elif defined(COADJOINT_BITS)")[2]
    body = inside.partition("\n")[2].rpartition("#endif")[0].replace("coadjoint_##", "coadjoint_free##")
    body = re.sub(r"coadjoint_\((\w+)\)", lambda found: f"coadjoint_({found[1].replace('_', '')})", body)
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


def free_body_header() -> str:
    """Return the header of free bodies for a file of any name: what it includes of itself is written twice."""
    beginning, _, rest = FREE_BODY.read_text(encoding="utf-8").partition("\n#elif defined(COADJOINT_BITS)")
    body = rest.partition("\n")[2].rpartition("#endif")[0]
    return beginning.replace(f'#include "{FREE_BODY.name}"\n', body).replace(f'#include "{FREE_BODY.name}"', body) + (
        "#endif\n"
    )


FIELDS = ("offset", "coefficient")
"""The numbers of terms that may be inputs."""
MOST_NUMBERS = 2**22
"""Numbers of the tables; a file of more would take compilers minutes and gigabytes."""


class Exported(NamedTuple):
    """Statements of a step, of all steps of a run, and of the derivative of a step; `lines` define what they call."""

    # `resumable`: functions for the first step and all others, which take the errors of `compensated` sums.

    lines: list[str]
    step: list[str]
    steps: list[str]
    change: list[str]
    widest: int = 0
    resumable: bool = False
    compensated: bool = False
    side: int = 0


class TableNumbers:
    """The numbers of tables: written out, or the inputs that each call sets."""

    def __init__(self, entries: dict[tuple[int, str, int], int]) -> None:
        self._entries = entries

    def of(self, table: Any, field: str, values: Any) -> list[Value]:
        """Return the numbers of a field of a table."""
        found: list[Value] = values.tolist()
        for (owner, name, position), index in self._entries.items():
            if owner == id(table) and name == field:
                found[position] = f"u[{index}]"
        return found

    def of_terms(self, table: Any, prefix: str, terms: Terms) -> Any:
        """Return the function of numbers of terms, for `gradient`."""
        known = {
            field: self.of(table, prefix + field, getattr(terms, field))
            for field in ("offset", "weight", "coefficient")
        }
        return lambda field, position: known[field][position]

    def check_constant(self, table: Any, fields: Sequence[str], why: str) -> None:
        """Raise TypeError if numbers that are not in `fields` of a table are inputs."""
        for owner, name, _ in self._entries:
            if owner == id(table) and name not in fields:
                raise TypeError(f"{why} has inputs in {name}, which cannot be exported; prepare it without inputs")


def check_terms(system: str, terms: Terms) -> None:
    """Raise TypeError for energies with functions, or with more numbers than are exported."""
    if (terms.kind == FUNCTION).any():
        raise TypeError(
            f"the energy of {system} has a function that is no polynomial and cannot be exported; give "
            "a polynomial near it, or call the run from Python"
        )
    size = len(terms.weight) + len(terms.coefficient)
    if size > MOST_NUMBERS:
        raise TypeError(
            f"the energy of {system} has {size} numbers, and at most {MOST_NUMBERS} are exported; give a smaller system"
        )


LONGEST_CHAIN = 6
"""Products of a sum that is one expression; a longer sum is a loop."""
LARGEST_POWER = 4
"""Powers that are written as products."""

Numbers = Callable[[str, int], Value]
"""``numbers(field, position)`` is a number of the terms, or the expression of an input."""


def rows_of(terms: Terms, k: int) -> range:
    """Return the rows of a term."""
    return range(int(terms.row[k]), int(terms.row[k + 1]))


def gradient(
    terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str, change: bool = False
) -> list[str]:
    """Return statements that set ``out[target(row)]`` to the rows of term k, or with `change` to those along v."""
    if terms.kind[k] == LINEAR:
        return _linear(terms, k, number, target, out, change)
    lines = repeated(f"{out}[{{row}}] = 0.0;", {"row": list(map(target, rows_of(terms, k)))})
    monomials = list(range(int(terms.monomial[k]), int(terms.monomial[k + 1])))
    factors = [factors_of(terms, m) for m in monomials]
    # Monomials in order, each with all derivatives; neighbours of one form are a loop.
    for first, last in runs_of([exponents for _, exponents in factors]):
        exponents, found = factors[first][1], dict[str, list[Any]]()
        for position in range(len(exponents)):
            rows = [one[0][position] for one in factors[first:last]]
            found[f"i{position}"] = [int(terms.target[row]) for row in rows]
            found[f"r{position}"] = list(map(target, rows))
        found["c"] = [number("coefficient", m) for m in monomials[first:last]]
        statements = (_second_derivatives if change else _first_derivatives)(exponents, out)
        if statements:
            lines += repeated("\n".join(statements), found)
    return lines


def chain_of(products: list[tuple[str, str]], start: str) -> str:
    """Return start + the sum of products, the first one first, each sum rounded once."""
    for a, b in products:
        start = f"coadjoint_fma({a}, {b}, {start})"
    return start


def _linear(terms: Terms, k: int, number: Numbers, target: Callable[[int], int], out: str, change: bool) -> list[str]:
    rows, vector = list(rows_of(terms, k)), "v" if change else "x"
    entries = [range(int(terms.entry[row]), int(terms.entry[row + 1])) for row in rows]
    columns, lines = terms.column.tolist(), []
    offset = [0.0 if change else number("offset", row) for row in rows]
    for first, last in runs_of([len(one) for one in entries]):
        length = len(entries[first])
        if length > LONGEST_CHAIN:
            for row in range(first, last):
                weights = [number("weight", e) for e in entries[row]]
                stored = [
                    *numbers("double", "weight", weights),
                    *numbers("coadjoint_index", "column", [columns[e] for e in entries[row]]),
                ]
                add = f"coadjoint_sum({length}, weight, column, {offset[row]}, {vector})"
                lines += ["{", *("    " + line for line in [*stored, f"{out}[{target(rows[row])}] = {add};"]), "}"]
            continue
        found: dict[str, list[Value]] = {"row": [target(row) for row in rows[first:last]], "b": offset[first:last]}
        for e in range(length):
            found[f"c{e}"] = [columns[one[e]] for one in entries[first:last]]
            found[f"w{e}"] = [number("weight", one[e]) for one in entries[first:last]]
        total = chain_of([(f"{{w{e}}}", f"{vector}[{{c{e}}}]") for e in range(length)], "{b}")
        lines += repeated(f"{out}[{{row}}] = {total};", found)
    return lines


def factors_of(terms: Terms, monomial: int) -> tuple[list[int], tuple[int, ...]]:
    """Return the factors of a monomial: rows of the terms, and exponents."""
    each = slice(int(terms.factor[monomial]), int(terms.factor[monomial + 1]))
    return terms.factor_row[each].tolist(), tuple(terms.exponent[each].tolist())


def power(x: str, exponent: int) -> str:
    """Return a power with the bits of repeated multiplication."""
    if exponent > LARGEST_POWER:
        return f"coadjoint_power({x}, {exponent})"
    return x if exponent == 1 else f"({' * '.join([x] * exponent)})"


def _first_derivatives(exponents: tuple[int, ...], out: str) -> list[str]:
    def factors(chosen: int) -> Iterator[str]:
        for position, exponent in enumerate(exponents):
            x = f"x[{{i{position}}}]"
            if position != chosen:
                yield power(x, exponent)
            elif exponent > 1:
                yield f"({exponent}.0 * {power(x, exponent - 1)})"

    numbered = range(len(exponents))
    return [f"{out}[{{r{chosen}}}] += {' * '.join(['{c}', *factors(chosen)])};" for chosen in numbered]


def _second_derivatives(exponents: tuple[int, ...], out: str) -> list[str]:
    statements = []
    for one, other in product(range(len(exponents)), repeat=2):
        if one == other and exponents[one] < 2:
            continue
        factors = ["{c}"]
        for position, exponent in enumerate(exponents):
            order = (position == one) + (position == other)
            scale = exponent * (exponent - 1) if order == 2 else exponent if order else 1
            factors += [f"{scale}.0"] if scale != 1 else []
            left = exponent - order
            factors += [power(f"x[{{i{position}}}]", left)] if left else []
        statements.append(f"{out}[{{r{one}}}] += {' * '.join(factors)} * v[{{i{other}}}];")
    return statements
