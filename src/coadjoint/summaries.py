"""Plain-text descriptions of ready-made systems and Lie algebras, and the list of the catalogue."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from coadjoint.algebra.brackets import count_of_brackets, format_brackets
from coadjoint.algebra.catalogue import entries, families, get, names
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.errors import in_one_line
from coadjoint.methods.registry import suggested_scheme
from coadjoint.systems.description import description
from coadjoint.systems.registry import gallery_entry_of
from coadjoint.validation import as_tuples

LINE_WIDTH = 100  # characters of a line of the text
MAX_NAMED = 30  # coordinates that are listed by name: some two lines
MAX_BRACKETS = 20  # shown; a screen with the other lines
MAX_SEARCHED_DIMENSION = 16
"""Largest dimension for which unknown Casimirs are computed; above it the computation takes seconds."""
MAX_FORMULA_LENGTH = 300  # letters, three lines


def summarize_system(name: str) -> dict[str, Any]:
    """Return the `description` of a ready-made system, with ``"scheme"``, ``"step"`` and ``"command"``."""
    summary, gallery_entry = description(name), gallery_entry_of(name)
    summary["scheme"] = str(suggested_scheme(importlib.import_module("coadjoint.systems").get(name)))
    summary["step"] = None if gallery_entry is None else gallery_entry.step
    summary["command"] = None if gallery_entry is None else f"coadjoint gallery --out gallery {name}"
    return summary


def system_text(summary: Mapping[str, Any]) -> str:
    """Format a description of `summarize_system` as text, in lines of at most 100 characters."""
    entries = dict(summary)
    parameters = {key: (p["meaning"], repr(as_tuples(p["default"]))) for key, p in entries.pop("parameters").items()}
    call = f"{entries.pop('name')}({', '.join(f'{key}={default}' for key, (_, default) in parameters.items())})"
    lines = textwrap.wrap(call, LINE_WIDTH, subsequent_indent="    ")
    for text in (entries.pop("summary"), *entries.pop("equations")):
        lines += [*textwrap.wrap(text, LINE_WIDTH, initial_indent="    ", subsequent_indent="    "), ""]
    for key, (meaning, default) in parameters.items():
        lines += _entry(key, f"{meaning} Default: {default}.")
    if len(entries["coordinates"]) > MAX_NAMED:
        del entries["coordinates"]
    for key, value in entries.items():
        if isinstance(value, dict):
            shown = "; ".join(name if text in (None, name) else f"{name} = {text}" for name, text in value.items())
        else:
            shown = ", ".join(value) if isinstance(value, list) else str(value)
        lines += _entry(key, "none is known" if value in (None, "", {}) else shown)
    return "\n".join(lines)


def _entry(name: str, *texts: str) -> Iterator[str]:
    """Yield the lines of an entry with a name and one text or several."""
    for number, text in enumerate(texts):
        indent = f"{'' if number else name:14}"
        yield from textwrap.wrap(text, LINE_WIDTH, initial_indent=indent, subsequent_indent=" " * 14)


def listed_algebras() -> list[str]:
    """Return one line per name of the catalogue: name with parameters, dimension, range."""
    known, patterns, lines = entries(), families(), []
    for name in names():
        entry = known.get(name, {})
        if name in patterns:
            text = f"a family; give the numbers, such as {_example(name)}"
        else:
            more = [entry[key] for key in ("range", "note") if entry.get(key)]
            text = ", ".join([f"dimension {entry['dim'] if entry else get(name).dim}", *more])
        parameters = ", ".join(entry.get("parameters", ()))
        lines.append(f"{f'{name}({parameters})' if parameters else name:16}{text}")
    return lines


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
    basis_names = algebra.basis if algebra.dim <= MAX_NAMED else (*algebra.basis[:3], "...", algebra.basis[-1])
    count, shown = count_of_brackets(algebra.triples), format_brackets(algebra.triples, algebra.basis, MAX_BRACKETS)
    more = [f"and {count - len(shown)} more"] if count > len(shown) else []
    size = None if algebra.representation is None else algebra.representation.shape[1]
    return "\n".join(
        [
            str(algebra.name or "a Lie algebra"),
            *_entry("dimension", str(algebra.dim)),
            *_entry("basis", in_one_line(", ".join(basis_names), MAX_FORMULA_LENGTH)),
            *_entry("brackets", *([*shown, *more] or ["none but zero"])),
            *_entry("casimirs", *_casimirs(algebra)),
            *_entry("matrices", f"{size} x {size}" if size else "none is known; use the coadjoint representation"),
        ]
    )


def _casimirs(algebra: LieAlgebra) -> list[str]:
    known: Mapping[str, Any] = algebra.casimirs_known
    if not known and algebra.dim > MAX_SEARCHED_DIMENSION:
        return [f"not computed here, since there are {algebra.dim} coordinates; call casimirs() of the algebra"]
    found = None if known else algebra._find_casimirs()
    sentence = [found.sentence] if found is not None and found.sentence else []
    lines = []
    for name, value in (known if found is None else found).items():
        text = str(value)
        lines.append(name if text == name or " object at " in text or text.startswith("<") else f"{name} = {text}")
    return [in_one_line(line, MAX_FORMULA_LENGTH) for line in [*lines, *sentence]]
