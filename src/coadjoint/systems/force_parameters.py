"""Numeric parameters of forces, by which runs are differentiated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force
from coadjoint.systems.parameter_differences import (
    DISTANCE,
    MOST_DISTANCES,
    NEARER,
    NODES,
    RADIUS,
    moved_entry,
    sizes_of_entries,
)
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

# Entries of a parameter of which it is tried whether they may change.
MAX_TRIED = 16


class ForceParameter(NamedTuple):
    """A parameter of the force at this position."""

    position: int
    field: str
    value: Floats

    @property
    def symmetric(self) -> bool:
        """Whether it is a matrix that must be symmetric."""
        return self.value.ndim == 2 and self.field == "metric"


def with_value(force: Any, field: str, value: Floats) -> Force:
    """Return the force with another value of a parameter."""
    outer, _, inner = field.partition(".")
    if inner:
        return replace(force, **{outer: with_value(getattr(force, outer), inner, value)})
    return replace(force, **{field: value if value.ndim else float(value)})


def force_parameters(system: System) -> dict[str, ForceParameter]:
    """Return the real parameters of the forces, which may change in both directions, by "label.parameter"."""
    return {name: one for name, one in force_numbers(system).items() if _may_change(one, system)}


def force_numbers(system: System) -> dict[str, ForceParameter]:
    """Return the real numbers and arrays of them of the forces, also those that cannot change."""
    return {
        f"{label}.{field}": ForceParameter(position, field, value)
        for position, (label, force) in enumerate(zip(system.labels, system.forces, strict=True))
        for field, value in _numbers_of(force)
    }


def _numbers_of(force: Force) -> Iterator[tuple[str, Floats]]:
    """Yield the numbers of a force, and those of a law in it, such as ``law.damping``."""
    for field, given in (force.parameters() if is_dataclass(type(force)) else {}).items():
        if isinstance(given, Force):
            yield from ((f"{field}.{inner}", value) for inner, value in _numbers_of(given))
        elif field not in force.selectors and (value := real_numbers(given)) is not None:
            yield field, value


def with_force_values(system: System, plain: Any, values: Mapping[str, Floats]) -> System:
    """Return another Hamiltonian part with the same forces, of which these parameters have other values."""
    forces, known = list(system.forces), force_numbers(system)
    for name, value in values.items():
        forces[known[name].position] = with_value(forces[known[name].position], known[name].field, value)
    return plain.with_forces(*forces)


def real_numbers(given: Any) -> Floats | None:
    """Return real numbers, not whole ones by type, as an array; None for anything else."""
    try:
        array = np.asarray(given)
    except ValueError:
        return None
    return array.astype(np.float64) if array.dtype.kind == "f" and array.size else None


def check_may_change(system: System, name: str) -> None:
    """Raise ValueError for a value that cannot change in both directions, such as zero, where roots have no slope."""
    one = force_numbers(system)[name]
    if not _may_change(one, system):
        raise ValueError(
            f"{name} cannot be differentiated at {short(one.value.tolist())}: the force accepts no values on both sides"
        )


def _may_change(one: ForceParameter, system: System) -> bool:
    """Return whether the force is defined at the nodes of some differences that are farthest from the value."""
    force, farthest = system.forces[one.position], NODES[-1] * DISTANCE * RADIUS * sizes_of_entries(one.value)
    for scale in NEARER ** np.arange(MOST_DISTANCES):
        try:
            for index in islice(np.ndindex(one.value.shape), MAX_TRIED):
                for by in (scale * farthest[index], -scale * farthest[index]):
                    moved = moved_entry(one.value, index, float(by), one.symmetric)
                    with_value(force, one.field, moved).check(system.unforced)
        except (TypeError, ValueError):
            continue
        return True
    return False
