"""Number of parts after each of many Casimir shifts, without building the parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.parts.few_parts import MAX_REORDERED
from coadjoint.program.parts.first_fit import count_groups
from coadjoint.program.shifts.shift import ROUNDING, QuadraticCasimir, Shift
from coadjoint.program.sparse_rows import run_starts
from coadjoint.systems.lie_poisson import LiePoissonSystem


def count_parts(
    system: LiePoissonSystem, casimirs: Mapping[str, QuadraticCasimir], shifts: Sequence[Shift]
) -> NDArray[np.int64]:
    """Count the parts of ``"auto"`` after each shift; 0 if they must be built to be counted.

    Available if M and the Casimirs are diagonal, and the parts too many to be joined in more than one order.
    """
    unknown = np.zeros(len(shifts), dtype=np.int64)
    terms = system.hamiltonian.terms()
    term = terms[0].form
    if not shifts or len(terms) > 1 or term is None or term.piece is not None:
        return unknown
    used = {name for shift in shifts for name, _ in shift}
    if np.any(term.rows != term.indices) or not all(casimirs[name].diagonal for name in used):
        return unknown
    own = np.zeros(system.dim)
    own[term.indices] = term.values
    present = np.empty((system.dim, len(shifts)), dtype=bool)
    for number, shift in enumerate(shifts):
        total, size = own.copy(), np.abs(own)
        for name, factor in shift:
            casimir = casimirs[name]
            total[casimir.rows] -= factor * casimir.values
            size[casimir.rows] += np.abs(factor * casimir.values)
        present[:, number] = (np.abs(total) > ROUNDING * size) | (term.linear != 0)
    i, j, _, _ = system.algebra.triples
    pairs = run_starts(i, j)
    enough = np.flatnonzero(np.count_nonzero(present, axis=0) > MAX_REORDERED)
    unknown[enough] = count_groups(system.dim, i[pairs], j[pairs], present[:, enough])
    return unknown
