"""The register of ready-made systems: a system is one file in this folder, and nothing else names it."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

Builder = TypeVar("Builder", bound=Callable[..., Any])

_FOUND: dict[str, Callable[..., Any]] = {}


def ready_made(function: Builder) -> Builder:
    """Register a function that makes a system, under its own name."""
    _FOUND[function.__name__] = function
    return function


def ready_made_systems() -> Mapping[str, Callable[..., Any]]:
    """Return all ready-made systems by name; every file of the folder is imported for it.

    Returns
    -------
    mapping of str to callable

    Examples
    --------
    >>> "rigid_body" in ready_made_systems()
    True
    """
    package = importlib.import_module("coadjoint.systems")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return MappingProxyType(_FOUND)
