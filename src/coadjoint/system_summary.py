"""Plain-text description of ready-made systems."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.systems.description import description
from coadjoint.systems.registry import gallery_entry_of

LINE_WIDTH = 100  # characters of a line of the text
MAX_NAMED = 30  # coordinates that are listed by name: some two lines
ATTITUDES = {
    "representation": "attitude=True",
    "coadjoint": 'attitude="coadjoint"; no representation is known',
    "matrices": "none: schemes for matrices do not compute a group element",
    "none": "none, for there is no algebra",
}


def summarize_system(name: str) -> dict[str, Any]:
    """Return the `description` of a ready-made system, with ``"scheme"``, ``"step"`` and ``"command"``.

    Step and command are None if the system has no gallery entry.

    Examples
    --------
    >>> summary = summarize_system("rigid_body")
    >>> summary["scheme"], summary["command"]
    ('Splitting(order=4...)', 'coadjoint gallery --out gallery rigid_body')
    """
    summary = description(name)
    gallery_entry = gallery_entry_of(name)
    system = importlib.import_module("coadjoint.systems").get(name)
    summary["scheme"] = str(suggested_scheme(system))
    summary["step"] = None if gallery_entry is None else gallery_entry.step
    summary["command"] = None if gallery_entry is None else f"coadjoint gallery --out gallery {name}"
    return summary


def system_text(summary: Mapping[str, Any]) -> str:
    """Format a description of `summarize_system` as text, in lines of at most 100 characters.

    Examples
    --------
    >>> print(system_text(summarize_system("riccati")).splitlines()[0])
    riccati(constant=1.0, linear=0.0, quadratic=1.0)
    """
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
    return repr(tuple(_tuples(v) for v in value)) if isinstance(value, list) else repr(value)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
