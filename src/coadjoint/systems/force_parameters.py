"""Numeric parameters of forces, by which runs are differentiated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.coefficient_derivatives import MAX_REDUCTIONS, RADIUS, SMALL_ENTRY, largest_entry
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.forces.base import Force
from coadjoint.systems.parameter_differences import DISTANCE, NODES

Floats = NDArray[np.float64]

# Entries of a parameter of which it is tried whether they may change alone.
MAX_TRIED = 16


class ForceParameter(NamedTuple):
    """A parameter of the force at this position: its value, and by how much each entry may change."""

    position: int
    field: str
    value: Floats
    radii: Floats

    @property
    def symmetric(self) -> bool:
        """Whether it is a matrix that must be symmetric."""
        return self.value.ndim == 2 and self.field == "metric" and np.array_equal(self.value, self.value.T)

    def moved(self, force: Force, value: Floats, index: tuple[int, ...], by: float) -> Force:
        """Return the force with one entry of the parameter moved; of a symmetric matrix half its mirror image too."""
        changed = value.copy()
        if self.symmetric and index[0] != index[1]:
            changed[index] += 0.5 * by
            changed[index[::-1]] = changed[index]
        else:
            changed[index] += by
        return with_value(force, self.field, changed)


def with_value(force: Any, field: str, value: Floats) -> Force:
    """Return the force with another value of a parameter."""
    return replace(force, **{field: value if value.ndim else float(value)})


def force_parameters(system: ForcedSystem) -> dict[str, ForceParameter]:
    """Return the parameters of the forces by name, the label of the force and that of its parameter.

    They are real numbers and arrays of them, of which every entry may change a little in both directions.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
    >>> list(force_parameters(body))
    ['LinearDamping.rate', 'LinearDamping.toward']
    """
    return {
        f"{label}.{found.field}": found
        for position, (label, force) in enumerate(zip(system.labels, system.forces, strict=True))
        for found in _numbers_of(position, force, system.system)
    }


def with_force_values(system: ForcedSystem, plain: Any, values: Mapping[str, Floats]) -> ForcedSystem:
    """Return another Hamiltonian part with the same forces, of which these parameters have other values."""
    forces, known = list(system.forces), force_parameters(system)
    for name, value in values.items():
        forces[known[name].position] = with_value(forces[known[name].position], known[name].field, value)
    return ForcedSystem(plain, forces)


def _numbers_of(position: int, force: Force, plain: Any) -> Iterator[ForceParameter]:
    if not is_dataclass(force):
        return
    for field, given in force.parameters().items():
        value = None if field in force.selectors else _real(given)
        if value is None:
            continue
        largest = largest_entry(value)
        sizes = np.where(np.abs(value) > SMALL_ENTRY * largest, np.abs(value), largest)
        for reduction in range(MAX_REDUCTIONS):
            found = ForceParameter(position, field, value, RADIUS * 0.25**reduction * sizes)
            if _may_change(found, force, plain):
                yield found
                break


def _real(given: Any) -> Floats | None:
    """Return real numbers, not whole ones by type, as an array; None for anything else."""
    try:
        array = np.asarray(given)
    except ValueError:
        return None
    return array.astype(np.float64) if array.dtype.kind == "f" and array.size else None


def _may_change(parameter: ForceParameter, force: Force, plain: Any) -> bool:
    """Return whether the force is defined at the nodes of the differences that are farthest from the value."""
    entries = list(np.ndindex(parameter.value.shape))[:MAX_TRIED]
    try:
        for entry in entries:
            farthest = float(NODES[-1]) * DISTANCE * float(parameter.radii[entry])
            for by in (farthest, -farthest):
                parameter.moved(force, parameter.value, entry, by).check(plain)
    except (TypeError, ValueError):
        return False
    return True
