"""What moves: ready-made systems, by function or by name (``co.systems``)."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from coadjoint.errors import unknown_name
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.paper_examples import paper_a37, paper_rigid_body
from coadjoint.systems.rigid_body import rigid_body

__all__ = ["get", "names", "paper_a37", "paper_rigid_body", "rigid_body"]

# A new system is one file and one entry here.
_SYSTEMS: dict[str, Callable[..., LiePoissonSystem]] = {
    "paper_a37": paper_a37,
    "paper_rigid_body": paper_rigid_body,
    "rigid_body": rigid_body,
}


def names() -> tuple[str, ...]:
    """Return the names of the ready-made systems, sorted.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> "rigid_body" in names()
    True
    """
    return tuple(sorted(_SYSTEMS))


def get(name: str, **parameters: Any) -> LiePoissonSystem:
    """Return a ready-made system by its name, as a configuration file does.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Those of the function of that name; what is left out has its default.

    Returns
    -------
    LiePoissonSystem
        ``get(s.name, **s.parameters)`` makes the system s again.

    Raises
    ------
    ValueError
        No such system, or no such parameter (the nearest name is given), or a value is wrong.

    Examples
    --------
    >>> get("rigid_body", inertia=(1.0, 2.0, 4.0)).parameters
    {'inertia': (1.0, 2.0, 4.0)}
    """
    if name not in _SYSTEMS:
        raise unknown_name("system", name, _SYSTEMS)
    known = inspect.signature(_SYSTEMS[name]).parameters
    for parameter in parameters:
        if parameter not in known:
            raise unknown_name(f"parameter of {name}", parameter, known)
    return _SYSTEMS[name](**parameters)
