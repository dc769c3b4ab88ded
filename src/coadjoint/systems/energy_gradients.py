"""Gradients of the energy at many states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm

Floats = NDArray[np.float64]


@ignore_overflow
def gradients_at(system: Any, x: Floats, times: Floats) -> Floats:
    """Return grad H at states (points, members, n) and times (points,)."""
    if system.is_batch:
        members = [gradients_at(member, x[:, m : m + 1], times) for m, member in enumerate(system)]
        return np.concatenate(members, axis=1)
    system = system.unforced
    H = system.hamiltonian
    if system.has_matrices and not system.timed:
        return np.asarray(H.gradient(x))
    terms = H.terms()
    if not terms:
        return np.array(
            [[H.gradient(state, t) for state in states] for states, t in zip(x, times.tolist(), strict=True)]
        )
    total = np.zeros(x.shape)
    for term in terms:
        if isinstance(term, FunctionTerm):
            _add_functions(total, term, x, times)
        elif isinstance(term, PolynomialTerm) and term.form is None:
            total += term.polynomial.gradient(x)
        else:
            _add_quadratic(total, term.form, x)
    return total


def _add_quadratic(total: Floats, term: Any, x: Floats) -> None:
    from scipy.sparse import csr_array

    n = x.shape[-1]
    M = csr_array((term.values, term.indices, term.indptr), shape=(n, n))
    total += (M @ x.reshape(-1, n).T).T.reshape(x.shape) + term.linear


def _add_functions(total: Floats, term: FunctionTerm, x: Floats, times: Floats) -> None:
    for k, t in enumerate(times.tolist()):
        for m in range(x.shape[1]):
            y = x[k, m, term.coordinates]
            total[k, m, term.coordinates] += term.gradient(y[0] if term.scalar else y, *((t,) if term.timed else ()))
