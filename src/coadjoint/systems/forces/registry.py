"""Forces by name, each defined in a file of this folder, as in configuration files and records."""

from __future__ import annotations

from functools import cache
from typing import Any

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.base import Force
from coadjoint.validation import classes_in, construct


@cache
def kinds() -> dict[str, type[Force]]:
    """Return the concrete forces defined in the files of this folder, by name."""
    return classes_in("coadjoint.systems.forces", Force)  # type: ignore[type-abstract]


@suggest_keywords
def names() -> tuple[str, ...]:
    """Return the names of the forces, sorted.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> names()[:3]
    ('BDot', 'BetaPlane', 'ControlMomentGyros')
    """
    return tuple(sorted(kinds()))


@suggest_keywords
def get(name: str, /, **parameters: Any) -> Force:
    """Return a force by its name, as a configuration file does.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Parameters of the force; omitted ones take their defaults.

    Returns
    -------
    Force

    Raises
    ------
    ValueError, TypeError
        Unknown force or parameter (the message suggests the nearest name), or an invalid value.

    Examples
    --------
    >>> get("LinearDamping", rate=0.5)
    LinearDamping(rate=0.5, toward=0.0)
    """
    return construct("force", kinds(), name, parameters)  # type: ignore[no-any-return]
