"""Schemes for a purpose: the default of runs, the suggestion for a system, references, and candidates for a choice."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import names, scheme
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system

PREFERRED_SCHEMES: tuple[Method, ...] = (Splitting(order=4), GaussLegendre(stages=3))
"""Tried in this order."""
DEFAULT_SCHEME: Method = Splitting()
"""For systems of vectors that it supports."""
ANY_TOLERANCE = 1e-9
"""Relative tolerance of a candidate, which `choose` replaces by that for the accuracy."""


def default_scheme(system: Any) -> Method:
    """Return the scheme of a run for which none is given, for systems with or without forces, and batches.

    It is `Splitting()` of order 2 if it supports every system, otherwise the next one of `PREFERRED_SCHEMES`; for
    matrices the suggested one. If none supports the system, the last one is returned, whose error names the reason.

    Examples
    --------
    >>> import coadjoint as co
    >>> default_scheme(co.systems.rigid_body()), default_scheme(co.systems.sklyanin())
    (Splitting(order=2...), GaussLegendre(stages=3...))
    """
    if system.has_matrices:
        return suggested_scheme(system.unforced)
    *first, last = DEFAULT_SCHEME, *PREFERRED_SCHEMES[1:]
    return next((method for method in first if all(_supports(method, one.unforced) for one in system.distinct)), last)


def _supports(method: Method, system: Any) -> bool:
    try:
        method.properties(system)
    except (TypeError, ValueError):
        return False
    return True


def reference_scheme(order: int) -> Method:
    """Return the scheme of this even order for numerical references: symplectic, symmetric, and for every system."""
    return GaussLegendre(order // 2)


@cache
def candidate_schemes(processed: bool = False) -> tuple[Method, ...]:
    """Return the schemes from which `choose` selects by default, with processed splittings at the end if requested.

    The first one chooses its own steps; the next two, at constant steps, predict the cost of others of their family.
    """
    from coadjoint.methods.taylor import Taylor

    return (
        Taylor(tolerance=ANY_TOLERANCE),
        *(Taylor(p) for p in (16, 8, 20, 12, 24, 14, 10, 6)),
        *(GaussLegendre(s) for s in (8, 6, 12, 10, 4, 3, 2)),
        *(Splitting(order=p) for p in (10, 8, 6, 4, 2)),
        *(Splitting(scheme=f"blanes_casas_murua{p}") for p in (10, 8, 6) if processed),
    )


def suggested_scheme(system: System) -> Method:
    """Return the suggested scheme for a system, if no accuracy is given.

    It is the splitting of order 4 if it supports the system: it preserves the Poisson bracket, every Casimir, and the
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
    if system.has_matrices:
        matrices = cast(Any, system)
        first = sorted(_supporting_schemes(matrices), key=lambda method: not method.properties(matrices).poisson)
    for method in first:
        if _supports(method, system):
            return method
    last.properties(system)
    return last


def _supporting_schemes(system: MatrixSystem) -> Iterator[Method]:
    """Yield the registered schemes that support a system, each as its first example."""
    for name in names():
        method = scheme(name).examples()[0]
        if _supports(method, system):
            yield method
