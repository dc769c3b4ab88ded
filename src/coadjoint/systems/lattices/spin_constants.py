"""Constants of spin models by name: biquadratic couplings of bonds and Stevens coefficients of sites."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from coadjoint.systems.coefficients import EnergyCoefficients, coefficients_of

Constants = Mapping[str, tuple[float, Callable[[], EnergyCoefficients]]]
"""Values by name, with functions for the coefficients of the derivative of the energy, which is linear in each."""

FIELDS = ("couplings", "biquadratics", "anisotropies")


def constants_of(model: Any) -> Constants:
    """Return the constants of a model, such as ``"biquadratic 1"`` and ``"B40 Mn 0"``."""
    return {
        name: (value, partial(_derivative, model, field, position, key))
        for field, position, term in _terms(model)
        for key, name, value in _named(term)
    }


def with_constants(model: Any, values: Mapping[str, float]) -> Any:
    """Return the model with other values of some constants; ValueError if symmetry forbids them together."""
    changed = {field: list(getattr(model._declared, field)) for field in FIELDS}
    for field, position, term in _terms(model):
        given = {key: values.get(name, value) for key, name, value in _named(term)}
        if given != dict(term.given):
            changed[field][position] = _alone(model, field, term, given)
    return model._with(**{field: tuple(terms) for field, terms in changed.items()})


def _terms(model: Any) -> Iterator[tuple[str, int, Any]]:
    """Yield the terms with constants, with their places in the declaration."""
    for field in FIELDS:
        yield from ((field, k, term) for k, term in enumerate(getattr(model._declared, field)) if term.given)


def _named(term: Any) -> Iterator[tuple[str, str, float]]:
    """Yield key, name and value of the constants of a term."""
    for key, value in term.given.items():
        where = term.source.name if key == "K" else f"{term.source.label} {term.source.number}"
        yield key, f"{'biquadratic' if key == 'K' else key} {where}", value


def _alone(model: Any, field: str, term: Any, given: Mapping[str, float], checked: bool = True) -> Any:
    """Return a term with other values."""
    bare = type(model)(replace(model._declared, **dict.fromkeys(FIELDS, ()), field=None, dipolar=False, twist=None))
    if "K" in given:
        return getattr(bare.biquadratic(term.source, given["K"])._declared, field)[0]
    return bare._with_stevens(term.source, given, checked)._declared.anisotropies[0]


def _derivative(model: Any, field: str, position: int, key: str) -> EnergyCoefficients:
    """Return the coefficients of the energy of a constant that is 1, without all other terms."""
    term = getattr(model._declared, field)[position]
    unit = _alone(model, field, term, {key: 1.0}, checked=False)
    twist = model._declared.twist if key == "K" else None  # a single function is not invariant
    declared = replace(
        model._declared, **(dict.fromkeys(FIELDS, ()) | {field: (unit,)}), field=None, dipolar=False, twist=twist
    )
    return coefficients_of(type(model)(declared)).without_zeros()
