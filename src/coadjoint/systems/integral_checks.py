"""Validation of integrals: constants of motion besides energy and Casimirs."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, PolynomialHamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.recorded_casimirs import Product, gradient_and_scale, read_invariants
from coadjoint.systems.user_functions import evaluate, sample_points

TIMES = (0.0, 1.0)


@ignore_overflow
def checked_integrals(integrals: Any, H: HamiltonianLike, n: int, product: Product, size: Product) -> dict[str, Any]:
    """Validate integrals by name; check ``grad F(x) . J(x) grad H(x) = 0`` at sample points where grad F is known.

    ``product(x, u)`` is J(x) u, and ``size(x, u)`` the sum of absolute products in each component. The tolerance is u
    times the number of operations times that sum for polynomials.
    """
    result = read_invariants(integrals, n, "integral")
    polynomial = H.polynomial if isinstance(H, PolynomialHamiltonian) else H if isinstance(H, Quadratic) else None
    points = sample_points(n) if any(F.gradient is not None for F in result.values()) else []
    for x in points:
        for t in TIMES if H.timed else TIMES[:1]:
            force = evaluate(lambda y, t=t: H.gradient(y, t), x, False)
            if isinstance(force, Exception) or not np.all(np.isfinite(force)):
                continue
            bound, work = np.abs(force), 2**20
            if polynomial is not None:
                _, bound, work = gradient_and_scale("energy", polynomial, x) or (force, bound, work)
            field, sizes = product(x, force), size(x, bound)
            for name, F in result.items():
                found = None if F.gradient is None else gradient_and_scale(name, F, x, "integral")
                if found is None:
                    continue
                rate = abs(float(found[0] @ field))
                if rate > (work + found[2]) * UNIT_ROUNDOFF * float(found[1] @ sizes):
                    raise ValueError(
                        f"{short(name)} is not an integral: it changes at the rate {rate:.3g} at a sample point, and "
                        "its bracket with the Hamiltonian must vanish everywhere"
                    )
    return result
