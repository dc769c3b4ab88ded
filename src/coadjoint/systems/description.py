"""Descriptions of systems: plain numbers and text, HTML tables for notebooks."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import html_table, plain, short
from coadjoint.systems.coordinates import coordinate_names, in_coordinates_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

MAX_FORMULA_LENGTH = 120  # characters; longer formulas are cut between two terms
_HEADING = re.compile(r"^(\w[\w ]*)\n-+\n", re.MULTILINE)


def description(name: str) -> dict[str, Any]:
    """Describe a ready-made system with its default parameters by plain numbers and text, which `json` serializes."""
    # Invariants that are no polynomials have the formula None; "attitude" is the group element that runs carry.
    system = importlib.import_module("coadjoint.systems").get(name)
    builder = ready_made_systems()[name]
    sections = _sections(inspect.getdoc(builder) or "")
    equations = sections[""].partition("\n\n")[2]
    documented = documented_parameters(builder)
    entry = gallery_entry_of(name)
    return {
        "name": name,
        "summary": summary_of(builder),
        "equations": [_line(text) for text in equations.split("\n\n") if text.strip()],
        "parameters": {
            key: {
                "default": None if value.default is inspect.Parameter.empty else plain(value.default),
                **documented.get(key, {"kind": "", "meaning": ""}),
            }
            for key, value in inspect.signature(builder).parameters.items()
        },
        "state": _line(sections.get("Returns", "").partition("\n")[2]),
        "source": _line(sections.get("Notes", "")),
        "sign": system.sign,
        "algebra": None if system.algebra is None else system.algebra.name,
        "dimension": system.dim,
        "rank": _rank(system),
        "casimirs": {key: _formula(value, system) for key, value in system.casimirs.items()},
        "integrals": {key: _formula(value, system) for key, value in system.integrals.items()},
        "exact": system.closed_form is not None,
        "attitude": _attitude(system),
        "coordinates": list(coordinate_names(system)),
        "gallery": None
        if entry is None
        else {"caption": entry.caption, "t_span": list(entry.t_span), "step": entry.step},
    }


def summary_of(documented: Callable[..., Any]) -> str:
    """Return the first paragraph of the docstring of a function or a class, in one line."""
    return _line(_sections(inspect.getdoc(documented) or "")[""].partition("\n\n")[0])


def documented_parameters(documented: Callable[..., Any]) -> dict[str, dict[str, str]]:
    """Parse the documented parameters of a function or a class: name to ``"kind"`` and ``"meaning"``."""
    return _entries(_sections(inspect.getdoc(documented) or "").get("Parameters", ""))


def _sections(text: str) -> dict[str, str]:
    """Split a numpydoc docstring into sections by heading; the first has the empty heading."""
    pieces = _HEADING.split(text)
    return {"": pieces[0].strip(), **dict(zip(pieces[1::2], map(str.strip, pieces[2::2]), strict=True))}


def _entries(text: str) -> dict[str, dict[str, str]]:
    """Parse a Parameters section: name to kind and meaning; one entry may name several."""
    parameters: dict[str, dict[str, str]] = {}
    for entry in re.split(r"\n(?=\S)", text):
        head, _, meaning = entry.partition("\n")
        names, _, kind = head.partition(" : ")
        for name in names.split(","):
            parameters[name.strip()] = {"kind": kind.strip(), "meaning": _line(meaning)}
    return parameters


def _line(text: str) -> str:
    return " ".join(text.replace("``", "").replace("`", "").split())


def _formula(value: Any, system: Any) -> str | None:
    if isinstance(value, Quadratic):
        value = value.to_polynomial() if value.dim is not None and value.dim <= 64 else None
    if not isinstance(value, Polynomial):
        return None
    text = str(in_coordinates_of(system, value))
    return text if len(text) <= MAX_FORMULA_LENGTH else text[:MAX_FORMULA_LENGTH].rpartition(" ")[0].rstrip() + "..."


def _attitude(system: Any) -> str:
    if system.representation is not None:
        return "representation"
    if system.has_matrices:
        return "matrices"
    return "none" if system.algebra is None else "coadjoint"


def _rank(system: Any) -> int:
    if hasattr(system, "generic_rank"):
        return int(system.generic_rank())
    if hasattr(system.algebra, "generic_rank"):
        return int(system.algebra.generic_rank())
    return int(np.linalg.matrix_rank(system.structure_matrix(np.cos(1.0 + np.arange(system.dim)))))


MAX_SHOWN_ENTRIES = 6
"""Number of Casimirs and coordinates in a table, and of coordinates of a Hamiltonian shown as a polynomial."""


def _energy(system: Any) -> str:
    """Return the Hamiltonian of a system as text: a quadratic one of few coordinates as a polynomial."""
    H = system.hamiltonian
    if isinstance(H, Quadratic) and (H.dim or 0) <= MAX_SHOWN_ENTRIES:
        H = in_coordinates_of(system, H.to_polynomial())
    return short(H, 200)


def system_table(system: Any, **more: str) -> str:
    """Return an HTML table of a system: dimension, algebra, Hamiltonian, Casimirs, parameters, and rows `more`."""
    base = system.unforced
    names = coordinate_names(base)
    casimirs = base.casimirs
    listed = [f"{name} = {short(casimir, 100)}" for name, casimir in list(casimirs.items())[:MAX_SHOWN_ENTRIES]]
    rest = [f"and {len(casimirs) - MAX_SHOWN_ENTRIES} more"] if len(casimirs) > MAX_SHOWN_ENTRIES else []
    shown = [*names[:MAX_SHOWN_ENTRIES], *(["..."] if system.dim > MAX_SHOWN_ENTRIES else [])]
    rows: dict[str, Any] = {
        "coordinates": f"{system.dim}: {', '.join(shown)}",
        "algebra": getattr(base.algebra, "name", None) or ("none" if base.algebra is None else "without a name"),
        "Hamiltonian": _energy(system),
        "sign": f"{system.sign:+d}",
        "Casimirs": ", ".join([*listed, *rest]) or "none is known",
    }
    parameters = base.parameters
    if parameters:
        rows["parameters"] = ", ".join(f"{name} = {short(value)}" for name, value in parameters.items())
    return html_table(system.name, {**rows, **more})
