"""Text descriptions of Lie algebras and the listing of the catalogue, for the command line."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from coadjoint.algebra.brackets import count_of_brackets, format_brackets
from coadjoint.algebra.catalogue import families, get, names
from coadjoint.algebra.families.low_dimensional import entries
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.errors import in_one_line

LINE_WIDTH = 100  # letters, as of a wide terminal
MAX_BRACKETS = 20  # shown; a screen with the other lines
MAX_NAMES = 30  # of the basis, shown in at most two lines
MAX_SEARCHED_DIMENSION = 16
"""Largest dimension for which unknown Casimirs are computed; above it the computation takes seconds."""
MAX_FORMULA_LENGTH = 300  # letters, three lines


def listed_algebras() -> list[str]:
    """Return one line per name of the catalogue: name with parameters, dimension, aliases."""
    known, patterns = entries(), families()
    return [f"{_signature(name, known):16}{_summary_line(name, known, patterns)}" for name in names()]


def _signature(name: str, known: Mapping[str, Mapping[str, Any]]) -> str:
    parameters = known.get(name, {}).get("parameters", ())
    return f"{name}({', '.join(parameters)})" if parameters else name


def _summary_line(name: str, known: Mapping[str, Mapping[str, Any]], patterns: Mapping[str, tuple[str, ...]]) -> str:
    if name in patterns:
        return f"a family; give the numbers, such as {_example(name)}"
    if name not in known:
        return f"dimension {get(name).dim}"
    entry = known[name]
    more = [entry[key] for key in ("range", "note") if entry.get(key)]
    return ", ".join([f"dimension {entry['dim']}", *more])


def _example(pattern: str) -> str:
    head, _, numbers = pattern.partition("(")
    return f"{head}({numbers.replace('2n', '4').replace('p,q', '3,1').replace('n', '3')}"


def algebra_of(name: str, parameters: Mapping[str, Any]) -> LieAlgebra:
    """Return an algebra of the catalogue; a family without numbers is refused with an example of the notation."""
    if name in families() and not parameters:
        raise ValueError(f"{name} is a family; give its numbers, such as {_example(name)}")
    return get(name, **parameters)


def algebra_text(algebra: LieAlgebra) -> str:
    """Describe an algebra (dimension, basis, brackets, Casimirs) in lines of at most 100 characters."""
    return "\n".join(_lines(algebra))


def _lines(algebra: LieAlgebra) -> Iterator[str]:
    yield str(algebra.name or "a Lie algebra")
    yield from _entry("dimension", str(algebra.dim))
    basis_names = algebra.basis if algebra.dim <= MAX_NAMES else (*algebra.basis[:3], "...", algebra.basis[-1])
    yield from _entry("basis", in_one_line(", ".join(basis_names), MAX_FORMULA_LENGTH))
    count = count_of_brackets(algebra.triples)
    shown = format_brackets(algebra.triples, algebra.basis, MAX_BRACKETS)
    more = [f"and {count - len(shown)} more"] if count > len(shown) else []
    for number, line in enumerate([*shown, *more] or ["none but zero"]):
        yield from _entry("" if number else "brackets", line)
    for number, line in enumerate(_casimirs(algebra)):
        yield from _entry("" if number else "casimirs", line)
    size = None if algebra.representation is None else algebra.representation.shape[1]
    yield from _entry(
        "matrices", "none is known; use the coadjoint representation" if size is None else f"{size} x {size}"
    )


def _casimirs(algebra: LieAlgebra) -> list[str]:
    known: Mapping[str, Any] = algebra.casimirs_known
    if not known and algebra.dim > MAX_SEARCHED_DIMENSION:
        return [f"not computed here, since there are {algebra.dim} coordinates; call casimirs() of the algebra"]
    casimirs = known or algebra.casimirs()
    if not casimirs:
        return [in_one_line(repr(casimirs), MAX_FORMULA_LENGTH).removeprefix("{}").strip(" ()") or "none"]
    return [in_one_line(_formula(name, value), MAX_FORMULA_LENGTH) for name, value in casimirs.items()]


def _formula(name: str, value: Any) -> str:
    text = str(value)
    return name if text == name or " object at " in text or text.startswith("<") else f"{name} = {text}"


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(text, LINE_WIDTH, initial_indent=f"{name:14}", subsequent_indent=" " * 14)
