"""Derivatives of steps with forces: half flows of the forces, differentiated in Python, around a step of the scheme."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import Forced, substeps_of
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, EXACT, DerivativeTables
from coadjoint.program.multiples import NO_MULTIPLES, Multiples, concatenated
from coadjoint.runs.derivatives.attitudes import AttitudeDerivatives
from coadjoint.runs.derivatives.force_flows import FlowEntry, ForceFlows, Half
from coadjoint.runs.derivatives.stretches import Stretch, carry
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.system import System

Floats = NDArray[np.float64]


class _Base(NamedTuple):
    """A step of the scheme from the states and elements of its loop, those after it, and the elements before it."""

    step: Stretch
    end: Floats
    after: Floats
    groups: Floats


class ForcedSteps:
    """Steps of a system with forces, with the derivatives of `inner` for those of the Hamiltonian part.

    A step consists of substeps at the fractions of the scheme.

    Coefficients are those of `inner`, then the entries of the flows, then factors of subtracted Casimirs. The steps of
    the Hamiltonian part by `parts` have the bits of the tables `structures`, by length.
    """

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
        """Carry tangent vectors of members, as the compiled kernels do."""
        some, forces, mark = slice(first, last), self._flows_of(first, last), 0
        x, dx, dg = run.momenta[some], run.tangents[some], run.group_tangents[some]
        groups, directions = run.groups[some].reshape(len(x), *dg.shape[2:]), run.coefficients[:, self._flows]
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            for t, h in substeps_of(self._scheme.fractions, run.t0 + (k - 1) * run.h, run.h):
                x, dx = forces.push(x, dx, Half(t, h, False), directions)
                base = self._step(x, groups, t, h)
                dx, dg = self._base_forward(base, dx, dg, run.coefficients)
                groups = self._groups_after(base)
                x, dx = forces.push(base.end, dx, Half(t, h, True), directions)
            if mark < run.marked and run.marks[mark] == k:
                run.at_points[mark, some], run.at_groups[mark, some] = dx, dg
                mark += 1
        run.tangents[some], run.group_tangents[some] = dx, dg

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        """Carry cotangents of members, as the compiled kernels do."""
        some, forces, mark = slice(first, last), self._flows_of(first, last), run.marked
        x, groups = run.momenta[some], run.groups[some].reshape(run.group_cotangents[some].shape)
        starts, steps = [], []
        for k in range(run.k0 + 1, run.k1 + 1):
            note_progress(f"the derivative of step {k} of {run.k1}")
            for t, h in substeps_of(self._scheme.fractions, run.t0 + (k - 1) * run.h, run.h):
                starts.append(x)
                steps.append(self._step(forces.apply(x, Half(t, h, False)), groups, t, h))
                groups = self._groups_after(steps[-1])
                x = forces.apply(steps[-1].end, Half(t, h, True))
        of_x, of_groups = run.cotangents[some], run.group_cotangents[some]
        coefficients = np.zeros((last - first, run.coefficients.shape[1]))
        for k in range(run.k1, run.k0, -1):
            if mark > 0 and run.marks[mark - 1] == k:
                mark -= 1
                of_x, of_groups = of_x + run.at_points[mark, some], of_groups + run.at_groups[mark, some]
            by_entries = coefficients[:, self._flows]
            for t, h in substeps_of(self._scheme.fractions, run.t0 + (k - 1) * run.h, run.h)[::-1]:
                base = steps.pop()
                of_x = forces.pull(base.end, of_x, Half(t, h, True), by_entries)
                of_x, of_groups = self._base_backward(base, of_x, of_groups, coefficients, run.deviations[some])
                of_x = forces.pull(starts.pop(), of_x, Half(t, h, False), by_entries)
        run.cotangents[some], run.group_cotangents[some] = of_x, of_groups
        run.coefficients[some] += coefficients

    def _flows_of(self, first: int, last: int) -> ForceFlows:
        return ForceFlows(self._system, self._entries, first, last, self._scheme.order)

    def _step(self, x: Floats, groups: Floats, t: float, h: float) -> _Base:
        """Take a step of the Hamiltonian part."""
        count, side = len(x), groups.shape[1]
        elements = groups if self._attitudes is None else np.array(np.broadcast_to(np.eye(side), groups.shape))
        step = Stretch.of_step(t, h, np.ascontiguousarray(x), np.ascontiguousarray(elements))
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
            factors, moments = coefficients[:, self._flows.stop :], np.array([base.step.h])
            turned = [
                self._attitudes.tangents(
                    base.step.momenta[m],
                    base.groups[m].T,
                    moments,
                    base.after[m].T[None],
                    dx[m],
                    np.swapaxes(dg[m], 1, 2),
                    factors,
                    np.swapaxes(after[m], 1, 2)[None],
                )[0]
                for m in range(len(dx))
            ]
            after = np.swapaxes(np.array(turned), 2, 3)
        return run.at_points[0], np.array(after)

    def _base_backward(
        self, base: _Base, of_x: Floats, of_groups: Floats, coefficients: Floats, deviations: Floats
    ) -> tuple[Floats, Floats]:
        at_groups, before, of_start = of_groups, np.zeros_like(of_x), None
        if self._attitudes is not None:
            at_groups, of_start = np.empty_like(of_groups), np.empty_like(of_groups)
            for m in range(len(of_x)):
                before[m], of_A0, of_factors, of_G = self._attitudes.cotangents(
                    base.step.momenta[m],
                    base.groups[m].T,
                    np.array([base.step.h]),
                    base.after[m].T[None],
                    of_groups[m].T[None],
                )
                at_groups[m], of_start[m] = of_G[0].T, of_A0.T
                coefficients[m, self._flows.stop :] += of_factors
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
    """Return the derivatives of steps with forces by the parameters of these names, in the form of compiled ones.

    `steps_at(h, *values)` are the steps, of which `entries` are those of the flows.
    """
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
        shift=(),
        reversible=False,
    )
