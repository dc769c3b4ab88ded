"""Quantities of fits that are functions of the states: angular velocities, momenta and what a prepared run observes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.body_motion import reader_of
from coadjoint.runs.results.observables import Observed
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.parameters import parameters_of, with_parameters
from coadjoint.systems.protocol import is_batch, member_of, unforced

Floats = NDArray[np.float64]

MOTIONS = ("angular_velocity", "angular_momentum")
DISTANCE = 2.0**-17  # relative step of central differences, whose errors h^2 and u/h are both near 1e-11


class Quantities:
    """Functions of the states by name, with derivatives: exact tangents of states, and differences of the functions."""

    def __init__(self, ready: PreparedRun, names: Iterable[str], t: Floats, x0: Floats) -> None:
        self._system, self._t, wanted = ready.system, t, [*names]
        observed = {name: ready.observe[name] for name in wanted if name in ready.observe}
        state = np.atleast_2d(x0)[0]
        self._observed = Observed(member_of(ready.system), observed, state) if observed else None
        self._motions = [name for name in wanted if name not in observed]
        self._groups = CoordinateGroups(member_of(ready.system))

    @staticmethod
    def names_of(ready: PreparedRun) -> tuple[str, ...]:
        """Return the names that measurements of a run may have beside "x" and "attitude"."""
        if is_batch(ready.system):
            return (*ready.observe,)
        motions = [name for name in MOTIONS if reader_of(unforced(ready.system), name) is not None]
        return (*ready.observe, *(name for name in motions if name not in ready.observe))

    def values(self, x: Floats, parameters: Mapping[str, Floats]) -> dict[str, Floats]:
        """Return the values at states (points, n) or (points, members, n), by name."""
        found: dict[str, Floats] = {}
        if self._observed is not None:
            rows = self._observed.along(self._t, np.ascontiguousarray(x.reshape(len(x), -1, x.shape[-1])))
            found = {name: value.reshape(x.shape[:-1]) for name, value in rows.items()}
        if self._motions:
            changed = {name: value for name, value in parameters.items() if name in parameters_of(self._system)}
            system = unforced(with_parameters(self._system, changed) if changed else self._system)
            found |= {name: _reader(system, name)(x) for name in self._motions}
        return found

    def tangents(self, x: Floats, tangents: Floats, parameters: Mapping[str, Floats], directions: Any) -> Any:
        """Return the derivatives, with a first axis of unknowns, from those of the states, (unknowns, ...).

        `directions` are those of the parameters by name, with a first axis of unknowns.
        """
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
        length = DISTANCE * min(
            float(np.abs(parameters[name]).max() / np.abs(one).max()) for name, one in moving.items()
        )
        length = length or DISTANCE
        changed = (
            {name: parameters[name] + side * length * one for name, one in moving.items()} for side in (1.0, -1.0)
        )
        ahead, behind = (self.values(x, {**parameters, **values}) for values in changed)
        return {name: (ahead[name] - behind[name]) / (2.0 * length) for name in self._motions}


def _reader(system: Any, name: str) -> Callable[[Any], Floats]:
    found = reader_of(system, name)
    assert found is not None
    return found
