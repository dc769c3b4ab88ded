"""Plain-text description of ready-made systems."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from coadjoint.methods.suggested_scheme import suggested_scheme
from coadjoint.systems.description import description
from coadjoint.systems.registry import gallery_entry_of

LINE_WIDTH = 100
MOST_NAMED = 30
ATTITUDES = {
    "representation": "attitude=True",
    "coadjoint": 'attitude="coadjoint"; no representation is known',
    "matrices": "none: schemes for matrices do not compute a group element",
    "none": "none, for there is no algebra",
}


def summarize_system(name: str) -> dict[str, Any]:
    """Return the description of a ready-made system with a suggested scheme and step.

    Parameters
    ----------
    name : str
        One of ``co.systems.names()``.

    Returns
    -------
    dict
        As `coadjoint.systems.description.description`, with ``"scheme"``, and ``"step"`` and ``"command"`` (None if
        the system has no gallery entry); serializable by `json`.

    Raises
    ------
    ValueError
        Unknown system; the message has the nearest name.

    Examples
    --------
    >>> told = summarize_system("rigid_body")
    >>> told["scheme"], told["command"]
    ('Splitting(order=4...)', 'coadjoint gallery --out gallery rigid_body')
    """
    told = description(name)
    gallery_entry = gallery_entry_of(name)
    system = importlib.import_module("coadjoint.systems").get(name)
    told["scheme"] = str(suggested_scheme(system))
    told["step"] = None if gallery_entry is None else gallery_entry.step
    told["command"] = None if gallery_entry is None else f"coadjoint gallery --out gallery {name}"
    return told


def system_text(told: Mapping[str, Any]) -> str:
    """Format a description as text.

    Parameters
    ----------
    told : mapping
        From `summarize_system`.

    Returns
    -------
    str
        Lines of at most 100 characters.

    Examples
    --------
    >>> print(system_text(summarize_system("riccati")).splitlines()[0])
    riccati(constant=1.0, linear=0.0, quadratic=1.0)
    """
    return "\n".join(_lines(told))


def _lines(told: Mapping[str, Any]) -> Iterator[str]:
    given = ", ".join(f"{key}={_shown(p['default'])}" for key, p in told["parameters"].items())
    yield from textwrap.wrap(f"{told['name']}({given})", LINE_WIDTH, subsequent_indent="    ")
    yield from textwrap.wrap(told["summary"], LINE_WIDTH, initial_indent="    ", subsequent_indent="    ")
    for text in told["equations"]:
        yield ""
        yield from textwrap.wrap(text, LINE_WIDTH, initial_indent="    ", subsequent_indent="    ")
    yield ""
    for key, parameter in told["parameters"].items():
        yield from _entry(key, f"{parameter['meaning']} Default: {_shown(parameter['default'])}.")
    yield ""
    algebra = "none: J(x) is not linear in x" if told["algebra"] is None else told["algebra"]
    yield from _entry("algebra", f"{algebra}; dimension {told['dimension']}, rank {told['rank']}")
    yield from _entry("sign", f"{told['sign']:+d}")
    if len(told["coordinates"]) <= MOST_NAMED:
        yield from _entry("coordinates", ", ".join(told["coordinates"]))
    for kind, none in (("casimirs", "none is known"), ("integrals", "none beside H and the Casimirs is known")):
        found = told[kind]
        yield from _entry(kind, "; ".join(_named(key, formula) for key, formula in found.items()) or none)
    if told["state"]:
        yield from _entry("system", told["state"])
    yield from _entry("closed form", "exact(x0, t)" if told["exact"] else "none is known for these parameters")
    yield from _entry("attitude", ATTITUDES[told["attitude"]])
    step = "" if told["step"] is None else f", step {told['step']:g} for the motion of the gallery"
    yield from _entry("begin with", told["scheme"] + step)
    if told["source"]:
        yield from _entry("source", told["source"])
    if told["command"]:
        yield from _entry("see it", told["command"])


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(text, LINE_WIDTH, initial_indent=f"{name:14}", subsequent_indent=" " * 14)


def _named(name: str, formula: str | None) -> str:
    return name if formula is None or formula == name else f"{name} = {formula}"


def _shown(value: Any) -> str:
    return repr(tuple(_tuples(v) for v in value)) if isinstance(value, list) else repr(value)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
