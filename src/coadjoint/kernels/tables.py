"""Tables that the compiled loops read: compiled user functions, flow programs and invariants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.invariants.logarithmic import LogarithmicInvariant
from coadjoint.kernels.free_body_tables import body_tables
from coadjoint.kernels.functions import CompiledFunction, FormulaFunction, Owners, PythonCallback, warn_slow_compilation
from coadjoint.kernels.interface import limit
from coadjoint.kernels.recording_tables import Watch
from coadjoint.program.actions import Action, empty_action
from coadjoint.program.blocks import Kind
from coadjoint.program.rational_rotations import acts_rationally
from coadjoint.program.table import Program
from coadjoint.program.term_table import LINEAR, Terms, ValueTable
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.user_functions import Formula, forms_of, takes_time


class FlowTables(NamedTuple):
    """The arrays of a program; the coefficients of the rows are already multiplied by `step`, and the loops rescale
    them.

    A part has at most `longest` angles; only[p] is the row of a part with a single, linear one, else -1. bent[p] is 1
    if the blocks of part p on the group have other frequencies, frequency[row], than on the momentum, so that they need
    the angle itself. Rational rotations are marked in the kinds of the actions. called[k] is the index of the free body
    of share k, else -1; `body_column` has its triple and the other triple of a bond (the same one without a bond),
    `body` its constants. direct[p] has bit 1 if all blocks of a body part rotate by the angle itself, bit 2 if it
    consists of bonds of unit scale.
    """

    longest: int
    only: NDArray[np.int64]
    bent: NDArray[np.uint8]
    frequency: NDArray[np.float64]
    part: NDArray[np.uint32]
    tau: NDArray[np.float64]
    moment: NDArray[np.float64]
    section: NDArray[np.uint32]
    share: NDArray[np.uint32]
    terms: Terms
    addresses: NDArray[np.int64]
    state: Action
    group: Action
    compensated: bool
    called: NDArray[np.int64]
    body_column: NDArray[np.uint32]
    body: NDArray[np.float64]
    direct: NDArray[np.uint8]
    step: float


FLOW_LOOP = "flow_advance"
"""Name of the loop. Between calls the state is unfinished: the last flow of a step is merged with the first of the
next, and *finish* acts on a copy.
"""


ORDERS = {"value": 0, "gradient": 1, "hessian": 2}


class CompiledTables(NamedTuple):
    """Tables for a compiled loop, and the compiled user functions that must live as long as they do."""

    tables: Any
    keepalive: tuple[Any, ...]


def addresses_of(
    functions: Mapping[int, FunctionTerm], count: int, derivative: str, owner: str
) -> tuple[NDArray[np.int64], Owners]:
    """Compile the values, gradients or Hessians of FUNCTION terms, given by term number, out of `count` terms.

    Return the addresses (count,), 0 for other terms, and the owners of the machine code. `owner` appears in messages.
    """
    addresses = np.zeros(count, dtype=np.int64)
    keepalive: list[CompiledFunction | FormulaFunction | PythonCallback] = []
    if not functions:
        return addresses, ()
    warn_slow_compilation(
        user_function for term in functions.values() if forms_of(user_function := getattr(term, derivative)) is None
    )
    for k, term in functions.items():
        function = getattr(term, derivative)
        if (forms := forms_of(function)) is not None:
            keepalive.append(FormulaFunction(forms))
            addresses[k] = keepalive[-1].address
            continue
        size = len(term.coordinates)
        if derivative == "value" and getattr(term.value, "called_in_python", False):
            keepalive.append(PythonCallback(term.value, size))
            addresses[k] = keepalive[-1].address
            continue
        results = size ** ORDERS[derivative]
        compiled = CompiledFunction(
            function,
            size,
            results,
            scalar=term.scalar,
            flat=derivative != "value",
            timed=term.timed,
            what=f"the {derivative} of {owner}",
        )
        keepalive.append(compiled)
        addresses[k] = compiled.address
    return addresses, tuple(keepalive)


def flow_tables(program: Program, h: float, compensated: bool) -> CompiledTables:
    """Return `FlowTables` of a program with float64 constants, for a step h (negative for backward).

    `compensated` selects compensated summation of the momentum.
    """
    count = len(program.terms.kind)
    addresses, keepalive = addresses_of(program.functions, count, "gradient", "the Hamiltonian")
    group = program.group if program.group is not None else empty_action()
    rows = program.rows
    edges = program.terms.row[program.share]
    is_linear = (
        (np.diff(edges) == 1) & (np.diff(program.share) == 1) & (program.terms.kind[program.share[:-1]] == LINEAR)
    )
    turning = np.concatenate([[0], np.cumsum(program.frequency != 0)])
    rational = np.diff(turning[edges]) > 0
    rational_on_group = np.zeros_like(rational)
    if program.group is not None and np.any(rational):
        rational_on_group = rational & acts_rationally(group, program.parts, program.frequency)
    tables = FlowTables(
        int(np.max(np.diff(edges), initial=1)),
        np.where(is_linear, edges[:-1].astype(np.int64), -1),
        (rational & ~rational_on_group).astype(np.uint8),
        program.frequency,
        rows.part,
        rows.coefficient * h,
        rows.moment,
        rows.section,
        program.share,
        program.terms,
        addresses,
        _marked(program.state, rational),
        _marked(group, rational_on_group),
        compensated,
        *body_tables(program),
        h,
    )
    return CompiledTables(tables, keepalive)


def _marked(action: Action, rational: NDArray[np.bool_]) -> Action:
    """Mark the rotations of some parts as rational: tan(angle/2) is replaced by half the angle."""
    kind = action.kind.copy()
    for part in np.flatnonzero(rational):
        kinds = kind[action.run[part] : action.run[part + 1]]
        kinds[(kinds == Kind.ROTATE) | (kinds == Kind.CUBIC)] += limit("RATIONAL")
    return action._replace(kind=kind)


def watch_tables(system: Any, invariants: Mapping[str, Any]) -> CompiledTables:
    """Return a `Watch` of the energy of a system, then of the given `Polynomial`, `Quadratic` or `Invariant` by name.

    The cost of a quadratic invariant is proportional to its nonzero entries.
    """
    return invariants_table([("the energy", system.hamiltonian), *invariants.items()], system.dim)


def balance_tables(system: Any, invariants: Mapping[str, Any], accounts: Sequence[tuple[str, str]]) -> CompiledTables:
    """Return a `Watch` for states with accounts: energy and invariants, then each of them minus its accounts.

    `accounts` has the force and the invariant ("energy" or a name) of each account, an entry after the coordinates.
    """
    watched = [("energy", system.hamiltonian), *invariants.items()]
    subtracted = [
        [system.dim + k for k, (_, invariant) in enumerate(accounts) if invariant == name] for name, _ in watched
    ]
    return invariants_table([*watched, *watched], system.dim, [*([()] * len(watched)), *subtracted])


def invariants_table(
    invariants: Sequence[tuple[str, Any]], size: int, subtracted: Sequence[Sequence[int]] | None = None
) -> CompiledTables:
    """Return a `Watch` of named invariants of states with `size` coordinates; names appear in messages.

    `taken` has for each invariant the indices of entries of a state that are subtracted from it.
    """
    table, first, constant, period, owners = ValueTable(), [0], [], [], {}

    def end_invariant(name: str, offset: float, wrapped: float) -> None:
        owners.update(dict.fromkeys(range(first[-1], len(table)), name))
        first.append(len(table))
        constant.append(offset)
        period.append(wrapped)

    def add_hamiltonian(hamiltonian: Any) -> float:
        offset = 0.0
        for term in hamiltonian.terms():
            table.add(term)
            offset += float(term.constant)
        return offset

    for k, (name, invariant) in enumerate(invariants):
        offset, wrapped = 0.0, 0.0
        if isinstance(invariant, Invariant):
            table.function(function_of_all(invariant, size))
            wrapped = float(invariant.period)
        else:
            offset = add_hamiltonian(as_hamiltonian(invariant, size))
        if subtracted is not None and len(subtracted[k]):
            count = len(subtracted[k])
            table.add_linear(
                subtracted[k], np.full(count, -1.0), np.zeros(count + 1, dtype=np.int64), np.zeros(0), np.zeros(0)
            )
        end_invariant(name, offset, wrapped)
    pairs = [addresses_of({k: term}, len(table), "value", owners[k]) for k, term in table.functions.items()]
    addresses = sum((of_term for of_term, _ in pairs), np.zeros(len(table), dtype=np.int64))
    terms = table.table()
    longest = int(np.max(np.diff(terms.row), initial=0))
    watch = Watch(
        len(constant),
        terms,
        addresses,
        np.array(first, dtype=np.uint32),
        np.array(constant, dtype=np.float64),
        np.array(period, dtype=np.float64),
        longest,
    )
    return CompiledTables(watch, tuple(owner for _, keepalive in pairs for owner in keepalive))


def function_of_all(invariant: Invariant, size: int) -> FunctionTerm:
    """Return an `Invariant` as a term that reads all coordinates."""
    timed = takes_time(invariant.value, "an invariant")
    gradient = invariant.gradient or invariant.value
    value = invariant.value
    if isinstance(invariant, LogarithmicInvariant):
        value = Formula(value, invariant.formula.forms())
    return FunctionTerm(np.arange(size), value, gradient, None, timed=timed)
