"""How many parts are left after each of many Casimir shifts? Without making the parts, where everything is diagonal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.few_parts import MOST_REORDERED
from coadjoint.program.first_fit import numbers_of_groups
from coadjoint.program.shift import ROUNDING, QuadraticCasimir, Shift
from coadjoint.program.sparse_rows import fresh
from coadjoint.systems.lie_poisson import LiePoissonSystem


def numbers_of_parts(
    system: LiePoissonSystem, casimirs: Mapping[str, QuadraticCasimir], shifts: Sequence[Shift]
) -> NDArray[np.int64]:
    """Return the number of parts of ``"auto"`` after each shift, or 0 where only making them tells it.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    casimirs : mapping
        Name -> quadratic Casimir.
    shifts : sequence of tuple of (str, float)
        The shifts.

    Returns
    -------
    ndarray of int64, shape (shifts,)
        Known where M and the Casimirs are diagonal, and the parts so many that they are joined in one order alone.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.program.shift import quadratic_casimirs
    >>> body = co.LiePoissonSystem(co.algebras.so(12), co.Quadratic(np.arange(1.0, 67.0)))
    >>> shifts = [(), (("|x|^2", 0.5),), (("|x|^2", 0.25),)]
    >>> numbers_of_parts(body, quadratic_casimirs(body), shifts).tolist()
    [15, 14, 15]
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
    pairs = fresh(i, j)
    enough = np.flatnonzero(np.count_nonzero(present, axis=0) > MOST_REORDERED)
    unknown[enough] = numbers_of_groups(system.dim, i[pairs], j[pairs], present[:, enough])
    return unknown
