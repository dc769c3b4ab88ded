"""The linear term of a Hamiltonian (a field, gravity, rotors): extraction and replacement."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.hamiltonians.summable import Summable, no_linear_term
from coadjoint.systems.system import System

Floats = npt.NDArray[np.float64]
SystemT = TypeVar("SystemT", bound=System)

PLACEHOLDER_COEFFICIENT = 2.0**-300
"""Placeholder for a zero coefficient that may change later; products with it vanish."""


def linear_of(H: HamiltonianLike) -> Floats:
    """Return the coefficients of the linear term, (n,), of a bound Hamiltonian; TypeError if it has none to read."""
    return _with_linear_term(H).linear_part()


def _with_linear_term(H: HamiltonianLike) -> Summable:
    if not isinstance(H, Summable):
        raise no_linear_term(H)
    return H


def with_linear(system: SystemT, linear: Floats) -> SystemT:
    """Return the system with another linear term in its Hamiltonian; without closed form, integrals and parameters."""
    H = _with_linear_term(system.hamiltonian)
    return with_hamiltonian(system, H.with_linear(np.asarray(linear, dtype=np.float64)))


def with_hamiltonian(system: SystemT, hamiltonian: HamiltonianLike) -> SystemT:
    """Return the system with another bound Hamiltonian; closed form, integrals, parameters and caches are dropped."""
    changed = copy.copy(system)
    for name in list(vars(changed)):
        if isinstance(getattr(type(system), name, None), cached_property):
            del vars(changed)[name]
    fields: dict[str, Any] = {"hamiltonian": hamiltonian, "closed_form": None, "_parameters": None, "_integrals": {}}
    for name, value in fields.items():
        if hasattr(system, name):
            object.__setattr__(changed, name, value)
    return changed


def with_placeholders(system: SystemT, coordinates: Sequence[int]) -> SystemT:
    """Replace zero linear coefficients, so that the Hamiltonian has every part that it can have for other values."""
    linear, chosen = linear_of(system.hamiltonian), np.array(coordinates, dtype=np.int64)
    absent = chosen[linear[chosen] == 0.0]
    linear[absent] = PLACEHOLDER_COEFFICIENT
    return with_linear(system, linear) if len(absent) else system


def check_linear(system: Any) -> None:
    """Raise TypeError if the Hamiltonian of a system has no linear term to replace."""
    try:
        linear_of(system.hamiltonian)
    except TypeError as reason:
        raise TypeError(f"{short(system.name)} cannot take inputs: {reason}") from None
