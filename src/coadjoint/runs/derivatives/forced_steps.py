"""Derivatives of steps with forces: half flows of the forces, differentiated in Python, around a step of the scheme."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import methodcaller
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.tables.derivatives import BackwardRun, ForwardRun
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import Forced, flow_of_force, halves_of_step, on_side
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, EXACT, DerivativeTables
from coadjoint.methods.protocol.step_derivatives import LinearizedStep
from coadjoint.program.sources import NO_MULTIPLES, Multiples, concatenated
from coadjoint.runs.derivatives.segments import Segment, carry
from coadjoint.runs.loops.shifted_attitude import AttitudeDerivatives
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.forces.orbit_flow import pull_through
from coadjoint.systems.parameter_differences import NearbySystems, differences
from coadjoint.systems.system import System

Floats = NDArray[np.float64]


class FlowEntry(NamedTuple):
    """Systems in which an entry of parameter `name` is moved, and the numbers of the flows that it changes."""

    name: str
    entry: int
    nearby: NearbySystems
    flows: tuple[int, ...]
    field: str = ""  # the parameter of the force, if it is one
    energy: EnergyDerivative | None = None  # the derivative of the energy, if known


# A system with the noise of one member, and the entries with those of it.
Member = tuple[System, list[FlowEntry]]


class HalfFlows:
    """Flows of the forces on some members on one side of a substep: their numbers, begins and durations in order."""

    def __init__(
        self, members: Sequence[Member], side: int, flows: Sequence[tuple[int, float, float]], scheme_order: int
    ) -> None:
        self._members, self._side, self._scheme_order = members, side, scheme_order
        self._order, self._times = [j for j, _, _ in flows], {j: (t, h) for j, t, h in flows}

    def apply(self, x: Floats) -> Floats:
        return np.array([self._apply(member, state) for member, state in zip(self._members, x, strict=True)])

    def push(self, x: Floats, dx: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Return the states, and their tangents (members, k, n), along directions (k, entries) of the entries."""
        each = zip(self._members, x, dx, strict=True)
        states, tangents = zip(
            *(self._push(member, state, rows, directions) for member, state, rows in each), strict=True
        )
        return np.array(states), np.array(tangents)

    def pull(self, x: Floats, of_x: Floats, by_entries: Floats) -> Floats:
        """Return the cotangents (members, n) before the flows; derivatives by the entries are added to `by_entries`."""
        each = zip(self._members, x, of_x, by_entries, strict=True)
        return np.array([self._pull(member, state, row, total) for member, state, row, total in each])

    def _apply(self, member: Member, x: Floats) -> Floats:
        for j in self._order:
            steps = self._orbit_steps(member, j, x)
            x = steps[-1].end if steps else self._flow(member[0], j, x)
        return np.asarray(x, dtype=np.float64)

    def _push(self, member: Member, x: Floats, dx: Floats, directions: Floats) -> tuple[Floats, Floats]:
        directed = np.asarray(directions.any(axis=0))
        for j in self._order:
            flow = self._flow_with_derivative(member[0], j, x)
            dx = flow.tangents(dx)
            for number, change in self._changes(member, directed, j, x):
                dx = dx + directions[:, number, None] * change
            x = flow.end
        return x, dx

    def _pull(self, member: Member, x: Floats, of_x: Floats, by_entries: Floats) -> Floats:
        pulls: list[Callable[[Floats, Floats], Floats]] = []
        for j in self._order:
            steps = self._orbit_steps(member, j, x)
            if steps:
                pulls.append(partial(self._pull_orbit_steps, member, j, steps))
                x = steps[-1].end
            else:
                step = self._flow_with_derivative(member[0], j, x)
                pulls.append(partial(self._pull_step, member, j, x, step))
                x = step.end
        for pull in reversed(pulls):
            of_x = pull(of_x, by_entries)
        return of_x

    def _pull_step(
        self, member: Member, j: int, x: Floats, step: LinearizedStep, of_x: Floats, by_entries: Floats
    ) -> Floats:
        for number, change in self._changes(member, np.ones(len(by_entries), dtype=bool), j, x):
            by_entries[number] += change @ of_x
        return step.cotangent(of_x)

    def _pull_orbit_steps(
        self, member: Member, j: int, steps: Sequence[Any], of_x: Floats, by_entries: Floats
    ) -> Floats:
        of_x, found = pull_through(steps, self._force(member[0], j).scalings(), of_x, *_parameters(member, j))
        for number, entry in enumerate(member[1]):
            if j in entry.flows:
                by_entries[number] += found[entry.name][entry.entry]
        return of_x

    def _flow(self, system: System, j: int, x: Floats) -> Floats:
        end = self._force(system, j).flow_of_order(system.unforced, x, *self._times[j], self._scheme_order)
        return np.asarray(end, dtype=np.float64)

    def _flow_with_derivative(self, system: System, j: int, x: Floats) -> LinearizedStep:
        return flow_of_force(self._force(system, j), system.unforced, x, *self._times[j], self._scheme_order)

    def _force(self, system: System, j: int) -> Any:
        return on_side(system.flows[j][1], self._side)

    def _orbit_steps(self, member: Member, j: int, x: Floats) -> Sequence[Any]:
        """Return the flow j by sparse products, if there is a formula for it and for all parameters."""
        force = self._force(member[0], j)
        known = force.scalings()
        if not all(field in known for field in _parameters(member, j)[0].values()):
            return ()
        return force.orbit_steps(member[0].unforced, x, *self._times[j])  # type: ignore[no-any-return]

    def _changes(self, member: Member, wanted: NDArray[np.bool_], j: int, x: Floats) -> list[tuple[int, Floats]]:
        """Return the derivatives of the flow j by the wanted entries, with their numbers."""
        entries = member[1]

        def after(system: System) -> Floats:
            return self._flow(system, j, x)

        numbers = [n for n, entry in enumerate(entries) if wanted[n] and j in entry.flows]
        return list(zip(numbers, differences([entries[n].nearby for n in numbers], after), strict=True))


def _parameters(member: Member, j: int) -> tuple[dict[str, str], dict[str, EnergyDerivative]]:
    """Return the fields and the derivatives of the energy on which the flow j depends."""
    entries = [entry for entry in member[1] if j in entry.flows]
    energies = {entry.name: entry.energy for entry in entries if entry.energy is not None}
    return {entry.name: entry.field for entry in entries if entry.energy is None}, energies


class _Base(NamedTuple):
    """A step of the scheme from the states and elements of its loop, those after it, and the elements before it."""

    step: Segment
    end: Floats
    after: Floats
    groups: Floats

    def turned(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return momenta, elements before the step, its length, and those of its loop, as `AttitudeDerivatives`."""
        after = np.swapaxes(self.after, 1, 2)[None]
        return self.step.momenta, np.swapaxes(self.groups, 1, 2), np.array([self.step.h]), after


class ForcedSteps:
    """Steps with forces, in substeps, with the derivatives of `inner` for those of the Hamiltonian part."""

    # Coefficients are those of `inner`, the entries of the flows, and the factors of subtracted Casimirs.

    def __init__(
        self,
        system: System,
        inner: DerivativeTables,
        scheme: Forced,
        structures: Mapping[float, Any],
        parts: Mapping[float, PartialSteps],
        entries: Sequence[FlowEntry],
        attitudes: AttitudeDerivatives | None,
    ) -> None:
        self._system, self._inner, self._structures, self._parts = system, inner, structures, parts
        self._scheme = scheme
        # Of shifted energies, whose loops start at the unit element.
        self._entries, self._attitudes = entries, attitudes if attitudes is not None and attitudes.shifted else None
        self._flows = slice(inner.coefficient_count, inner.coefficient_count + len(entries))

    @np.errstate(over="ignore", invalid="ignore")
    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        some, members, mark = slice(first, last), self._members(first, last), 0
        x, dx, dg = run.momenta[some], run.tangents[some], run.group_tangents[some]
        groups, directions = run.groups[some].reshape(len(x), *dg.shape[2:]), run.coefficients[:, self._flows]
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            for t, h, (before, after) in self._substeps(members, run.t0 + (k - 1) * run.h, run.h):
                x, dx = before.push(x, dx, directions)
                base = self._step(x, groups, t, h)
                dx, dg = self._base_forward(base, dx, dg, run.coefficients)
                groups = self._groups_after(base)
                x, dx = after.push(base.end, dx, directions)
            if mark < run.marked and run.marks[mark] == k:
                run.at_points[mark, some], run.at_groups[mark, some] = dx, dg
                mark += 1
        run.tangents[some], run.group_tangents[some] = dx, dg

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        some, members, mark = slice(first, last), self._members(first, last), run.marked
        x, groups = run.momenta[some], run.groups[some].reshape(run.group_cotangents[some].shape)
        starts, steps = [], []
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            for t, h, (before, after) in self._substeps(members, run.t0 + (k - 1) * run.h, run.h):
                starts.append(x)
                steps.append(self._step(before.apply(x), groups, t, h))
                groups = self._groups_after(steps[-1])
                x = after.apply(steps[-1].end)
        of_x, of_groups = run.cotangents[some], run.group_cotangents[some]
        coefficients = np.zeros((last - first, run.coefficients.shape[1]))
        for k in range(run.k1, run.k0, -1):
            if mark > 0 and run.marks[mark - 1] == k:
                mark -= 1
                of_x, of_groups = of_x + run.at_points[mark, some], of_groups + run.at_groups[mark, some]
            by_entries = coefficients[:, self._flows]
            for _, _, (before, after) in self._substeps(members, run.t0 + (k - 1) * run.h, run.h)[::-1]:
                base = steps.pop()
                of_x = after.pull(base.end, of_x, by_entries)
                of_x, of_groups = self._base_backward(base, of_x, of_groups, coefficients, run.deviations[some])
                of_x = before.pull(starts.pop(), of_x, by_entries)
        run.cotangents[some], run.group_cotangents[some] = of_x, of_groups
        run.coefficients[some] += coefficients

    def _members(self, first: int, last: int) -> list[Member]:
        """Return the systems of the members `first` to `last` - 1, and the entries of these."""
        found = []
        for m in range(first, last):
            numbered = methodcaller("among", m, m + 1)
            entries = [one._replace(nearby=one.nearby.with_systems(numbered)) for one in self._entries]
            found.append((numbered(self._system), entries))
        return found

    def _substeps(
        self, members: Sequence[Member], t: float, h: float
    ) -> list[tuple[float, float, tuple[HalfFlows, HalfFlows]]]:
        """Return begin and length of each substep, and the flows of forces before and after it."""
        order = self._scheme.order
        return [
            (begin, length, (HalfFlows(members, 0, halves[0], order), HalfFlows(members, 1, halves[1], order)))
            for begin, length, halves in halves_of_step(self._system.flows, self._scheme.fractions, t, h)
        ]

    def _step(self, x: Floats, groups: Floats, t: float, h: float) -> _Base:
        count, side = len(x), groups.shape[1]
        elements = groups if self._attitudes is None else np.array(np.broadcast_to(np.eye(side), groups.shape))
        step = Segment.of_step(t, h, np.ascontiguousarray(x), np.ascontiguousarray(elements))
        times, lengths, owners = np.full(count, t), np.full(count, h), np.zeros(count, dtype=np.int64)
        end, after = self._parts[h].take(step.momenta, elements.reshape(count, -1), times, lengths, owners)
        return _Base(step, end, after.reshape(groups.shape), groups)

    def _groups_after(self, base: _Base) -> Floats:
        """Return the elements after a step, transposed as in the loops."""
        if self._attitudes is None:
            return base.after
        each = zip(base.step.momenta, base.groups, base.after, strict=True)
        return np.array([self._attitudes.element(x, A.T, base.step.h, G.T).T for x, A, G in each])

    def _base_forward(self, base: _Base, dx: Floats, dg: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
        group_tangents = np.array(dg, order="C") if self._attitudes is None else np.zeros(dg.shape)
        of_inner = np.ascontiguousarray(coefficients[:, : self._flows.start])
        run = base.step.forward(np.array(dx, order="C"), group_tangents, of_inner)
        self._carry(run)
        after = run.at_groups[0]
        if self._attitudes is not None:
            factors, elements = coefficients[:, self._flows.stop :], np.swapaxes(after, 2, 3)[None]
            turned = self._attitudes.tangents(*base.turned(), dx, np.swapaxes(dg, 2, 3), factors, elements)
            after = np.swapaxes(turned[0], 2, 3)
        return run.at_points[0], np.array(after)

    def _base_backward(
        self, base: _Base, of_x: Floats, of_groups: Floats, coefficients: Floats, deviations: Floats
    ) -> tuple[Floats, Floats]:
        at_groups, before, of_start = of_groups, np.zeros_like(of_x), None
        if self._attitudes is not None:
            of_attitudes = np.swapaxes(of_groups, 1, 2)[None]
            before, of_A0, of_factors, of_G = self._attitudes.cotangents(*base.turned(), of_attitudes)
            at_groups, of_start = (np.ascontiguousarray(np.swapaxes(one, 1, 2)) for one in (of_G[0], of_A0))
            coefficients[:, self._flows.stop :] += of_factors
        of_inner = np.zeros((len(of_x), self._flows.start))
        zeros = np.zeros(of_x.shape), np.zeros(base.groups.shape)
        run = base.step.backward(of_x[None], at_groups[None], *zeros, of_inner)
        self._carry(run)
        coefficients[:, : self._flows.start] += of_inner
        np.maximum(deviations, run.deviations, out=deviations)
        return before + run.cotangents, run.group_cotangents if of_start is None else of_start

    def _carry(self, run: ForwardRun | BackwardRun) -> None:
        if not carry(self._inner, self._structures[run.h], run, 0, run.members):
            raise IntegrationError(
                f"the linear equations of the derivatives at t = {run.t0:g} are not solved; take a smaller step than "
                f"{abs(run.h):g}",
                step=1,
                time=run.t0,
                residual=float("nan"),
            )


def forced_tables(
    inner: DerivativeTables, steps_at: Callable[..., ForcedSteps], entries: Sequence[FlowEntry], names: Sequence[str]
) -> DerivativeTables:
    """Return the derivatives of steps with forces by parameters, in the form of compiled ones."""
    flows, factors = inner.coefficient_count, inner.coefficient_count + len(entries)
    coefficients: dict[str, Multiples] = {}
    rules: dict[str, str] = {}
    for name in names:
        of_inner, of_factors = (of.get(name, NO_MULTIPLES) for of in (inner.coefficients, inner.factors))
        moved = [(flows + number, one.entry, 1.0) for number, one in enumerate(entries) if one.name == name]
        pieces = [of_inner, Multiples.of_triplets(moved)]
        pieces.append(of_factors._replace(position=factors + of_factors.position))
        coefficients[name] = concatenated(pieces)
        rule = inner.rules.get(name, EXACT)
        rules[name] = DIFFERENCES if moved and rule == EXACT else rule
    return DerivativeTables(
        tables_at=steps_at,
        keepalive=inner.keepalive,
        forward=ForcedSteps.forward,
        backward=ForcedSteps.backward,
        coefficient_count=factors + len(inner.shift),
        coefficients=coefficients,
        factors=dict.fromkeys(names, NO_MULTIPLES),
        rules=rules,
    )
