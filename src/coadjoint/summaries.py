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
ATTITUDES = {
    "representation": "attitude=True",
    "coadjoint": 'attitude="coadjoint"; no representation is known',
    "matrices": "none: schemes for matrices do not compute a group element",
    "none": "none, for there is no algebra",
}


def summarize_system(name: str) -> dict[str, Any]:
    """Return the `description` of a ready-made system, with ``"scheme"``, ``"step"`` and ``"command"``."""
    summary = description(name)
    gallery_entry = gallery_entry_of(name)
    system = importlib.import_module("coadjoint.systems").get(name)
    summary["scheme"] = str(suggested_scheme(system))
    summary["step"] = None if gallery_entry is None else gallery_entry.step
    summary["command"] = None if gallery_entry is None else f"coadjoint gallery --out gallery {name}"
    return summary


def system_text(summary: Mapping[str, Any]) -> str:
    """Format a description of `summarize_system` as text, in lines of at most 100 characters."""
    return "\n".join(_lines(summary))


def _lines(summary: Mapping[str, Any]) -> Iterator[str]:
    parameters = ", ".join(f"{key}={_shown(p['default'])}" for key, p in summary["parameters"].items())
    yield from textwrap.wrap(f"{summary['name']}({parameters})", LINE_WIDTH, subsequent_indent="    ")
    yield from textwrap.wrap(summary["summary"], LINE_WIDTH, initial_indent="    ", subsequent_indent="    ")
    for text in summary["equations"]:
        yield ""
        yield from textwrap.wrap(text, LINE_WIDTH, initial_indent="    ", subsequent_indent="    ")
    yield ""
    for key, parameter in summary["parameters"].items():
        yield from _entry(key, f"{parameter['meaning']} Default: {_shown(parameter['default'])}.")
    yield ""
    algebra = "none: J(x) is not linear in x" if summary["algebra"] is None else summary["algebra"]
    yield from _entry("algebra", f"{algebra}; dimension {summary['dimension']}, rank {summary['rank']}")
    yield from _entry("sign", f"{summary['sign']:+d}")
    if len(summary["coordinates"]) <= MAX_NAMED:
        yield from _entry("coordinates", ", ".join(summary["coordinates"]))
    for kind, missing in (("casimirs", "none is known"), ("integrals", "none beside H and the Casimirs is known")):
        formulas = summary[kind]
        yield from _entry(kind, "; ".join(_named(key, formula) for key, formula in formulas.items()) or missing)
    if summary["state"]:
        yield from _entry("system", summary["state"])
    yield from _entry("closed form", "exact(x0, t)" if summary["exact"] else "none is known for these parameters")
    yield from _entry("attitude", ATTITUDES[summary["attitude"]])
    step = "" if summary["step"] is None else f", step {summary['step']:g} for the motion of the gallery"
    yield from _entry("begin with", summary["scheme"] + step)
    if summary["source"]:
        yield from _entry("source", summary["source"])
    if summary["command"]:
        yield from _entry("see it", summary["command"])


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(text, LINE_WIDTH, initial_indent=f"{name:14}", subsequent_indent=" " * 14)


def _named(name: str, formula: str | None) -> str:
    return name if formula is None or formula == name else f"{name} = {formula}"


def _shown(value: Any) -> str:
    return repr(as_tuples(value))


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
    return "\n".join(_algebra_lines(algebra))


def _algebra_lines(algebra: LieAlgebra) -> Iterator[str]:
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
    found = None if known else algebra._find_casimirs()
    sentence = [found.sentence] if found is not None and found.sentence else []
    formulas = [_formula(name, value) for name, value in (known if found is None else found).items()]
    return [in_one_line(line, MAX_FORMULA_LENGTH) for line in [*formulas, *sentence]]


def _formula(name: str, value: Any) -> str:
    text = str(value)
    return name if text == name or " object at " in text or text.startswith("<") else f"{name} = {text}"
