"""Constants of spin models by name: exchange and biquadratic couplings of bonds, Stevens coefficients of sites."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from coadjoint.short_repr import short
from coadjoint.systems.coefficients import EnergyCoefficients, coefficients_of
from coadjoint.systems.lattices.bonds import AXIAL, LETTERS
from coadjoint.validation import read_title

Constants = Mapping[str, tuple[float, Callable[[], EnergyCoefficients]]]
"""Values by name, with functions for the coefficients of the derivative of the energy, which is linear in each."""

FIELDS = ("couplings", "biquadratics", "anisotropies")
OTHERS = ("x0", "attitude0", "M", "linear", "coefficients", "exchange", "tensor", "dm", "field", "on_site", "moments")
"""Names of other parameters and unknowns of a spin system."""


def read_name(name: Any, default: str, symbol: str) -> tuple[str, str]:
    """Validate the name of a constant that a user gives, None for the default; return it and its text in models."""
    if name is None or name == default:
        return default, symbol
    if read_title(name, "name") in OTHERS or "." in name:
        raise ValueError(f"name is {short(name)}, as of other parameters; give another one, such as 'J1'")
    return name, name


def constants_of(model: Any) -> Constants:
    """Return the constants of a model, such as ``"exchange 1"`` and ``"B40 Mn 0"``; an error if one has two values."""
    found: dict[str, tuple[float, list[tuple[str, int, str]]]] = {}
    for field, position, term in _terms(model):
        for key, name, value in _named(field, term):
            known, places = found.setdefault(name, (value, []))
            if known != value:
                raise ValueError(
                    f"the name {short(name)} has the value {known!r} in this model, and in a further term {value!r}; "
                    "give one value, or another name"
                )
            places.append((field, position, key))
    return {name: (value, partial(_derivative, model, places)) for name, (value, places) in found.items()}


def with_constants(model: Any, values: Mapping[str, float]) -> Any:
    """Return the model with other values of some constants; ValueError if symmetry forbids them together."""
    changed = {field: list(getattr(model._declared, field)) for field in FIELDS}
    for field, position, term in _terms(model):
        given = {key: values.get(name, value) for key, name, value in _named(field, term)}
        if given != dict(term.given):
            changed[field][position] = _alone(model, field, term, given)
    return model._with(**{field: tuple(terms) for field, terms in changed.items()})


def _terms(model: Any) -> Iterator[tuple[str, int, Any]]:
    """Yield the terms with constants, with their places in the declaration."""
    for field in FIELDS:
        yield from ((field, k, term) for k, term in enumerate(getattr(model._declared, field)) if term.given)


def _named(field: str, term: Any) -> Iterator[tuple[str, str, float]]:
    """Yield key, name and value of the constants of a term."""
    of_site = field == "anisotropies"
    for key, value in term.given.items():
        yield key, f"{key} {term.source.label} {term.source.number}" if of_site else f"{term.name} {key}".strip(), value


def _alone(model: Any, field: str, term: Any, given: Mapping[str, float], checked: bool = True) -> Any:
    """Return a term with other values."""
    bare = type(model)(replace(model._declared, **dict.fromkeys(FIELDS, ()), field=None, dipolar=False, twist=None))
    bond = term.source
    if field == "anisotropies":
        found = bare._with_stevens(bond, given, checked)
    elif term.what == "biquadratic":
        found = bare.biquadratic(bond, given[""], name=term.name)
    elif "" in given:
        found = bare.exchange(bond, given[""], name=term.name)
    else:
        J = np.sum([value * bond.basis[LETTERS.index(key)] for key, value in given.items()], axis=0)
        vector = [J[entry] for entry in AXIAL]
        found = getattr(bare, term.what)(bond, J if term.what == "exchange" else vector, name=term.name)
    return getattr(found._declared, field)[0]


def _derivative(model: Any, places: Sequence[tuple[str, int, str]]) -> EnergyCoefficients:
    """Return the coefficients of the energy of a constant that is 1 at its places, without all other terms."""
    units: dict[str, Any] = {field: () for field in FIELDS}
    for field, position, key in places:
        term = getattr(model._declared, field)[position]
        units[field] += (_alone(model, field, term, {key: 1.0}, checked=False)._replace(given=None),)
    twist = model._declared.twist and model._declared.twist._replace(checked=False)  # what is tied is not invariant
    declared = replace(model._declared, **units, field=None, dipolar=False, twist=twist)
    return coefficients_of(type(model)(declared)).without_zeros()
