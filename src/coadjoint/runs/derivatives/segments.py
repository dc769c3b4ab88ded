"""Segments of steps to be differentiated: by calls of the kernels, and step by step in Python."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from ctypes import c_int64
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.interface import limit
from coadjoint.kernels.loop import CONCURRENT_ROWS, single_blas_thread
from coadjoint.kernels.tables.compiled import raised_by
from coadjoint.kernels.tables.derivatives import BackwardRun, ForwardRun, advance_tables
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, EXACT, DerivativeTables, Kernel
from coadjoint.methods.protocol.method import Method, Representation
from coadjoint.program.generators import group_side
from coadjoint.program.sources import NO_MULTIPLES, Multiples
from coadjoint.runs.loops.loops import loops_of_system
from coadjoint.runs.loops.member_batches import split_members, sum_in_threads
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.parameter_differences import DISTANCE, NODES, WEIGHTS, NearbySystems, differences
from coadjoint.systems.step_derivatives import LinearizedStep

Floats = NDArray[np.float64]

ONE = np.ones(1, dtype=np.int64)  # the mark of a single step


class Segment(NamedTuple):
    """Steps k0 + 1 to k1 of all members, and the states from which they start, or, if `undone`, end."""

    t0: float
    h: float
    k0: int
    k1: int
    momenta: Floats
    errors: Floats
    groups: Floats
    group_errors: Floats
    undone: bool = False
    before: int | None = 0

    @classmethod
    def of_step(cls, t0: float, h: float, momenta: Floats, groups: Floats, before: int | None = None) -> Segment:
        return cls(t0, h, 0, 1, momenta, np.zeros_like(momenta), groups, np.zeros_like(groups), before=before)

    def forward(
        self,
        tangents: Floats,
        group_tangents: Floats,
        coefficients: Floats,
        *,
        marks: NDArray[np.int64] = ONE,
        threads: int = 1,
    ) -> ForwardRun:
        """Return the run of a kernel, which overwrites tangents (members, count, n) and (members, count, d, d)."""
        return ForwardRun(
            **self._common(marks, threads),
            carried=tangents.shape[1],
            at_points=np.zeros((len(marks), *tangents.shape)),
            at_groups=np.zeros((len(marks), *group_tangents.shape)),
            tangents=tangents,
            group_tangents=group_tangents,
            coefficients=coefficients,
            apart=coefficients.ndim == 3,
        )

    def backward(
        self,
        at_points: Floats,
        at_groups: Floats,
        cotangents: Floats,
        group_cotangents: Floats,
        coefficients: Floats,
        *,
        marks: NDArray[np.int64] = ONE,
        threads: int = 1,
    ) -> BackwardRun:
        """Return the run of a kernel, which overwrites cotangents and adds to `coefficients` (members, number)."""
        return BackwardRun(
            **self._common(marks, threads),
            group_errors=self.group_errors,
            at_points=np.ascontiguousarray(at_points),
            at_groups=np.ascontiguousarray(at_groups),
            cotangents=cotangents,
            group_cotangents=group_cotangents,
            coefficients=coefficients,
            deviations=np.zeros(len(cotangents)),
            undone=self.undone,
        )

    def _common(self, marks: NDArray[np.int64], threads: int) -> dict[str, Any]:
        members, size = self.momenta.shape
        own = {name: getattr(self, name) for name in ("t0", "h", "k0", "k1", "momenta", "errors", "groups")}
        sizes = {"members": members, "size": size, "square": self.groups[0].size, "marked": len(marks)}
        return {**own, **sizes, "marks": marks, "threads": threads}


def carry(tables: DerivativeTables, structure: Any, run: Any, first: int, last: int, workers: int = 1) -> bool:
    """Carry the vectors of the members `first` to `last` - 1; return whether all linear equations were solved."""
    name: Kernel = tables.backward if hasattr(run, "cotangents") else tables.forward
    stop, lanes = c_int64(0), limit("MOST_LANES")
    in_python = callable(name) or getattr(structure, "in_python", False)
    # Flows and steps in Python multiply matrices of the size of the state, large ones with the threads of BLAS.
    few = run.size <= CONCURRENT_ROWS or workers > 1
    with single_blas_thread(run.size if in_python and few else 0):
        if callable(name):
            for start in range(first, last, lanes):
                name(structure, run, start, min(start + lanes, last))
            return True
        if workers == 1 or last - first <= lanes:
            solved = advance_tables(name, structure, run, first, last, stop)
        else:
            ranges = split_members(first, last, workers, lanes)
            solved = not sum_in_threads(
                lambda some: not advance_tables(name, structure, run, *some, stop), ranges, workers, stop
            )
    if (raised := raised_by((*tables.keepalive, *getattr(structure, "raising", ())))) is not None:
        raise raised
    return solved


class StepwiseDerivatives:
    """Derivatives of steps by the state (`Method.linearized`), of group elements, and of both by parameters.

    Those by the parameters of `energies` follow from the stages of a step. Those by others, which come after them, and
    of the elements g of A -> A g by the state, are central differences of order 8.
    """

    def __init__(
        self,
        method: Method,
        system: Any,
        nearby: Sequence[NearbySystems],
        h: float,
        representation: Representation,
        method_of: Callable[[Any], Method] | None = None,
        energies: Sequence[EnergyDerivative] = (),
    ) -> None:
        self._method_of: Callable[[Any], Method] = (lambda _: method) if method_of is None else method_of
        self._method, self._system, self._nearby, self._energies = method, system, nearby, energies
        self._exact = sum(energy.size for energy in energies)
        self._h, self._representation = h, representation
        self._steps: dict[int, tuple[Any, PartialSteps]] = {}

    def step(self, x: Floats, t: float, h: float) -> LinearizedStep:
        return self._method.linearized(self._system, x, t, h)

    def element(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the element (d, d) of a step, and its derivative (n, d, d) by the state; empty without an attitude."""
        if self._representation is None:
            return np.zeros((0, 0)), np.zeros((len(x), 0, 0))
        distance = DISTANCE * (float(np.max(np.abs(x))) or 1.0)
        moves = distance * np.concatenate([NODES, -NODES])[:, None, None] * np.eye(len(x))
        rows = np.concatenate([x[None], (x + moves).reshape(-1, len(x))])
        elements = self._elements(self._system, rows, t, h)
        moved = elements[1:].reshape(len(moves), len(x), *elements.shape[1:])
        weights = np.concatenate([WEIGHTS, -WEIGHTS]) / distance
        return elements[0], np.tensordot(weights, moved, axes=1)

    def _elements(self, system: Any, x: Floats, t: float, h: float) -> Floats:
        """Return the elements (m, d, d) of a step of a system from states (m, n)."""
        if id(system) not in self._steps:
            loops = loops_of_system(system, self._method, self._h, self._representation)
            if any(loops.corrections):
                raise TypeError(f"attitudes by {self._method} have no derivatives; take Splitting or GaussLegendre")
            # The system is stored with its loops: its number is not used for another one.
            self._steps[id(system)] = system, PartialSteps(system, self._method, loops)
        d = group_side(system.dim, self._representation)
        count, units = len(x), np.tile(np.eye(d).ravel(), (len(x), 1))
        owners = np.zeros(count, dtype=np.int64)
        _, groups = self._steps[id(system)][1].take(
            np.ascontiguousarray(x), units, np.full(count, t), np.full(count, h), owners
        )
        return np.swapaxes(groups.reshape(count, d, d), 1, 2)

    def by_parameters(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the derivatives (entries, n) of a step and (entries, d, d) of its element by entries of parameters."""

        def after(system: Any) -> Floats:
            return np.asarray(self._method_of(system).step(system, x, t, h), dtype=np.float64)

        def turned(system: Any) -> Floats:
            return np.zeros((0, 0)) if self._representation is None else self._elements(system, x[None], t, h)[0]

        rows, of_element = differences(self._nearby, after), differences(self._nearby, turned)
        return np.array(rows).reshape(len(rows), len(x)), np.array(of_element)

    def _along(self, step: LinearizedStep, directions: Floats) -> Floats:
        """Return the changes (k, n) of the end of a step for directions (k, entries) of the first parameters."""
        total = np.zeros((len(directions), len(step.end)))
        for y, matrix in step.stages() if self._exact else ():
            start = 0
            for energy in self._energies:
                own = directions[:, start : start + energy.size]
                total += np.array([energy.gradient(y, direction) for direction in own]) @ matrix.T
                start += energy.size
        return total

    def _pulled(self, step: LinearizedStep, cotangent: Floats) -> Floats:
        """Return the cotangents of the first parameters for that of the end of a step."""
        total = np.zeros(self._exact)
        for y, matrix in step.stages() if self._exact else ():
            total += np.concatenate([energy.along(y, cotangent @ matrix) for energy in self._energies])
        return total

    @np.errstate(over="ignore", invalid="ignore")
    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        directed, others = bool(run.coefficients.any()), run.coefficients[:, self._exact :]
        for member in range(first, last):
            x, vectors, mark = run.momenta[member], run.tangents[member], 0
            group, of_group = _matrix_of(run, member), run.group_tangents[member]
            for k in range(run.k0 + 1, run.k1 + 1):
                t = run.t0 + (k - 1) * run.h
                note_progress(f"the derivative of step {k} of {run.k1}")
                step, (g, by_state) = self.step(x, t, run.h), self.element(x, t, run.h)
                of_g = np.tensordot(vectors, by_state, axes=1)
                vectors = step.tangents(vectors)
                if directed:
                    vectors = vectors + self._along(step, run.coefficients)
                if others.any():
                    by_entries, of_elements = self.by_parameters(x, t, run.h)
                    vectors = vectors + others @ by_entries
                    of_g = of_g + np.tensordot(others, of_elements, axes=1)
                # Elements are stored transposed.
                of_group, group = g.T @ of_group + np.swapaxes(of_g, 1, 2) @ group, g.T @ group
                x = step.end
                if mark < run.marked and run.marks[mark] == k:
                    run.at_points[mark, member], run.at_groups[mark, member] = vectors, of_group
                    mark += 1
            run.tangents[member], run.group_tangents[member] = vectors, of_group

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        for member in range(first, last):
            x, group, states, groups = run.momenta[member], _matrix_of(run, member), [], []
            steps: list[LinearizedStep] = []
            elements: list[tuple[Floats, Floats]] = []
            for k in range(run.k0 + 1, run.k1 + 1):
                note_progress(f"the derivative of step {k} of {run.k1}")
                t = run.t0 + (k - 1) * run.h
                states.append(x)
                groups.append(group)
                steps.append(self.step(x, t, run.h))
                elements.append(self.element(x, t, run.h))
                x, group = steps[-1].end, elements[-1][0].T @ group
            cotangent, mark = run.cotangents[member], run.marked
            of_group = run.group_cotangents[member]
            for k in range(run.k1, run.k0, -1):
                if mark > 0 and run.marks[mark - 1] == k:
                    mark -= 1
                    cotangent = cotangent + run.at_points[mark, member]
                    of_group = of_group + run.at_groups[mark, member]
                number = k - run.k0 - 1
                g, by_state = elements[number]
                of_g = groups[number] @ of_group.T
                run.coefficients[member, : self._exact] += self._pulled(steps[number], cotangent)
                if self._nearby:
                    by_entries, of_elements = self.by_parameters(states[number], run.t0 + (k - 1) * run.h, run.h)
                    others = by_entries @ cotangent + np.tensordot(of_elements, of_g, axes=2)
                    run.coefficients[member, self._exact :] += others
                cotangent = steps[number].cotangent(cotangent) + np.tensordot(by_state, of_g, axes=2)
                of_group = g @ of_group
            run.cotangents[member], run.group_cotangents[member] = cotangent, of_group


def _matrix_of(run: ForwardRun | BackwardRun, member: int) -> Floats:
    """Return the element of a member before the steps, transposed as in the loops."""
    side = round(run.square**0.5)
    return np.asarray(run.groups[member]).reshape(side, side)


def stepwise_derivatives(
    steps_at: Callable[..., StepwiseDerivatives], sizes: Mapping[str, int], exact: Container[str] = ()
) -> DerivativeTables:
    """Return the derivatives of a scheme without compiled ones, in the form of these; `sizes` are of parameters."""
    coefficients, start = {}, 0
    for name, size in sizes.items():
        entries = np.arange(size)
        coefficients[name] = Multiples(start + entries, entries, np.ones(size))
        start += size
    return DerivativeTables(
        tables_at=lambda h, *values: steps_at(*values),
        forward=StepwiseDerivatives.forward,
        backward=StepwiseDerivatives.backward,
        coefficient_count=start,
        coefficients=coefficients,
        factors=dict.fromkeys(sizes, NO_MULTIPLES),
        rules={name: EXACT if name in exact else DIFFERENCES for name in sizes},
    )
