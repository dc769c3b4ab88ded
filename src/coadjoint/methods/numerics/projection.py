"""Projection to the level set of invariants in NumPy, for any number type: y = z + G(z)^T lambda with C(y) = C(x)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import IntegrationError
from coadjoint.kernels.interface import limit
from coadjoint.methods.numerics.solvers import linear_solve, most_rounds
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian
from coadjoint.systems.system import System


def polynomial_casimirs(system: System) -> dict[str, Any]:
    """Return the Casimirs of a system that are polynomials, which a projection restores."""
    return {name: C for name, C in system.casimirs.items() if isinstance(C, Polynomial | Quadratic)}


def casimirs_restored(system: System) -> str:
    """Return which Casimirs a projection preserves, as the value of `Properties.casimirs`."""
    count = len(polynomial_casimirs(system))
    if not count:
        return "none"
    return "all" if count == len(system.casimirs) else "polynomial"


def restored_invariants(system: System) -> list[HamiltonianLike]:
    """Return the restored invariants, the energy last."""
    casimirs = [as_hamiltonian(C, system.dim) for C in polynomial_casimirs(system).values()]
    return [*reversed(casimirs), system.hamiltonian]


def project_with_tangent(
    system: System, x: NDArray[Any], z: NDArray[Any], dz: NDArray[Any], time: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the projected state y and dy/dx, for a state z with dz/dx and the invariants at x."""
    # From y = z + G(z)^T lambda: dy = (1 + sum lambda_a C_a''(z)) dz + G(z)^T dlambda and G(y) dy = G(x) dx.
    invariants = restored_invariants(system)
    y, multipliers = project(invariants, x, z, float, time)
    used = [invariants[number] for number in multipliers]
    corrected = dz + sum(
        multiplier * (C.hessian(z) @ dz) for C, multiplier in zip(used, multipliers.values(), strict=True)
    )
    before, directions, after = (np.array([array_of(float, C.gradient(point)) for C in used]) for point in (x, z, y))
    multiplier_changes = linear_solve(after @ directions.T, before - after @ corrected)
    return y, corrected + directions.T @ multiplier_changes


def project(
    invariants: Sequence[HamiltonianLike], x: NDArray[Any], z: NDArray[Any], number: Number, time: float
) -> tuple[NDArray[Any], dict[int, Any]]:
    """Return y = z + G(z)^T lambda, where the invariants have their values at x, and lambda by their numbers."""
    # `time` is for messages.
    # Linearly dependent gradients add no direction: restoring the other invariants restores these too.
    exact, stagnant = limit("PROJECTION_EXACT"), limit("PROJECTION_STAGNANT")
    unit = roundoff(number)
    if unit == 0:
        raise TypeError("a projection iterates, which does not terminate in exact fractions; take projected=False")
    targets = [C.value(x) for C in invariants]
    sizes = [max(_terms_of(C, y) for y in (x, z)) for C in invariants]
    # Constant gradients are fractions, from which mpmath before 1.4 cannot subtract.
    gradients = np.array([array_of(number, C.gradient(z)) for C in invariants])
    free = independent(gradients)
    directions = gradients[free]
    multipliers = directions @ z * 0
    y, residual = z, number("inf")
    for _ in range(most_rounds(limit("PROJECTION_CORRECTIONS"), unit) + 1):
        before = residual
        defects = np.array([target - C.value(y) for target, C in zip(targets, invariants, strict=True)])
        residual = max(abs(defects))
        allowed = exact * (stagnant if residual >= 0.5 * before else 1)
        if all(abs(d) <= allowed * unit * size for d, size in zip(defects, sizes, strict=True)):
            return y, dict(zip(free, multipliers, strict=True))
        if not residual - residual == 0:
            break
        change = linear_solve(directions @ directions.T, defects[free][:, None])[:, 0]
        multipliers = multipliers + change
        y = z + directions.T @ multipliers
    raise IntegrationError(
        f"the projection of a step does not converge (defect {float(residual):.3g}); take a smaller step",
        step=1,
        time=time,
        residual=float(residual),
    )


def _terms_of(C: HamiltonianLike, y: NDArray[Any]) -> Any:
    """Return the sum of the magnitudes of the terms of y . dC/dy, without cancellation within a derivative."""
    if not isinstance(C, PolynomialHamiltonian):
        return sum(abs(y * C.gradient(y)))
    monomials = C.polynomial.monomials
    terms = Polynomial({powers: abs(float(value)) for powers, value in monomials.items()}, C.polynomial.dim)
    return sum(abs(y) * terms.gradient(abs(y)))


def independent(gradients: NDArray[Any]) -> list[int]:
    """Return the rows of gradients (k, n) that are, up to rounding, linearly independent of the previous rows."""
    least = 2.0 ** -limit("DEPENDENT_BITS")
    selected: list[int] = []
    for row, gradient in enumerate(gradients):
        remainder = gradient
        if selected:
            basis = gradients[selected]
            remainder = gradient - linear_solve(basis @ basis.T, (basis @ gradient)[:, None])[:, 0] @ basis
        if remainder @ remainder > least * (gradient @ gradient):
            selected.append(row)
    return selected
