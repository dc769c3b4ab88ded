"""Quantities of fits that are functions of the states: the motion of bodies, and what is observed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.observables import Observed
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.parameters import parameters_of, with_parameters
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import read_numbers

Floats = NDArray[np.float64]

# Measured values by the names of functions of bodies.
MOTIONS = {
    "angular_velocity": "angular_velocity",
    "angular_momentum": "angular_momentum",
    "attitude": "attitudes",
    "positions": "positions",
    "velocities": "velocities",
}
DISTANCE = 2.0**-17  # relative step of central differences, whose errors h^2 and u/h are both near 1e-11

SMALLEST = 2.0**-10  # size of an entry of a parameter for these differences, at least, relative to the largest entry


class Quantities:
    """Functions of the states by name, with derivatives: exact tangents of states, and differences of the functions."""

    def __init__(
        self, ready: PreparedRun, names: Iterable[str], t: Floats, x0: Floats, observe: Mapping[str, Any]
    ) -> None:
        self._system, self._t, wanted = ready.system, t, [*names]
        observed = {name: ready.observe[name] for name in wanted if name in ready.observe}
        state = np.atleast_2d(x0)[0]
        self._observed = Observed(ready.system.of_member(0), observed, state) if observed else None
        self._functions = {name: _function_of(observe[name], name) for name in wanted if name in observe}
        self._shapes = {name: np.shape(_value(f, name, state, float(t[0]))) for name, f in self._functions.items()}
        self._motions = [name for name in wanted if name not in observed and name not in observe]
        self._groups = CoordinateGroups(ready.system.of_member(0))

    @staticmethod
    def names_of(ready: PreparedRun, observe: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the names that measurements of a run may have beside "x" and the "attitude" of group elements."""
        names = [*ready.observe, *observe]
        if not ready.system.is_batch:
            names += [name for name in MOTIONS if name not in names and _has(ready, name)]
        return tuple(names)

    def values(self, x: Floats, parameters: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return the values at states (points, n) or (points, members, n), by name."""
        found: dict[str, Floats] = {}
        if self._observed is not None:
            along = self._observed.along(self._t, np.ascontiguousarray(x.reshape(len(x), -1, x.shape[-1])))
            found = {name: value.reshape(x.shape[:-1]) for name, value in along.items()}
        for name, function in self._functions.items():
            rows = zip(self._t.tolist(), x.reshape(len(x), -1, x.shape[-1]), strict=True)
            series = [[_value(function, name, row, t) for row in states] for t, states in rows]
            try:
                found[name] = np.array(series).reshape(*x.shape[:-1], *self._shapes[name])
            except ValueError:
                raise ValueError(f"observe[{short(name)}] returns arrays of several shapes; return one shape") from None
        if self._motions:
            changed = {name: value for name, value in parameters.items() if name in parameters_of(self._system)}
            system = (with_parameters(self._system, changed) if changed else self._system).unforced
            found |= {name: _reader(system, name)(x) for name in self._motions}
        return found

    def tangents(self, x: Floats, tangents: Floats, parameters: Mapping[str, Floats], directions: Any) -> Any:
        """Return the derivatives, with a first axis of unknowns, from those of the states and of the parameters."""
        sizes, speeds = self._groups.norms(x), self._groups.norms(tangents)
        with np.errstate(divide="ignore", invalid="ignore"):
            lengths = np.where((speeds > 0.0) & (sizes > 0.0), sizes / speeds, np.inf).min(axis=-1)
        lengths = DISTANCE * np.where(np.isfinite(lengths), lengths, 1.0)
        found: dict[str, list[Floats]] = {}
        for k, (tangent, length) in enumerate(zip(tangents, lengths, strict=True)):
            move = length[..., None] * tangent
            ahead, behind = (self.values(x + side * move, parameters) for side in (1.0, -1.0))
            of_parameters = self._by_parameters(x, parameters, {name: one[k] for name, one in directions.items()})
            for name, value in ahead.items():
                span = 2.0 * length.reshape(*length.shape, *(1,) * (value.ndim - length.ndim))
                found.setdefault(name, []).append((value - behind[name]) / span + of_parameters.get(name, 0.0))
        return {name: np.array(rows) for name, rows in found.items()}

    def _by_parameters(
        self, x: Floats, parameters: Mapping[str, Floats], direction: Mapping[str, Floats]
    ) -> dict[str, Floats]:
        """Return the derivatives of motions at given states along a direction of parameters."""
        moving = {name: one for name, one in direction.items() if name in parameters_of(self._system) and one.any()}
        if not self._motions or not moving:
            return {}
        length = DISTANCE * min(_relative_size(parameters[name], one) for name, one in moving.items())
        changed = (
            {name: parameters[name] + side * length * one for name, one in moving.items()} for side in (1.0, -1.0)
        )
        ahead, behind = (self.values(x, {**parameters, **values}) for values in changed)
        return {name: (ahead[name] - behind[name]) / (2.0 * length) for name in self._motions}


def _relative_size(value: Floats, direction: Floats) -> float:
    """Return the smallest size of the entries of a parameter that a direction moves, in units of their motions."""
    # Products of inertia beside principal moments have the size of the diagonal; small entries a part of the largest.
    sizes = np.abs(value)
    if value.ndim == 2 and len(value) == value.shape[1] and np.diagonal(sizes).all():
        sizes = np.sqrt(np.multiply.outer(np.diagonal(sizes), np.diagonal(sizes)))
    moved = direction != 0.0
    sizes = np.maximum(sizes, SMALLEST * sizes.max())
    return float((sizes[moved] / np.abs(direction[moved])).min()) or 1.0


def _has(ready: PreparedRun, name: str) -> bool:
    """Return whether a function of the states of a body has this name; of attitudes, if they are part of the states."""
    system = ready.system.unforced
    if name == "attitude" and not (getattr(system, "has_attitude", False) and ready.representation is None):
        return False
    return getattr(system.unforced, MOTIONS[name], None) is not None


def _reader(system: Any, name: str) -> Callable[[Any], Floats]:
    found = getattr(system.unforced, MOTIONS[name], None)
    assert found is not None
    return found


def _function_of(function: Any, name: str) -> Callable[[Floats, float], Any]:
    """Return a function of (x) or (x, t) as one of (x, t)."""
    return function if takes_time(function, f"observe[{short(name)}]") else lambda x, t: function(x)


def _value(function: Callable[[Floats, float], Any], name: str, x: Floats, t: float) -> Floats:
    """Return real numbers at a copy of a state."""
    return read_numbers(function(x.copy(), t), f"what observe[{short(name)}] returns at t = {t:g}")
