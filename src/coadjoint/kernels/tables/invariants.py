"""Tables of watched invariants: energy, Casimirs and other quantities, with work integrals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.kernels.tables.compiled import CompiledTables, addresses_of, with_functions
from coadjoint.kernels.tables.recording import Watch
from coadjoint.program.sources import INDEPENDENT, CoefficientNumbers, Multiples, Sources, concatenated, sources_of
from coadjoint.program.term_table import TermTable
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.hamiltonians.terms import FunctionTerm, Term
from coadjoint.systems.user_functions import takes_time


def watch_tables(system: Any, invariants: Mapping[str, Any], compact: bool = False) -> CompiledTables:
    """Return a `Watch` of the energy of a system, then of other invariants by name; `compact` ones store rows once."""
    found = invariants_table([("the energy", system.hamiltonian), *invariants.items()], system.dim, compact=compact)
    return replace(found, sources=lambda: _sources_of_watch(system.hamiltonian.terms(), found.tables, (0,)))


def _sources_of_watch(terms: Sequence[Term], watch: Watch, energies: Sequence[int]) -> Sources:
    """Return the sources of a watch whose invariants of these numbers are the energy."""
    found: dict[str, list[Multiples]] = {}
    functions, computed, energy = dict[int, Any](), dict[str, Any](), CoefficientNumbers.of(terms)
    for first in watch.first[list(energies)].astype(np.int64).tolist():
        source = np.full(watch.terms.size, INDEPENDENT)
        source[first : first + len(terms)] = np.arange(len(terms))
        of_one = sources_of(watch.terms, source, watch.terms.target, terms).within("terms.")
        for name, one in of_one.multiples.items():
            found.setdefault(name, []).append(one)
        functions |= {first + t: terms[t] for t in energy.constants}
        computed |= of_one.computed
    constant = np.full(len(energies), energy.size - 1)
    found["constant"] = [Multiples(np.array(energies), constant, np.ones(len(energies)))]
    sources = Sources({name: concatenated(parts) for name, parts in found.items()}, computed=computed)
    return with_functions(sources, functions, "value", "the energy", terms)


def balance_tables(
    system: Any, invariants: Mapping[str, Any], work_integrals: Sequence[tuple[str, str]]
) -> CompiledTables:
    """Return a `Watch` of energy and invariants, then of each minus its `work_integrals`, (force, invariant)."""
    watched = [("energy", system.hamiltonian), *invariants.items()]
    subtracted = [
        [system.dim + k for k, (_, invariant) in enumerate(work_integrals) if invariant == name] for name, _ in watched
    ]
    found = invariants_table([*watched, *watched], system.dim, [*([()] * len(watched)), *subtracted])
    energies = 0, len(watched)
    return replace(found, sources=lambda: _sources_of_watch(system.hamiltonian.terms(), found.tables, energies))


def invariants_table(
    invariants: Sequence[tuple[str, Any]],
    size: int,
    subtracted: Sequence[Sequence[int]] | None = None,
    compact: bool = False,
) -> CompiledTables:
    """Return a `Watch` of named invariants of states with `size` coordinates; names appear in messages."""
    table, first, constant, period, owners = TermTable(used_rows=True), [0], [], [], {}

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
    terms = (table.repeated_table() if compact else None) or table.table()
    # The loops allocate as many arguments of functions; terms that repeat have none.
    longest = 0 if terms.repeated else int(np.max(np.diff(terms.row), initial=0))
    watch = Watch(
        len(constant),
        terms,
        addresses,
        np.array(first, dtype=np.uint32),
        np.array(constant, dtype=np.float64),
        np.array(period, dtype=np.float64),
        longest,
    )
    return CompiledTables(watch, tuple(owner for _, keepalive in pairs for owner in keepalive), Sources)


def function_of_all(invariant: Invariant, size: int) -> FunctionTerm:
    """Return an `Invariant` as a term that reads all coordinates."""
    timed = takes_time(invariant.value, "an invariant")
    gradient = invariant.gradient or invariant.value
    return FunctionTerm(np.arange(size), invariant.value, gradient, None, timed=timed)
