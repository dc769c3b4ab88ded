"""Derivatives of steps with forces: tables for the kernels, and derivatives of flows that are computed in Python."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Sequence
from functools import partial
from operator import methodcaller
from threading import RLock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import CalledInPython
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import NotWritable, as_structure
from coadjoint.kernels.tables.derivatives import BackwardRun, ForwardRun, numbers_at, run_at
from coadjoint.kernels.tables.flow_derivatives import (
    FlowCoefficients,
    ForcedDerivatives,
    flow_coefficients,
    flow_derivatives,
)
from coadjoint.long_operations import note_progress
from coadjoint.methods.forced import Forced, flow_of_force, on_side
from coadjoint.methods.protocol.derivative_tables import DIFFERENCES, EXACT, DerivativeTables, least_exact
from coadjoint.program.sources import NO_MULTIPLES, Multiples, concatenated
from coadjoint.runs.loops.shifted_attitude import AttitudeDerivatives
from coadjoint.systems.energy_derivatives import EnergyDerivative
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


# Flow (-1 - flow to differentiate it also by the state), side, member, begin, duration, state, number of vectors (0: a
# cotangent), the vectors, and the directions or the cotangents of the entries.
FLOW_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_int64,
    ctypes.c_double,
    ctypes.c_double,
    ctypes.c_void_p,
    ctypes.c_int64,
    ctypes.c_void_p,
    ctypes.c_void_p,
)
# Tables, run, first member, last one and one, and what a loop keeps between calls.
CARRY_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
)


DIFFERENT = "derivatives of the members have different coefficients; use prepared.jvp and prepared.vjp"
# Derivatives in Python change the filters of warnings, which belong to all threads.
ONE_AT_A_TIME = RLock()


class FlowAt(NamedTuple):
    """A flow of a step: its number, the side of the substep, the member, when it begins and how long, and the state."""

    flow: int
    side: int
    member: int
    when: tuple[float, float]
    x: Floats


class FlowsInPython:
    """Flows of forces differentiated in Python, where the kernels do not."""

    def __init__(self, system: System, entries: Sequence[FlowEntry], order: int) -> None:
        self._system, self._entries, self._order = system, entries, order
        self._members: dict[int, tuple[System, list[FlowEntry]]] = {}

    @np.errstate(over="ignore", invalid="ignore")
    def __call__(
        self, flow: int, side: int, member: int, t: float, tau: float, state: int, count: int, first: int, second: int
    ) -> None:
        with ONE_AT_A_TIME:
            self._call(flow, side, member, t, tau, state, count, first, second)

    def _call(
        self, flow: int, side: int, member: int, t: float, tau: float, state: int, count: int, first: int, second: int
    ) -> None:
        note_progress(f"the derivative of a force at t = {t:g}")
        n, entries = self._system.dim, len(self._entries)
        whole, at = flow < 0, FlowAt(max(flow, -1 - flow), side, member, (t, tau), numbers_at(state, (n,)).copy())
        if count < 0:
            numbers_at(first, (n,))[:] = self._by_entry(at, -1 - count)
        elif count:
            vectors, directions = numbers_at(first, (count, n)), numbers_at(second, (count, entries))
            vectors[:] = self._push(at, whole, vectors, directions)
        else:
            row = numbers_at(first, (n,))
            row[:] = self._pull(at, whole, row.copy(), numbers_at(second, (entries,)))

    def _push(self, at: FlowAt, whole: bool, vectors: Floats, directions: Floats) -> Floats:
        system, entries = self._member(at.member)
        if whole:
            force = on_side(system.flows[at.flow][1], at.side)
            vectors = flow_of_force(force, system.unforced, at.x, *at.when, self._order).tangents(vectors)
        wanted = np.flatnonzero(directions.any(axis=0)).tolist()
        for number, change in self._changes(at, entries, wanted):
            vectors = vectors + directions[:, number, None] * change
        return vectors

    def _pull(self, at: FlowAt, whole: bool, row: Floats, by_entries: Floats) -> Floats:
        system, entries = self._member(at.member)
        force = on_side(system.flows[at.flow][1], at.side)
        for number, change in self._changes(at, entries, range(len(entries))):
            by_entries[number] += change @ row
        return flow_of_force(force, system.unforced, at.x, *at.when, self._order).cotangent(row) if whole else row

    def _member(self, member: int) -> tuple[System, list[FlowEntry]]:
        """Return the system with the noise of a member, and the entries with those of it."""
        if member not in self._members:
            numbered = methodcaller("among", member, member + 1)
            entries = [one._replace(nearby=one.nearby.with_systems(numbered)) for one in self._entries]
            self._members[member] = numbered(self._system), entries
        return self._members[member]

    def _by_entry(self, at: FlowAt, number: int) -> Floats:
        """Return the derivative of the flow by an entry."""
        entries = self._member(at.member)[1]
        (change,) = differences([entries[number].nearby], partial(self._after, at))
        return change

    def _changes(self, at: FlowAt, entries: Sequence[FlowEntry], wanted: Sequence[int]) -> list[tuple[int, Floats]]:
        """Return the derivatives of the flow by the wanted entries, if it depends on them, with their numbers."""
        numbers = [n for n in wanted if at.flow in entries[n].flows]
        changes = differences([entries[n].nearby for n in numbers], partial(self._after, at))
        return list(zip(numbers, changes, strict=True))

    def _after(self, at: FlowAt, system: System) -> Floats:
        force = on_side(system.flows[at.flow][1], at.side)
        return np.asarray(force.flow_of_order(system.unforced, at.x, *at.when, self._order), dtype=np.float64)


class ForcedTables:
    """Tables of steps with forces by step and inputs, with the derivatives of `inner` for those of the inner loops."""

    # Coefficients are those of `inner`, the entries that are differentiated in Python, those of the flows, and the
    # factors of subtracted Casimirs.

    def __init__(
        self,
        system: System,
        inner: DerivativeTables,
        scheme: Forced,
        entries: Sequence[FlowEntry],
        attitudes: AttitudeDerivatives | None,
    ) -> None:
        self._inner, self._scheme, self._entries = inner, scheme, entries
        # Of shifted energies, whose loops start at the unit element.
        self._attitudes = attitudes if attitudes is not None and attitudes.shifted else None
        start = inner.coefficient_count + len(entries)
        self._flows: list[FlowCoefficients] = []
        for j in range(len(system.flows)):
            self._flows.append(flow_coefficients(system, j, entries, scheme.order, start))
            start += self._flows[-1].own + len(self._flows[-1].moved)
            position, flow = system.flows[j]
            if attitudes is not None and flow.around_steps and self._flows[-1].in_python:
                raise TypeError(
                    f"{system.labels[position]} turns the group element too, and its functions have no second "
                    "derivatives in the kernels; prepare the run without attitude=, or take functions with hessian="
                )
        self._factors, self._count = start, start + len(inner.shift)

    def structure(
        self, system: Any, loops: Any, step: float, entries: Sequence[FlowEntry], values: tuple[Floats, ...]
    ) -> Any:
        """Return the tables for a step of this length, by the loops of the run."""
        scheme, inner = self._scheme, self._inner
        stepping = as_structure(loops.groups[0].tables)
        lengths = list(dict.fromkeys(scheme.fractions))
        carried = [as_structure_of(inner.tables_at(c * step, *values)) for c in lengths]
        callbacks: list[CalledInPython] = []
        addresses: list[int] = []
        for one in carried:
            for carry, kind in ((inner.forward, ForwardRun), (inner.backward, BackwardRun)):
                if callable(carry):
                    callbacks.append(_carried_in_python(carry, kind, one, inner.coefficient_count))
                    addresses.append(callbacks[-1].address)
                else:
                    function = getattr(kernels(), f"{carry}_inside")
                    addresses.append(ctypes.cast(function, ctypes.c_void_p).value or 0)
            addresses.append(0 if callable(inner.forward) else ctypes.addressof(one))
        python = self._own_entries(entries)
        called = CalledInPython(FLOW_CALLBACK, FlowsInPython(system, python, scheme.order))
        flows, owners = [], list[Any]()
        for j, flow in enumerate(self._flows):
            depends = any(j in one.flows for one in python)
            table, kept = flow_derivatives(
                system, j, flow, entries, [c * step for c in lengths], scheme.order, depends, called.address
            )
            flows.append(as_structure(table))
            owners.append(kept)
        attitudes = self._attitudes
        turning = np.zeros(1) if attitudes is None else np.swapaxes(attitudes.of_casimir, 2, 3)
        structure = as_structure(
            ForcedDerivatives(
                forced=ctypes.addressof(stepping.tables),
                inner=np.array(addresses, dtype=np.int64),
                flows=np.array([ctypes.addressof(flow) for flow in flows], dtype=np.int64),
                inner_coefficients=inner.coefficient_count,
                called=len(python),
                coefficients=self._count,
                casimirs=len(inner.shift),
                factors=np.zeros(1) if attitudes is None else np.array(attitudes.factors, dtype=np.float64),
                turning=np.ascontiguousarray(turning),
            )
        )
        structure.owner = loops, stepping, carried, flows, owners
        structure.raising = (*callbacks, called)
        # Whether a part of a step is differentiated in Python.
        structure.in_python = callable(inner.forward) or any(flow.in_python for flow in self._flows)
        return structure

    def _own_entries(self, entries: Sequence[FlowEntry]) -> list[FlowEntry]:
        """Return the entries with the flows that are differentiated by them in Python."""
        covered: list[set[int]] = [set() for _ in entries]
        for j, flow in enumerate(self._flows):
            for number in flow.covered:
                covered[number].add(j)
        return [
            one._replace(flows=tuple(j for j in one.flows if j not in known))
            for one, known in zip(entries, covered, strict=True)
        ]

    def derivative_tables(self, steps_at: Callable[..., Any], names: Sequence[str]) -> DerivativeTables:
        """Return the derivatives of steps with forces by parameters."""
        inner, entries = self._inner, self._entries
        python = self._own_entries(entries)
        coefficients: dict[str, Multiples] = {}
        rules: dict[str, str] = {}
        for name in names:
            of_inner, of_factors = (of.get(name, NO_MULTIPLES) for of in (inner.coefficients, inner.factors))
            numbers = [number for number, one in enumerate(entries) if one.name == name]
            called = [(inner.coefficient_count + k, entries[k].entry, 1.0) for k in numbers if python[k].flows]
            own = {number: entries[number].entry for number in numbers}
            pieces = [of_inner, Multiples.of_triplets(called), *(flow.of_entries(own) for flow in self._flows)]
            pieces.append(of_factors._replace(position=self._factors + of_factors.position))
            coefficients[name] = concatenated(pieces)
            rule = inner.rules.get(name, EXACT)
            moved = called or any({*numbers} & {*flow.moved, *flow.rounded} for flow in self._flows)
            rules[name] = DIFFERENCES if moved and rule == EXACT else rule
        return DerivativeTables(
            tables_at=steps_at,
            keepalive=inner.keepalive,
            forward="forced_directions",
            backward="forced_cotangents",
            coefficient_count=self._count,
            coefficients=coefficients,
            factors=dict.fromkeys(names, NO_MULTIPLES),
            rules=rules,
        )


def _joined(each: Sequence[Multiples]) -> Multiples:
    """Return the multiples of members with an axis of these; raise NotWritable if they are of other coefficients."""
    first = each[0]
    pairs = [(one.position, first.position) for one in each] + [(one.number, first.number) for one in each]
    if not all(itertools.starmap(np.array_equal, pairs)):
        raise NotWritable(DIFFERENT)
    return first._replace(factor=np.stack([one.factor for one in each]))


def joined_tables(each: Sequence[DerivativeTables], tables_at: Callable[..., Any]) -> DerivativeTables:
    """Return the derivatives of steps of the members of a batch, with `tables_at` of all."""
    coefficients = {name: _joined([one.coefficients[name] for one in each]) for name in each[0].rules}
    rules = {name: least_exact(one.rules[name] for one in each) for name in each[0].rules}
    keepalive = tuple(owner for one in each for owner in one.keepalive)
    return each[0]._replace(tables_at=tables_at, coefficients=coefficients, rules=rules, keepalive=keepalive)


def structure_of_members(structures: Sequence[Any], columns: tuple[Any, Sequence[Any]] | None = None) -> Any:
    """Return the tables of steps of members, each with its own, and the loops without forces as `columns`, if any."""
    first = structures[0]
    sizes = [(one.coefficients, one.inner_coefficients, one.casimirs) for one in structures]
    if sizes != sizes[:1] * len(sizes):
        raise NotWritable(DIFFERENT)
    addresses = np.array([ctypes.addressof(one) for one in structures], dtype=np.int64)
    joined = first.source._replace(apart=True, members=addresses)
    if columns is not None:
        stepping, loops = columns
        inner = joined.inner.copy()
        inner[2::3] = [ctypes.addressof(one) for one in loops]
        joined = joined._replace(forced=ctypes.addressof(stepping.tables), inner=inner, stride=loops[0].stride)
    structure = as_structure(joined)
    structure.owner = structures, columns
    structure.raising = tuple(one for own in structures for one in own.raising)
    structure.in_python = any(one.in_python for one in structures)
    return structure


def as_structure_of(tables: Any) -> Any:
    """Return tables as a C structure, and those of steps in Python as they are."""
    return as_structure(tables) if isinstance(tables, tuple | ctypes.Structure) else tables


def _carried_in_python(carry: Callable[..., None], kind: Any, steps: Any, coefficients: int) -> CalledInPython:
    """Return the function that carries vectors through a step in Python as one that the kernels call."""

    def call(_: int, run: int, first: int, last: int, kept: int) -> None:
        with ONE_AT_A_TIME:
            carry(steps, run_at(kind, run, coefficients), first, last)

    return CalledInPython(CARRY_CALLBACK, call)
