"""Tables of steps that are differentiated: with tangent vectors along, and whole runs forward and backward."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import compiled_function
from coadjoint.kernels.interface import codes, limit
from coadjoint.kernels.loop import CompiledLoop, kernel_loop, loop_over, raise_outcome
from coadjoint.kernels.tables.compiled import (
    CompiledTables,
    Owners,
    addresses_by_coefficients,
    addresses_of,
    as_structure,
    filled,
    structure_of_table,
)
from coadjoint.kernels.tables.field import terms_of_field
from coadjoint.kernels.tables.flow import FlowTables, flow_tables, mark_rational, with_properties
from coadjoint.kernels.tables.runge_kutta import RungeKuttaTables
from coadjoint.program.actions import Action, build_action, empty_action
from coadjoint.program.added_part import AddedPart
from coadjoint.program.generators import BasisMatrices, given_matrices
from coadjoint.program.table import FlowTable, dual_action
from coadjoint.program.term_table import Terms
from coadjoint.systems.energy_derivatives import FunctionDerivative
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System

STRETCH_ENTRIES = 3
"""Numbers that store a product of lengths, (high + low) 2^exponent."""


@dataclass(frozen=True)
class Frame:
    """Initial tangent vectors (k, n), one per row, and the number of steps between orthonormalizations."""

    vectors: NDArray[np.float64]
    every: int


TANGENT_LOOPS: Mapping[type, tuple[str, str]] = {
    FlowTables: ("flow_tangents_advance", "FlowTangents"),
    RungeKuttaTables: ("runge_kutta_tangents_advance", "RungeKuttaTangents"),
}
"""Class of the tables of a loop -> the loop that also carries tangent vectors, and the C structure of its tables."""


def with_tangents(
    loop: CompiledLoop, system: System, functions: Mapping[int, FunctionTerm], frame: Frame
) -> CompiledLoop:
    """Return a loop that takes the same steps, bitwise, with tangent vectors and without the group element."""
    name, structure = TANGENT_LOOPS[type(loop.tables)]
    check_differentiable(system)
    hessians, keepalive = addresses_of(functions, loop.tables.terms.size, "hessian", "the Hamiltonian")
    derivative, structure_owners = derivative_of_structure(system)
    carried, size = frame.vectors.shape
    vectors = np.ascontiguousarray(frame.vectors, dtype=np.float64)
    tangents = filled(
        "Tangents",
        size=size,
        carried=carried,
        every=frame.every,
        frame=vectors,
        hessians=hessians,
        derivative=derivative,
    )
    tables = filled(structure, base=loop.tables, tangents=tangents)
    return loop_over(name, CompiledTables(tables, (*loop.keepalive, *keepalive, *structure_owners)))


def check_differentiable(system: System) -> None:
    """Raise TypeError if the Hamiltonian has no second derivatives, or J(x) no derivative."""
    if not all(term.differentiable for term in system.hamiltonian.terms()):
        raise TypeError(
            f"tangent vectors need second derivatives, which the Hamiltonian of {system.name} does not have; "
            "give hessian="
        )
    if system.algebra is None and system.derivative_function is None:
        raise TypeError(
            f"tangent vectors need the derivative of J, which is unknown for {system.name}; give derivative=, "
            "or derivative_function"
        )


def derivative_of_structure(system: System) -> tuple[NDArray[np.int64], Owners]:
    """Compile the derivative of a structure matrix given as a function; return its address, if any, and its owner."""
    if system.algebra is not None:
        return np.zeros(0, dtype=np.int64), ()
    assert system.derivative_function is not None
    compiled = compiled_function(
        system.derivative_function,
        system.dim,
        system.dim**3,
        scalar=False,
        flat=True,
        timed=False,
        what="the derivative of the structure matrix",
    )
    return np.array([compiled.address], dtype=np.int64), (compiled,)


def stretch_logarithms(memory: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the logarithms (members, count) of the accumulated growth of each vector up to the last step."""
    entries = memory[:, memory.shape[1] - count * STRETCH_ENTRIES :].reshape(-1, count, STRETCH_ENTRIES)
    high, low, exponent = np.moveaxis(entries, 2, 0)
    return np.asarray(exponent * np.log(2.0) + (np.log(high) + np.log1p(low / high)))


Floats = NDArray[np.float64]


class FlowCotangents(NamedTuple):
    """Tables of a flow table with the actions on cotangents; see `source/boundary/tables.hpp`."""

    base: FlowTables
    dual: Action
    group_dual: Action
    hessians: NDArray[np.int64]
    added: int
    stride: int = 0
    column: int = 0


class ForwardRun(NamedTuple):
    """Steps with tangent vectors: arrays and their sizes; see `source/boundary/tables.hpp`."""

    size: int
    square: int
    members: int
    carried: int
    t0: float
    h: float
    k0: int
    k1: int
    momenta: Floats
    errors: Floats
    groups: Floats
    marked: int
    marks: NDArray[np.int64]
    at_points: Floats
    at_groups: Floats
    tangents: Floats
    group_tangents: Floats
    coefficients: Floats
    threads: int
    apart: bool


class BackwardRun(NamedTuple):
    """Steps backward with cotangents: arrays and their sizes; see `source/boundary/tables.hpp`."""

    size: int
    square: int
    members: int
    t0: float
    h: float
    k0: int
    k1: int
    momenta: Floats
    errors: Floats
    groups: Floats
    group_errors: Floats
    marked: int
    marks: NDArray[np.int64]
    at_points: Floats
    at_groups: Floats
    cotangents: Floats
    group_cotangents: Floats
    coefficients: Floats
    deviations: Floats
    undone: bool
    threads: int


# Axes of the arrays of a run; `side` is that of a group element.
AXES: Mapping[str, tuple[str, ...]] = {
    "momenta": ("members", "size"),
    "errors": ("members", "size"),
    "groups": ("members", "square"),
    "group_errors": ("members", "square"),
    "marks": ("marked",),
    "tangents": ("members", "carried", "size"),
    "group_tangents": ("members", "carried", "side", "side"),
    "cotangents": ("members", "size"),
    "group_cotangents": ("members", "side", "side"),
    "deviations": ("members",),
}


def numbers_at(address: int, shape: tuple[int, ...], kind: Any = ctypes.c_double) -> NDArray[Any]:
    """Return the numbers at an address as an array in their memory."""
    size = prod(shape)
    return np.frombuffer((kind * size).from_address(address), dtype=kind).reshape(shape) if size else np.zeros(shape)


def run_at(kind: Any, address: int, coefficients: int) -> Any:
    """Return a `ForwardRun` or `BackwardRun` whose structure a kernel has at an address, with arrays in its memory."""
    structure = structure_of_table(kind).from_address(address)
    sizes = {name: getattr(structure, name) for name in ("size", "square", "members", "marked")}
    forward = kind is ForwardRun
    sizes |= {"side": round(sizes["square"] ** 0.5), "carried": structure.carried if forward else 0}
    of_each = ("carried",) if forward else ()
    by_member = not forward or structure.apart
    axes = {
        **AXES,
        "at_points": ("marked", "members", *of_each, "size"),
        "at_groups": ("marked", "members", *of_each, "side", "side"),
        "coefficients": (*(("members",) if by_member else ()), *of_each, "coefficients"),
    }
    sizes["coefficients"] = coefficients

    def value(name: str) -> Any:
        found = getattr(structure, name)
        if name not in axes:
            return found
        shape = tuple(sizes[axis] for axis in axes[name])
        return numbers_at(found, shape, ctypes.c_int64 if name == "marks" else ctypes.c_double)

    return kind(**{name: value(name) for name in kind._fields})


def flow_cotangents(
    flow_table: FlowTable, system: LiePoissonSystem, group: Any, h: float, compensated: bool, added: AddedPart | None
) -> CompiledTables:
    """Return `FlowCotangents` of a flow table, with the part of a derivative by parameters if there is one."""
    check_differentiable(system)
    base = flow_tables(flow_table, h, compensated)
    tables: FlowTables = base.tables
    hessians, keepalive = addresses_of(flow_table.functions, flow_table.terms.size, "hessian", "the Hamiltonian")
    parts, index = flow_table.parts, -1
    dual = _marked_like(dual_action(system.algebra, flow_table), tables.state)
    group_dual = empty_action()
    if flow_table.group is not None:
        rho = given_matrices(group)
        matrices = (
            BasisMatrices.coadjoint(system.algebra)
            if rho is None
            else BasisMatrices.on_group(system.algebra, -np.swapaxes(rho, 1, 2))
        )
        group_dual = _marked_like(build_action(matrices, parts), tables.group)
    if added is not None:
        index = len(parts)
        rows, zeros = added.stages, np.zeros(added.shares, dtype=np.int64)
        tables = tables._replace(
            longest=max(tables.longest, added.angles),
            only=np.append(tables.only, np.int64(-1)),
            bent=np.append(tables.bent, np.uint8(0)),
            properties=np.append(tables.properties, np.uint8(0)),
            frequency=np.concatenate([tables.frequency, np.zeros(added.angles)]),
            part=rows.part,
            tau=rows.coefficient * h,
            moment=rows.moment,
            section=rows.section,
            share=np.append(tables.share, np.uint32(tables.share[-1] + added.shares)),
            terms=added.terms,
            addresses=np.concatenate([tables.addresses, zeros]),
            called=np.concatenate([tables.called, zeros - 1]),
            state=_marked_first(added.state, tables.state),
            group=_marked_first(added.group, tables.group) if added.group is not None else tables.group,
        )
        tables = with_properties(tables)
        by_coefficients, owners = addresses_by_coefficients(added.functions, added.shares)
        hessians, keepalive = np.concatenate([hessians, by_coefficients]), (*keepalive, *owners)
    return CompiledTables(
        FlowCotangents(tables, dual, group_dual, hessians, index), (*base.keepalive, *keepalive), base.sources
    )


class RungeKuttaCotangents(NamedTuple):
    """Tables of a Runge-Kutta method with the terms of derivatives; see `source/boundary/tables.hpp`."""

    base: RungeKuttaTables
    hessians: NDArray[np.int64]
    derivative: NDArray[np.int64]
    added: Terms
    functions: NDArray[np.int64]


def runge_kutta_cotangents(
    loop: CompiledLoop, system: System, added: Terms, functions: Sequence[FunctionDerivative]
) -> CompiledTables:
    """Return the tables of a loop over stages, with the terms of the derivative of the energy."""
    check_differentiable(system)
    base: RungeKuttaTables = loop.tables
    table = terms_of_field(system)
    hessians, keepalive = addresses_of(table.functions, base.field.terms.size, "hessian", "the Hamiltonian")
    derivative, owners = derivative_of_structure(system)
    by_coefficients, others = addresses_by_coefficients(functions, added.size)
    return CompiledTables(
        RungeKuttaCotangents(base, hessians, derivative, added, by_coefficients),
        (*loop.keepalive, *keepalive, *owners, *others),
    )


def with_step(tables: FlowCotangents, h: float) -> FlowCotangents:
    """Return the tables of another step."""
    base = tables.base
    return tables._replace(base=base._replace(tau=base.tau * (h / base.step), step=h))


def _marked_first(action: Action, marked: Action) -> Action:
    """Return an action with the kinds of another one, which it extends."""
    return action._replace(kind=np.concatenate([marked.kind, action.kind[len(marked.kind) :]]))


def _marked_like(action: Action, marked: Action) -> Action:
    """Mark the rational rotations of the parts that have them in another representation."""
    starts = np.append(0, np.cumsum(marked.kind >= limit("RATIONAL")))
    return mark_rational(action, np.diff(starts[marked.run]) > 0)


def advance_tables(name: str, tables: Any, run: Any, first: int, last: int, stop: ctypes.c_int64) -> bool:
    """Call a kernel for the members `first` to `last` - 1 of a run; return whether all equations were solved."""
    outcome = kernel_loop(name)(
        ctypes.byref(as_structure(tables)),
        ctypes.byref(as_structure(run)),
        ctypes.c_int64(first),
        ctypes.c_int64(last),
        ctypes.byref(stop),
    )
    if outcome == codes("Outcome")["UNSOLVED"]:
        return False
    if outcome < 0:
        raise_outcome(outcome)
    return True
