"""Taylor series of a motion with its derivative, of quadratic Hamiltonians, by products of matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import note_progress
from coadjoint.systems.lie_poisson import LiePoissonSystem


def expand_quadratic(
    system: LiePoissonSystem, x: NDArray[np.float64], h: float, order: int
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Return the terms of `expand` for a quadratic Hamiltonian, and their derivatives by x, by products of matrices.

    The field is L x + Q(x) x / 2 with symmetric Q(x) y, so its derivative at x is L + Q(x).
    """
    linear = system.jacobian(np.zeros(len(x)))
    terms, derivatives, quadratic = [x], [np.eye(len(x))], list[NDArray[np.float64]]()
    for k in range(order):
        note_progress(f"the power {k + 1} of {order} of a series", (k / order) ** 2)
        quadratic.append(system.jacobian(terms[k]) - linear)
        slope, changes = linear @ terms[k], linear @ derivatives[k]
        for Q, y, D in zip(quadratic, reversed(terms), reversed(derivatives), strict=True):
            slope += Q @ y / 2
            changes += Q @ D
        terms.append(slope * h / (k + 1))
        derivatives.append(changes * h / (k + 1))
    return terms[1:], derivatives[1:]
