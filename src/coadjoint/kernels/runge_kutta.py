"""Tables of the loop for Runge-Kutta methods: explicit, iterated, implicit, and linear in the last iterate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.field import Field, GroupField


class RungeKuttaTables(NamedTuple):
    """The arrays of a Runge-Kutta method on a system.

    The stages are X_i = x + sum_j mix_ij L_j with L_j = h scale_j f(X_j, t + node_j h), and the step adds sum_j out_j
    L_j. `iterations` is the number of function iterations before the output, or before the linear system. If `direct`,
    linear systems are solved by LU factors, with `quadratic` the dense M if needed; otherwise by iteration. If the
    iteration fails, and for implicit steps, large systems are solved by a banded factorization in the order `position`,
    in which coupled coordinates are at most `band` apart; if `band` is -1, they are solved without a matrix. A step
    consists of substeps of the lengths `fraction`, at the moments `moment`, in units of the step. The initial guess of
    an implicit substep is x + sum_j forecast_ij L_j, with the slopes L of the previous substep, and one such matrix per
    substep.
    """

    field: Field
    group: GroupField
    stages: int
    substeps: int
    solver: int
    iterations: int
    direct: bool
    node: NDArray[np.float64]
    scale: NDArray[np.float64]
    mix: NDArray[np.float64]
    out: NDArray[np.float64]
    forecast: NDArray[np.float64]
    quadratic: NDArray[np.float64]
    band: int
    position: NDArray[np.uint32]
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]


RUNGE_KUTTA_LOOP = "runge_kutta_advance"
"""Name of the loop in the library."""
