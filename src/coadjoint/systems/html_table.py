"""HTML tables of systems for notebooks."""

from __future__ import annotations

from typing import Any

from coadjoint.short_repr import html_table, short
from coadjoint.systems.coordinate_names import coordinate_names
from coadjoint.systems.hamiltonians.quadratic import Quadratic

MAX_POLYNOMIAL_COORDINATES = 6
"""Number of Casimirs and coordinates shown."""


def _energy(H: Any) -> str:
    """Return a Hamiltonian as text: a quadratic one of few coordinates as a polynomial."""
    return short(
        H.to_polynomial() if isinstance(H, Quadratic) and (H.dim or 0) <= MAX_POLYNOMIAL_COORDINATES else H, 200
    )


def system_table(system: Any, **more: str) -> str:
    """Return an HTML table of a system: dimension, algebra, Hamiltonian, Casimirs, parameters, and further rows `more`.

    Examples
    --------
    >>> import coadjoint as co
    >>> "x1^2 + x2^2 + x3^2" in system_table(co.systems.rigid_body((1, 2, 3)))
    True
    """
    own = getattr(system, "system", system)
    names = coordinate_names(own, system.dim)
    casimirs = own.casimirs
    listed = [
        f"{name} = {short(casimir, 100)}" for name, casimir in list(casimirs.items())[:MAX_POLYNOMIAL_COORDINATES]
    ]
    beyond = (
        [f"and {len(casimirs) - MAX_POLYNOMIAL_COORDINATES} more"] if len(casimirs) > MAX_POLYNOMIAL_COORDINATES else []
    )
    shown = [*names[:MAX_POLYNOMIAL_COORDINATES], *(["..."] if system.dim > MAX_POLYNOMIAL_COORDINATES else [])]
    rows: dict[str, Any] = {
        "coordinates": f"{system.dim}: {', '.join(shown)}",
        "algebra": getattr(own.algebra, "name", None) or ("none" if own.algebra is None else "without a name"),
        "Hamiltonian": _energy(system.hamiltonian),
        "sign": f"{system.sign:+d}",
        "Casimirs": ", ".join([*listed, *beyond]) or "none is known",
    }
    parameters = getattr(own, "parameters", None)
    if parameters:
        rows["parameters"] = ", ".join(f"{name} = {short(value)}" for name, value in parameters.items())
    return html_table(system.name, {**rows, **more})
