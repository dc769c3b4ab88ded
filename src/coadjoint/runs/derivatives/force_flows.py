"""Half flows of the forces of a step, for several members, with their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from operator import methodcaller
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.forced import FlowOfForce, flow_of_force
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.forces.base import Force
from coadjoint.systems.forces.double_bracket import DoubleBracketDamping
from coadjoint.systems.forces.orbit_flow import OrbitFlow
from coadjoint.systems.parameter_differences import NearbySystems, differences
from coadjoint.systems.system import System

Floats = NDArray[np.float64]


class FlowEntry(NamedTuple):
    """Systems in which an entry of parameter `name` is moved, and the positions of the forces that it changes."""

    name: str
    entry: int
    nearby: NearbySystems
    forces: tuple[int, ...]
    part: Any = None  # the parameter of the force, or the derivative of the energy; None if only systems are known


class Half(NamedTuple):
    """One of the two halves of a step from t, of length h: the second one ends it, in reverse order."""

    t: float
    h: float
    second: bool

    def order(self, forces: Sequence[Force]) -> list[tuple[int, Force]]:
        """Return the forces in the order of their flows, with their positions."""
        numbered = list(enumerate(forces))
        return numbered[::-1] if self.second else numbered

    @property
    def span(self) -> tuple[float, float]:
        """Time at which the flows begin, and their length."""
        return self.t + 0.5 * self.h if self.second else self.t, 0.5 * self.h


class _Member(NamedTuple):
    """The system of a member, the entries with nearby systems of the same noise, and the order of the scheme."""

    system: System
    entries: Sequence[FlowEntry]
    scheme_order: int

    def flow(self, system: System, j: int, x: Floats, half: Half) -> Floats:
        """Return the flow of force j of a system."""
        end = system.forces[j].flow_of_order(system.unforced, x, *half.span, self.scheme_order)
        return np.asarray(end, dtype=np.float64)

    def flow_with_derivative(self, force: Force, x: Floats, half: Half) -> FlowOfForce:
        """Return the flow of a force of this member with its derivative."""
        return flow_of_force(force, self.system.unforced, x, *half.span, self.scheme_order)

    def parts(self, j: int) -> dict[str, Any]:
        """Return the parameters on which the flow of force j depends."""
        return {entry.name: entry.part for entry in self.entries if j in entry.forces}

    def orbit_flow(self, j: int, force: Force, x: Floats, half: Half) -> OrbitFlow | None:
        """Return the flow of force j by sparse products, if there is a formula for it and for all parameters."""
        if not isinstance(force, DoubleBracketDamping):
            return None
        fields = force.scalings()
        if not all(isinstance(one, EnergyDerivative) or one in fields for one in self.parts(j).values()):
            return None
        return force.orbit_flow(self.system.unforced, x, *half.span)

    def changes(self, wanted: NDArray[np.bool_], j: int, x: Floats, half: Half) -> list[tuple[int, Floats]]:
        """Return the derivatives of the flow of force j by the wanted entries, with their numbers."""

        def after(system: System) -> Floats:
            return self.flow(system, j, x, half)

        numbers = [n for n, entry in enumerate(self.entries) if wanted[n] and j in entry.forces]
        return list(zip(numbers, differences([self.entries[n].nearby for n in numbers], after), strict=True))


class ForceFlows:
    """Half flows of the members `first` to `last` - 1 of a system with forces; noise is that of their numbers."""

    def __init__(self, system: System, entries: Sequence[FlowEntry], first: int, last: int, order: int) -> None:
        self._members = [
            _Member(
                numbered(system), [one._replace(nearby=one.nearby.with_systems(numbered)) for one in entries], order
            )
            for numbered in (methodcaller("numbered_from", m) for m in range(first, last))
        ]

    def apply(self, x: Floats, half: Half) -> Floats:
        """Return the states (members, n) after half flows of the forces."""
        after = []
        for member, state in zip(self._members, x, strict=True):
            for j, force in half.order(member.system.forces):
                flow = member.orbit_flow(j, force, state, half)
                state = member.flow(member.system, j, state, half) if flow is None else flow.end
            after.append(np.asarray(state, dtype=np.float64))
        return np.array(after)

    def push(self, x: Floats, dx: Floats, half: Half, directions: Floats) -> tuple[Floats, Floats]:
        """Return the states, and their tangents (members, k, n), along directions (k, entries) of the entries."""
        directed = np.asarray(directions.any(axis=0))
        states, tangents = [], []
        for member, state, rows in zip(self._members, x, dx, strict=True):
            for j, force in half.order(member.system.forces):
                flow = member.flow_with_derivative(force, state, half)
                rows = flow.tangents(rows)
                for number, change in member.changes(directed, j, state, half):
                    rows = rows + directions[:, number, None] * change
                state = flow.end
            states.append(state)
            tangents.append(rows)
        return np.array(states), np.array(tangents)

    def pull(self, x: Floats, of_x: Floats, half: Half, by_entries: Floats) -> Floats:
        """Return the cotangents (members, n) before the flows; derivatives by entries (members, entries) are added."""
        before, every = [], np.ones(by_entries.shape[1], dtype=bool)
        for member, state, row, total in zip(self._members, x, of_x, by_entries, strict=True):
            flows: list[tuple[int, Floats, FlowOfForce | OrbitFlow]] = []
            for j, force in half.order(member.system.forces):
                known = member.orbit_flow(j, force, state, half)
                flow = member.flow_with_derivative(force, state, half) if known is None else known
                flows.append((j, state, flow))
                state = flow.end
            for j, start, flow in reversed(flows):
                if isinstance(flow, OrbitFlow):
                    row, found = flow.pull(row, member.parts(j))
                    for number, entry in enumerate(member.entries):
                        if j in entry.forces:
                            total[number] += found[entry.name][entry.entry]
                    continue
                for number, change in member.changes(every, j, start, half):
                    total[number] += change @ row
                row = flow.cotangent(row)
            before.append(row)
        return np.array(before)
