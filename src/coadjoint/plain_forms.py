"""Plain forms: objects as numbers, text, lists and mappings, for JSON and TOML, and objects made of them again."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import singledispatch
from typing import Any

import numpy as np

from coadjoint.short_repr import short
from coadjoint.validation import check_parameters, read_choice


@singledispatch
def plain(value: Any) -> Any:
    """Return the plain form of a value; the modules of polynomials, schemes and forces register theirs.

    Examples
    --------
    >>> plain({"inertia": np.array([1.0, 2.0]), "rate": Fraction(1, 3), "shift": (1j,)})
    {'inertia': [1.0, 2.0], 'rate': '1/3', 'shift': {'real': [0.0], 'imaginary': [1.0]}}
    """
    return value


@plain.register(np.ndarray)
@plain.register(np.generic)
def _(value: Any) -> Any:
    if value.dtype.kind == "c":
        return {"real": value.real.tolist(), "imaginary": value.imag.tolist()}
    return plain(value.tolist()) if value.dtype.kind == "O" else value.tolist()


@plain.register(tuple)
@plain.register(list)
def _(value: Any) -> Any:
    first = value
    while isinstance(first, tuple | list) and first:
        first = first[0]
    return plain(np.array(value)) if isinstance(first, complex) else [plain(entry) for entry in value]


@plain.register(Mapping)
def _(value: Any) -> Any:
    return {str(key): plain(entry) for key, entry in value.items()}


@plain.register(Fraction)
def _(value: Any) -> Any:
    return f"{value.numerator}/{value.denominator}"


def construct(what: str, kinds: Mapping[str, Callable[..., Any]], name: Any, parameters: Mapping[str, Any]) -> Any:
    """Return what is made by its name in `kinds` and its parameters, of which objects may be described by mappings."""
    made = kinds[read_choice(name, what, kinds)]
    known = inspect.signature(made).parameters
    required = [key for key, parameter in known.items() if parameter.default is inspect.Parameter.empty]
    check_parameters(str(name), parameters, known, required)

    def read(value: Any) -> Any:
        if isinstance(value, Mapping):
            if "name" in value:
                return from_description(what, kinds, value)
            return {key: read(entry) for key, entry in value.items()}
        return tuple(map(read, value)) if isinstance(value, list) else value

    return made(**{key: read(value) for key, value in parameters.items()})


def from_description(what: str, kinds: Mapping[str, Callable[..., Any]], description: Any) -> Any:
    """Return the object that a mapping describes: its name, and parameters beside it or in ``"parameters"``.

    Examples
    --------
    >>> from_description("number", {"complex": complex}, {"name": "complex", "parameters": {"real": 1, "imag": 2}})
    (1+2j)
    """
    if not isinstance(description, Mapping):
        raise TypeError(
            f"a {what} is described by a mapping, not by {short(description)}; give its name and parameters"
        )
    parameters = dict(description)
    name, nested = parameters.pop("name", None), parameters.pop("parameters", {})
    if not isinstance(name, str) or not isinstance(nested, Mapping):
        raise ValueError(
            f"{short(dict(description))} is not a {what}; give its name and parameters, such as name = {min(kinds)!r}"
        )
    repeated = sorted(parameters.keys() & nested.keys())
    if repeated:
        raise ValueError(f"the parameter {short(repeated[0])} of {name} is given twice; give it once")
    return construct(what, kinds, name, {**parameters, **nested})
