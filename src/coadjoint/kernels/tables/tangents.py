"""Tables of loops that carry tangent vectors with the state, and their output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.functions.compiled_functions import CompiledFunction, Owners
from coadjoint.kernels.loop import CompiledLoop, loop_over
from coadjoint.kernels.tables.compiled import CompiledTables, addresses_of
from coadjoint.kernels.tables.flow import FlowTables
from coadjoint.kernels.tables.runge_kutta import RungeKuttaTables
from coadjoint.kernels.tables.structures import filled
from coadjoint.systems.hamiltonians.terms import FunctionTerm
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
    compiled = CompiledFunction(
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
