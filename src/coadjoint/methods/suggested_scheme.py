"""The default scheme of runs, and the suggested scheme for a system, if no accuracy is given."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import names, scheme
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.protocol import is_matrix_system, unforced
from coadjoint.systems.system_checks import System, check_one_system

PREFERRED_SCHEMES: tuple[Method, ...] = (Splitting(order=4), GaussLegendre(stages=3))
"""Tried in this order."""


def default_scheme(system: Any) -> Method:
    """Return the scheme of a run for which none is given, for systems with or without forces."""
    plain = unforced(system)
    return suggested_scheme(cast(System, plain)) if is_matrix_system(plain) else Splitting()


def suggested_scheme(system: System) -> Method:
    """Return the suggested scheme for a system, if no accuracy is given.

    It is the splitting of order 4 if it supports the system: it keeps the Poisson bracket, every Casimir, and the
    attitude in every representation, and its energy does not drift. Otherwise, if H has no exact flows or J(x) is not
    linear in x, it is Gauss-Legendre with three stages. For a system of matrices it is the first registered scheme that
    is a Poisson map on it. For a given accuracy, `choose` selects scheme and step.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.

    Returns
    -------
    Method

    Raises
    ------
    TypeError, ValueError
        Neither supports the system; the error is that of the second one.

    Examples
    --------
    >>> import coadjoint as co
    >>> suggested_scheme(co.systems.rigid_body()), suggested_scheme(co.systems.sklyanin())
    (Splitting(order=4...), GaussLegendre(stages=3...))
    """
    check_one_system(system)
    *first, last = PREFERRED_SCHEMES
    if is_matrix_system(system):
        first = sorted(_supporting_schemes(system), key=lambda method: not method.properties(cast(Any, system)).poisson)
    for method in first:
        try:
            method.properties(system)
        except (TypeError, ValueError):
            continue
        return method
    last.properties(system)
    return last


def _supporting_schemes(system: MatrixSystem) -> Iterator[Method]:
    """Yield the registered schemes that support a system, each as its first example."""
    for name in names():
        method = scheme(name).examples()[0]
        try:
            method.properties(cast(Any, system))
        except (TypeError, ValueError):
            continue
        yield method
