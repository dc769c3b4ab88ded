"""Derivatives of steps with forces: half flows of the forces, differentiated in Python, around a step of the scheme."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.functions.compiled_functions import raised_by
from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import StopFlag
from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun, advance_tables
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, EXACT, DerivativeTables
from coadjoint.methods.protocol.stepwise_derivatives import matrix_of
from coadjoint.program.added_part import CoefficientMap
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.derivatives.force_flows import FlowEntry, ForceFlows, Half
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.forced import ForcedSystem

Floats = NDArray[np.float64]


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
        some, forces, mark = slice(first, last), ForceFlows(self._system, self._entries, first, last), 0
        x, dx, dg = run.momenta[some], run.tangents[some], run.group_tangents[some]
        groups, directions = _matrices(run, some), run.coefficients[:, self._flows]
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            t = run.t0 + (k - 1) * run.h
            x, dx = forces.push(x, dx, Half(t, run.h, False), directions)
            base = self._step(x, groups, t, run.h)
            dx, dg = self._base_forward(base, dx, dg, t, run.h, run.coefficients)
            groups = self._groups_after(base, run.h)
            x, dx = forces.push(base.end, dx, Half(t, run.h, True), directions)
            if mark < run.marked and run.marks[mark] == k:
                run.at_points[mark, some], run.at_groups[mark, some] = dx, dg
                mark += 1
        run.tangents[some], run.group_tangents[some] = dx, dg

    @np.errstate(over="ignore", invalid="ignore")
    def _backward(self, run: BackwardRun, first: int, last: int) -> None:
        some, forces, mark = slice(first, last), ForceFlows(self._system, self._entries, first, last), run.marked
        x, groups = run.momenta[some], _matrices(run, some)
        starts, steps = [], []
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            t = run.t0 + (k - 1) * run.h
            starts.append(x)
            steps.append(self._step(forces.apply(x, Half(t, run.h, False)), groups, t, run.h))
            groups = self._groups_after(steps[-1], run.h)
            x = forces.apply(steps[-1].end, Half(t, run.h, True))
        of_x, of_groups = run.cotangents[some], run.group_cotangents[some]
        coefficients = np.zeros((last - first, run.coefficients.shape[1]))
        for k in range(run.k1, run.k0, -1):
            if mark > 0 and run.marks[mark - 1] == k:
                mark -= 1
                of_x, of_groups = of_x + run.at_points[mark, some], of_groups + run.at_groups[mark, some]
            t, base = run.t0 + (k - 1) * run.h, steps[k - run.k0 - 1]
            by_entries = coefficients[:, self._flows]
            of_x = forces.pull(base.end, of_x, Half(t, run.h, True), by_entries)
            of_x, of_groups = self._base_backward(base, of_x, of_groups, t, run.h, coefficients)
            of_x = forces.pull(starts[k - run.k0 - 1], of_x, Half(t, run.h, False), by_entries)
        run.cotangents[some], run.group_cotangents[some] = of_x, of_groups
        run.coefficients[some] += coefficients

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
            threads=1,
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
            threads=1,
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
