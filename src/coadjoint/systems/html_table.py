"""HTML tables of systems for notebooks."""

from __future__ import annotations

from typing import Any

from coadjoint.short_repr import html_table, short
from coadjoint.systems.coordinate_names import coordinate_names
from coadjoint.systems.hamiltonians.quadratic import Quadratic

MOST = 6
"""Number of Casimirs and coordinates shown."""


def _energy(H: Any) -> str:
    """Return a Hamiltonian as text: a quadratic one of few coordinates as a polynomial."""
    return short(H.to_polynomial() if isinstance(H, Quadratic) and (H.dim or 0) <= MOST else H, 200)


def table_of(system: Any, **more: str) -> str:
    """Return an HTML table of a system: dimension, algebra, Hamiltonian, Casimirs, parameters, and further rows `more`.

    Examples
    --------
    >>> import coadjoint as co
    >>> "x1^2 + x2^2 + x3^2" in table_of(co.systems.rigid_body((1, 2, 3)))
    True
    """
    own = getattr(system, "system", system)
    names = coordinate_names(own, system.dim)
    casimirs = own.casimirs
    listed = [f"{name} = {short(casimir, 100)}" for name, casimir in list(casimirs.items())[:MOST]]
    beyond = [f"and {len(casimirs) - MOST} more"] if len(casimirs) > MOST else []
    rows: dict[str, Any] = {
        "coordinates": f"{system.dim}: {', '.join([*names[:MOST], *(['...'] if system.dim > MOST else [])])}",
        "algebra": getattr(own.algebra, "name", None) or ("none" if own.algebra is None else "without a name"),
        "Hamiltonian": _energy(system.hamiltonian),
        "sign": f"{system.sign:+d}",
        "Casimirs": ", ".join([*listed, *beyond]) or "none is known",
    }
    parameters = getattr(own, "parameters", None)
    if parameters:
        rows["parameters"] = ", ".join(f"{name} = {short(value)}" for name, value in parameters.items())
    return html_table(system.name, {**rows, **more})
