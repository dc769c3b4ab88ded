"""Schemes for a purpose: the default of runs, the suggestion for a system, references, and candidates for a choice."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from coadjoint.methods.gauss_legendre import GaussLegendre
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import names, scheme
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system

if TYPE_CHECKING:
    from coadjoint.systems.matrices.matrix_system import MatrixSystem

PREFERRED_SCHEMES: tuple[Method, ...] = (Splitting(order=4), GaussLegendre(stages=3))
"""Tried in this order."""
DEFAULT_SCHEME: Method = Splitting()
"""For systems of vectors that it supports."""
ANY_TOLERANCE = 1e-9
"""Relative tolerance of a candidate, which `choose` replaces by that for the accuracy."""


def default_scheme(system: Any) -> Method:
    """Return the scheme of a run or a batch for which none is given: the first of `PREFERRED_SCHEMES` with support."""
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
    """Return the schemes from which `choose` selects; the first has own steps, the next two predict costs of others."""
    from coadjoint.methods.taylor import Taylor

    return (
        Taylor(tolerance=ANY_TOLERANCE),
        *(Taylor(p) for p in (16, 8, 20, 12, 24, 14, 10, 6)),
        *(GaussLegendre(s) for s in (8, 6, 12, 10, 4, 3, 2)),
        *(Splitting(order=p) for p in (10, 8, 6, 4, 2)),
        *(Splitting(scheme=f"blanes_casas_murua{p}") for p in (10, 8, 6) if processed),
    )


def suggested_scheme(system: System) -> Method:
    """Return the suggested scheme for a system: the first preferred one, and for matrices one that is a Poisson map."""
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
