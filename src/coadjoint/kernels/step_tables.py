"""From a system and a step method to the arrays of the compiled loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from coadjoint.kernels.field_tables import field_of, group_of, substeps
from coadjoint.kernels.stepping import Stepping, StepTables, step_address
from coadjoint.kernels.tables import Compiled, addresses_of, invariants_table, watch_tables
from coadjoint.methods.step_method import StepMethod
from coadjoint.program.terms import TermTable
from coadjoint.systems.kinds import System


def step_tables(
    system: System, method: StepMethod, representation: Any = None, fractions: Sequence[float] = (1.0,)
) -> Compiled:
    """Return a step method on a system as arrays for the loop of `coadjoint.kernels.stepping`.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    method : StepMethod
        The scheme of one substep.
    representation : None, "coadjoint" or (n, d, d) array
        The group element that is carried along.
    fractions : sequence of float
        Lengths of the substeps of a step.

    Returns
    -------
    Compiled
        With a `Stepping`; it does not depend on the step.

    Raises
    ------
    ValueError
        The scheme cannot serve the system.
    TypeError
        A function of the user cannot be compiled.
    """
    method.properties(system)
    field, keep = field_of(system)
    table = TermTable()
    for term in system.hamiltonian.terms():
        table.add(term)
    values, values_kept = addresses_of(table.functions, len(table), "value", "the Hamiltonian")
    restored = method.restored(system)
    watched = invariants_table([], system.dim) if restored is None else watch_tables(system, restored)
    integers, numbers = method.constants()
    tables = StepTables(
        field,
        values,
        group_of(system, representation),
        watched.tables,
        np.array(integers, dtype=np.int64),
        np.array(numbers, dtype=np.float64),
    )
    lengths, moments = substeps(fractions)
    step = np.array([step_address(method.compiled_step)], dtype=np.int64)
    stepping = Stepping(step, len(lengths), lengths, moments, tables)
    return Compiled(stepping, (*keep, *values_kept, *watched.keep))
