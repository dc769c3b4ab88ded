"""Ready-made systems, as functions and by name (``co.systems``)."""

from __future__ import annotations

import inspect
from typing import Any

from coadjoint.errors import unknown_attribute
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.coordinates import canonical_state
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm
from coadjoint.systems.lattices.spins_on_crystals import spins
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.planet import RotatingPlanet
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, FunctionStream, Weights
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.registry import ready_made, ready_made_systems
from coadjoint.validation import check_parameters, read_choice

# The functions shadow the modules of the same name: co.systems.rigid_body is the function.
globals().update(ready_made_systems())

BUILDING_BLOCKS = (
    Circulants,
    DiagonalSolve,
    FunctionStream,
    FunctionTerm,
    RotatingPlanet,
    PolynomialTerm,
    QuadraticTerm,
    Weights,
    canonical_state,
    ready_made,
    spins,
)
"""What user-defined systems are made of: streams of matrices, terms of Hamiltonians, crystals, registration."""

__all__ = sorted([*ready_made_systems(), *(block.__name__ for block in BUILDING_BLOCKS), "get", "names"])


def __getattr__(name: str) -> Any:
    # Of functions and classes, which begin with a capital, those like the name are listed.
    raise unknown_attribute("co.systems", name, [one for one in __all__ if one[0].isupper() == name[:1].isupper()])


def __dir__() -> list[str]:
    return __all__


@suggest_keywords
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
    return tuple(sorted(ready_made_systems()))


@suggest_keywords
def get(name: str, **parameters: Any) -> LiePoissonSystem | PoissonSystem:
    """Return a ready-made system by its name, as a configuration file does.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Arguments of the function of that name; omitted ones take their defaults.

    Returns
    -------
    LiePoissonSystem
        ``get(s.name, **s.parameters)`` makes the system s again.

    Raises
    ------
    ValueError
        Unknown system or parameter (the message suggests the nearest name), or an invalid value.

    Examples
    --------
    >>> get("rigid_body", inertia=(1.0, 2.0, 2.5)).parameters
    {'inertia': (1.0, 2.0, 2.5)}
    """
    systems = ready_made_systems()
    read_choice(name, "system", systems)
    check_parameters(name, parameters, inspect.signature(systems[name]).parameters)
    return systems[name](**parameters)
