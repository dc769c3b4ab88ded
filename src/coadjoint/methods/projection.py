"""Back to the level set of invariants, read in NumPy for any number type: y = z + G(z)^T lambda with C(y) = C(x)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.stages import linear_solve
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.systems.hamiltonian import HamiltonianLike


class Projected(NamedTuple):
    """A projected state, and how it was reached: y = z + directions^T multipliers, for the invariants that it took."""

    y: NDArray[Any]
    invariants: list[HamiltonianLike]
    directions: NDArray[Any]
    multipliers: NDArray[Any]


def project(
    invariants: Sequence[HamiltonianLike], x: NDArray[Any], z: NDArray[Any], number: Number, time: float
) -> Projected:
    """Return y = z + G(z)^T lambda, where the invariants have the values that they have at x.

    Parameters
    ----------
    invariants : sequence of Hamiltonians
        An invariant whose gradient depends on those before it adds no direction: restoring the others restores it.
    x, z : (n,) arrays
        The state whose invariants are taken, and the state that is moved.
    number : callable
        Number type of the states; not fractions.
    time : float
        Time of the step, for the message of a failure.

    Returns
    -------
    Projected

    Raises
    ------
    TypeError
        The numbers are fractions.
    IntegrationError
        Newton's iteration, with the Gram matrix of the gradients at z, does not converge.
    """
    from coadjoint.kernels.description import limit

    exact, stagnant = limit("PROJECTION_EXACT"), limit("PROJECTION_STAGNANT")
    unit = roundoff(number)
    if unit == 0:
        raise TypeError("a projection solves equations that exact fractions do not settle: take projected=False")
    wanted = [C.value(x) for C in invariants]
    sizes = [sum(abs(x * C.gradient(x))) for C in invariants]
    # Constant slopes are fractions, which mpmath before 1.4 does not subtract from.
    gradients = np.array([array_of(number, C.gradient(z)) for C in invariants])
    free = independent(gradients)
    directions = gradients[free]
    multipliers = directions @ z * 0
    y, residual = z, float("inf")
    for _ in range(limit("PROJECTION_CORRECTIONS") + 1):
        before = residual
        defects = np.array([w - C.value(y) for w, C in zip(wanted, invariants, strict=True)])
        residual = float(max(abs(defects)))
        allowed = exact * (stagnant if residual >= 0.5 * before else 1)
        if all(abs(d) <= allowed * unit * size for d, size in zip(defects, sizes, strict=True)):
            return Projected(y, [invariants[a] for a in free], directions, multipliers)
        if not residual - residual == 0:
            break
        change = linear_solve(directions @ directions.T, defects[free][:, None])[:, 0]
        multipliers = multipliers + change
        y = z + directions.T @ multipliers
    raise IntegrationError(
        f"the projection of a step does not converge (defect {residual:.3g}); take a smaller step",
        step=1,
        time=time,
        residual=residual,
    )


def independent(gradients: NDArray[Any]) -> list[int]:
    """Return the rows that are not, up to rounding, combinations of those before them.

    Parameters
    ----------
    gradients : (k, n) array
        The gradients, in any number type.

    Returns
    -------
    list of int

    Examples
    --------
    >>> independent(np.array([[1.0, 0.0], [2.0, 0.0], [1.0, 1.0]]))
    [0, 2]
    """
    from coadjoint.kernels.description import limit

    least = 2.0 ** -limit("DEPENDENT_BITS")
    found: list[int] = []
    for row, gradient in enumerate(gradients):
        rest = gradient
        if found:
            others = gradients[found]
            rest = gradient - linear_solve(others @ others.T, (others @ gradient)[:, None])[:, 0] @ others
        if rest @ rest > least * (gradient @ gradient):
            found.append(row)
    return found
