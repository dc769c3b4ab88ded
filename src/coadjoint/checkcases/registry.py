"""Registry of check-cases: functions in the files of `coadjoint.checkcases.cases`, registered by a decorator."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from coadjoint.checkcases.check_case import CheckCase
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.validation import read_choice

Builder = Callable[..., CheckCase]

_REGISTRY: dict[str, Builder] = {}


def checkcase(function: Builder) -> Builder:
    """Register a function that makes a check-case, under its own name; its arguments are parameters with defaults."""
    _REGISTRY[function.__name__] = suggest_keywords(function)
    return _REGISTRY[function.__name__]


@cache
def builders() -> Mapping[str, Builder]:
    """Return the functions that make the check-cases, by name."""
    package = importlib.import_module("coadjoint.checkcases.cases")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return dict(sorted(_REGISTRY.items()))


def title_of(name: str) -> str:
    """Return what a check-case is, in one line."""
    return (inspect.getdoc(builders()[name]) or "").partition("\n")[0].removeprefix("Return ").rstrip(".")


def defaults_of(name: str) -> dict[str, Any]:
    """Return the parameters of a check-case with their defaults."""
    return {key: each.default for key, each in inspect.signature(builders()[name]).parameters.items()}


@suggest_keywords
def names() -> tuple[str, ...]:
    """Return the names of the check-cases.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> import coadjoint as co
    >>> "brick" in co.checkcases.names()
    True
    """
    return tuple(builders())


def get(name: str, /, **parameters: Any) -> CheckCase:
    """Return a check-case by its name: a problem with a certain answer for simulators of rotations.

    Choose one to test a simulator, in any language: its `CheckCase.reference` is the motion at any times, and
    `CheckCase.compare` finds the errors of a file and what they look like. The command is ``coadjoint checkcase``.

    Parameters
    ----------
    name : str
        One of `names`.
    **parameters
        Parameters of the case that differ from its defaults, in SI units, such as ``inertia=(1, 2, 2.5)`` and
        ``rates=(0.1, 2.0, 0.1)`` of ``"free_body"``. Published cases have none.

    Returns
    -------
    CheckCase

    Raises
    ------
    TypeError, ValueError
        An unknown name or parameter, or a value that the case does not permit.

    Examples
    --------
    >>> import coadjoint as co
    >>> case = co.checkcases.get("free_body", rates=(0.1, 200.0, 0.1))
    >>> sorted(case.reference([0.0, 0.01]))
    ['qw', 'qx', 'qy', 'qz', 't', 'wx', 'wy', 'wz']
    """
    return builders()[read_choice(name, "check-case", builders())](**parameters)
