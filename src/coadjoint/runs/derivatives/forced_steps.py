"""Derivatives of steps with forces: half flows of the forces, differentiated in Python, around a step of the scheme."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.functions.compiled_functions import raised_by
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun, advance_tables
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import FlowOfForce, flow_of_force
from coadjoint.methods.protocol.derivatives import DIFFERENCES, EXACT, DerivativeTables
from coadjoint.methods.protocol.stepwise_derivatives import matrix_of
from coadjoint.program.added_part import CoefficientMap
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.forces.base import Force
from coadjoint.systems.parameter_differences import NearbySystems

Floats = NDArray[np.float64]


class FlowEntry(NamedTuple):
    """Systems in which an entry of parameter `name` is moved, and the indices of the forces whose flows it changes."""

    name: str
    entry: int
    nearby: NearbySystems
    forces: tuple[int, ...]


class _Member(NamedTuple):
    """The system of a member, and the entries with nearby systems of the same noise."""

    system: ForcedSystem
    entries: Sequence[FlowEntry]


class _Base(NamedTuple):
    """States before and after a step of the scheme, elements before it, and those of its loop after it."""

    start: Floats
    end: Floats
    groups: Floats
    after: Floats


class ForcedSteps:
    """Steps of a system with forces, with the derivatives of `inner` for those of the Hamiltonian part.

    Coefficients are those of `inner`, then the entries of the flows, then factors of subtracted Casimirs. The steps of
    the Hamiltonian part by `parts` have the bits of the tables `structure`.
    """

    def __init__(
        self,
        system: ForcedSystem,
        inner: DerivativeTables,
        structure: Any,
        parts: PartialSteps,
        entries: Sequence[FlowEntry],
        attitudes: AttitudeDerivatives | None,
    ) -> None:
        self._system, self._inner, self._structure, self._parts = system, inner, structure, parts
        self._entries, self._attitudes = entries, attitudes
        self._flows = slice(inner.coefficient_count, inner.coefficient_count + len(entries))

    @property
    def _shifted(self) -> bool:
        return self._attitudes is not None and self._attitudes.shifted

    def _members(self, first: int, last: int) -> list[_Member]:
        def numbered(system: ForcedSystem, member: int) -> ForcedSystem:
            return system.numbered_from(member)

        def of_member(member: int) -> _Member:
            entries = [
                one._replace(nearby=one.nearby.with_systems(partial(numbered, member=member))) for one in self._entries
            ]
            return _Member(numbered(self._system, member), entries)

        return [of_member(m) for m in range(first, last)]

    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        """Carry tangent vectors of members, as the compiled kernels do."""
        for start in range(first, last, limit("MOST_LANES")):
            self._forward(run, start, min(start + limit("MOST_LANES"), last))

    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        """Carry cotangents of members, as the compiled kernels do."""
        for start in range(first, last, limit("MOST_LANES")):
            self._backward(run, start, min(start + limit("MOST_LANES"), last))

    @np.errstate(over="ignore", invalid="ignore")
    def _forward(self, run: ForwardRun, first: int, last: int) -> None:
        some, members, mark = slice(first, last), self._members(first, last), 0
        x, dx, dg = run.momenta[some], run.tangents[some], run.group_tangents[some]
        groups = _matrices(run, some)
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            t = run.t0 + (k - 1) * run.h
            x, dx = self._push(members, x, dx, t, run.h, False, run.coefficients)
            base = self._step(x, groups, t, run.h)
            dx, dg = self._base_forward(base, dx, dg, t, run.h, run.coefficients)
            x, groups = base.end, self._groups_after(base, run.h)
            x, dx = self._push(members, x, dx, t, run.h, True, run.coefficients)
            if mark < run.marked and run.marks[mark] == k:
                run.at_points[mark, some], run.at_groups[mark, some] = dx, dg
                mark += 1
        run.tangents[some], run.group_tangents[some] = dx, dg

    @np.errstate(over="ignore", invalid="ignore")
    def _backward(self, run: BackwardRun, first: int, last: int) -> None:
        some, members, mark = slice(first, last), self._members(first, last), run.marked
        x, groups = run.momenta[some], _matrices(run, some)
        starts, steps = [], []
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            t = run.t0 + (k - 1) * run.h
            starts.append(x)
            x = self._moved(members, x, t, run.h, False)
            steps.append(self._step(x, groups, t, run.h))
            groups = self._groups_after(steps[-1], run.h)
            x = self._moved(members, steps[-1].end, t, run.h, True)
        of_x, of_groups = run.cotangents[some].copy(), run.group_cotangents[some].copy()
        coefficients = np.zeros((len(members), run.coefficients.shape[1]))
        for k in range(run.k1, run.k0, -1):
            if mark > 0 and run.marks[mark - 1] == k:
                mark -= 1
                of_x, of_groups = of_x + run.at_points[mark, some], of_groups + run.at_groups[mark, some]
            t, base = run.t0 + (k - 1) * run.h, steps[k - run.k0 - 1]
            of_x = self._pull(members, base.end, of_x, t, run.h, True, coefficients)
            of_x, of_groups = self._base_backward(base, of_x, of_groups, t, run.h, coefficients)
            of_x = self._pull(members, starts[k - run.k0 - 1], of_x, t, run.h, False, coefficients)
        run.cotangents[some], run.group_cotangents[some] = of_x, of_groups
        run.coefficients[some] += coefficients

    def _order(self, forces: Sequence[Force], t: float, h: float, second: bool) -> list[tuple[int, Force, float]]:
        """Return the forces of a half of the step in their order, with their indices and times."""
        numbered = list(enumerate(forces))
        return [(j, force, t + 0.5 * h if second else t) for j, force in (numbered[::-1] if second else numbered)]

    def _moved(self, members: Sequence[_Member], x: Floats, t: float, h: float, second: bool) -> Floats:
        """Return the states after half flows of the forces."""
        after = []
        for member, state in zip(members, x, strict=True):
            for _, force, time in self._order(member.system.forces, t, h, second):
                state = force.flow(member.system.system, state, time, 0.5 * h)
            after.append(np.asarray(state, dtype=np.float64))
        return np.array(after)

    def _push(
        self,
        members: Sequence[_Member],
        x: Floats,
        dx: Floats,
        t: float,
        h: float,
        second: bool,
        coefficients: Floats,
    ) -> tuple[Floats, Floats]:
        """Return the states and the tangents after half flows of the forces."""
        directions, after = coefficients[:, self._flows], []
        directed = directions.any(axis=0)
        for member, state, rows in zip(members, x, dx, strict=True):
            for j, force, time in self._order(member.system.forces, t, h, second):
                flow = flow_of_force(force, member.system.system, state, time, 0.5 * h)
                rows = flow.tangents(rows)
                for number, change in _changes(member, directed, j, state, time, 0.5 * h):
                    rows = rows + directions[:, number, None] * change
                state = flow.end
            after.append((state, rows))
        return np.array([state for state, _ in after]), np.array([rows for _, rows in after])

    def _pull(
        self,
        members: Sequence[_Member],
        x: Floats,
        of_x: Floats,
        t: float,
        h: float,
        second: bool,
        coefficients: Floats,
    ) -> Floats:
        """Return the cotangents before half flows of the forces; derivatives by their entries are added."""
        before, all_entries = [], np.ones(len(self._entries), dtype=bool)
        for member, state, row, total in zip(members, x, of_x, coefficients, strict=True):
            flows: list[tuple[int, float, Floats, FlowOfForce]] = []
            for j, force, time in self._order(member.system.forces, t, h, second):
                flows.append((j, time, state, flow_of_force(force, member.system.system, state, time, 0.5 * h)))
                state = flows[-1][-1].end
            for j, time, start, flow in reversed(flows):
                for number, change in _changes(member, all_entries, j, start, time, 0.5 * h):
                    total[self._flows][number] += change @ row
                row = flow.cotangent(row)
            before.append(row)
        return np.array(before)

    def _step(self, x: Floats, groups: Floats, t: float, h: float) -> _Base:
        """Take a step of the Hamiltonian part; loops of shifted energies start at the unit element."""
        count, side = len(x), groups.shape[1]
        elements = np.array(np.broadcast_to(np.eye(side), groups.shape)) if self._shifted else groups
        times, lengths, owners = np.full(count, t), np.full(count, h), np.zeros(count, dtype=np.int64)
        end, after = self._parts.take(np.ascontiguousarray(x), elements.reshape(count, -1), times, lengths, owners)
        return _Base(x, end, groups, after.reshape(groups.shape))

    def _groups_after(self, base: _Base, h: float) -> Floats:
        """Return the elements after a step, transposed as in the loops."""
        if self._attitudes is None or not self._shifted:
            return base.after
        turned = [
            self._attitudes.element(x, A.T, h, G.T).T
            for x, A, G in zip(base.start, base.groups, base.after, strict=True)
        ]
        return np.array(turned)

    def _base_forward(
        self, base: _Base, dx: Floats, dg: Floats, t: float, h: float, coefficients: Floats
    ) -> tuple[Floats, Floats]:
        count, carried, n = dx.shape
        side = base.groups.shape[1]
        units = np.array(np.broadcast_to(np.eye(side), base.groups.shape)) if self._shifted else base.groups
        run = ForwardRun(
            size=n,
            square=side**2,
            members=count,
            carried=carried,
            t0=t,
            h=h,
            k0=0,
            k1=1,
            momenta=np.ascontiguousarray(base.start),
            errors=np.zeros((count, n)),
            groups=np.ascontiguousarray(units),
            marked=1,
            marks=np.ones(1, dtype=np.int64),
            at_points=np.zeros((1, count, carried, n)),
            at_groups=np.zeros((1, *dg.shape)),
            tangents=np.array(dx, order="C"),
            group_tangents=np.zeros(dg.shape) if self._shifted else np.array(dg, order="C"),
            coefficients=np.ascontiguousarray(coefficients[:, : self._flows.start]),
        )
        self._call(self._inner.forward, run)
        after = run.at_groups[0]
        if self._attitudes is not None and self._shifted:
            factors, moments = coefficients[:, self._flows.stop :], np.array([h])
            turned = [
                self._attitudes.tangents(
                    base.start[m],
                    base.groups[m].T,
                    moments,
                    base.after[m].T[None],
                    dx[m],
                    np.swapaxes(dg[m], 1, 2),
                    factors,
                    np.swapaxes(after[m], 1, 2)[None],
                )[0]
                for m in range(count)
            ]
            after = np.swapaxes(np.array(turned), 2, 3)
        return run.at_points[0], np.array(after)

    def _base_backward(
        self, base: _Base, of_x: Floats, of_groups: Floats, t: float, h: float, coefficients: Floats
    ) -> tuple[Floats, Floats]:
        count, n = of_x.shape
        side, shifted = base.groups.shape[1], self._shifted
        at_groups, before, of_start, inner_count = of_groups, np.zeros_like(of_x), of_groups, self._flows.start
        if self._attitudes is not None and shifted:
            at_groups, of_start = np.empty_like(of_groups), np.empty_like(of_groups)
            for m in range(count):
                before[m], of_A0, of_factors, of_G = self._attitudes.cotangents(
                    base.start[m], base.groups[m].T, np.array([h]), base.after[m].T[None], of_groups[m].T[None]
                )
                at_groups[m], of_start[m] = of_G[0].T, of_A0.T
                coefficients[m, self._flows.stop :] += of_factors
        units = np.array(np.broadcast_to(np.eye(side), base.groups.shape)) if shifted else base.groups
        run = BackwardRun(
            size=n,
            square=side**2,
            members=count,
            t0=t,
            h=h,
            k0=0,
            k1=1,
            momenta=np.ascontiguousarray(base.start),
            errors=np.zeros((count, n)),
            groups=np.ascontiguousarray(units),
            group_errors=np.zeros((count, side, side)),
            marked=1,
            marks=np.ones(1, dtype=np.int64),
            at_points=np.array(of_x[None], order="C"),
            at_groups=np.array(at_groups[None], order="C"),
            cotangents=np.zeros((count, n)),
            group_cotangents=np.zeros((count, side, side)),
            coefficients=np.zeros((count, inner_count)),
            undone=False,
        )
        self._call(self._inner.backward, run)
        coefficients[:, :inner_count] += run.coefficients
        return before + run.cotangents, of_start if shifted else run.group_cotangents

    def _call(self, kernel: Any, run: ForwardRun | BackwardRun) -> None:
        if not isinstance(kernel, str):
            kernel(self._structure, run, 0, run.members)
            return
        solved = advance_tables(kernel, self._structure, run, 0, run.members, StopFlag())
        if (raised := raised_by(self._inner.keepalive)) is not None:
            raise raised
        if not solved:
            raise IntegrationError(
                f"the linear equations of the derivatives at t = {run.t0:g} are not solved; take a smaller step than "
                f"{abs(run.h):g}",
                step=1,
                time=run.t0,
                residual=float("nan"),
            )


def _matrices(run: ForwardRun | BackwardRun, some: slice) -> Floats:
    """Return the elements of members, transposed as in the loops."""
    return np.array([matrix_of(run, m) for m in range(some.start, some.stop)])


def _changes(
    member: _Member, wanted: NDArray[np.bool_], j: int, x: Floats, t: float, tau: float
) -> list[tuple[int, Floats]]:
    """Return the derivatives of the flow of a force by the wanted entries, with their numbers."""

    def after(system: ForcedSystem) -> Floats:
        return np.asarray(system.forces[j].flow(system.system, x, t, tau), dtype=np.float64)

    return [
        (number, entry.nearby.difference(after))
        for number, entry in enumerate(member.entries)
        if wanted[number] and j in entry.forces
    ]


def forced_tables(
    inner: DerivativeTables, steps_at: Callable[..., ForcedSteps], entries: Sequence[FlowEntry], names: Sequence[str]
) -> DerivativeTables:
    """Return the derivatives of steps with forces by the parameters of these names, in the form of compiled ones.

    `steps_at(h, *values)` are the steps, of which `entries` are those of the flows.
    """
    flows, factors = inner.coefficient_count, inner.coefficient_count + len(entries)
    coefficients: dict[str, CoefficientMap] = {}
    empty = CoefficientMap.of_triplets(())
    for name in names:
        of_inner, of_factors = inner.coefficients.get(name, empty), inner.factors.get(name, empty)
        moved = [(flows + number, one.entry, 1.0) for number, one in enumerate(entries) if one.name == name]
        pieces = [of_inner, CoefficientMap.of_triplets(moved)]
        pieces.append(of_factors._replace(coefficient=factors + of_factors.coefficient))
        coefficients[name] = CoefficientMap(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
    moving = {one.name for one in entries}
    rules: Mapping[str, str] = {
        name: DIFFERENCES if name in moving and inner.rules.get(name, EXACT) == EXACT else inner.rules.get(name, EXACT)
        for name in names
    }
    return DerivativeTables(
        tables_at=steps_at,
        keepalive=inner.keepalive,
        forward=ForcedSteps.forward,
        backward=ForcedSteps.backward,
        coefficient_count=factors + len(inner.shift),
        coefficients=coefficients,
        factors=dict.fromkeys(names, empty),
        rules=rules,
        shift=(),
        reversible=False,
    )
