"""The loop over steps for Runge-Kutta methods: explicit, iterated, implicit, and linear in the last iterate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.field import Field, GroupField


class RungeKuttaTables(NamedTuple):
    """The arrays of a Runge-Kutta method on a system.

    The stages are X_i = x + sum_j mix_ij L_j with L_j = h scale_j f(X_j, t + node_j h), and the step adds sum_j out_j
    L_j. `iterations` counts the function iterations before the end of `solver`, or its linear system. `direct` says
    that linear systems are solved by LU factors, with `quadratic` the dense M where that is needed; else they are
    iterated. Where iterating fails, and where it does for an implicit step, large systems are solved by the factors of
    a banded matrix: coordinates that are coupled stand at most `band` apart in the order `position`; or it is -1, and
    they are solved without a matrix. One step is made of substeps of the lengths `fraction`, at the moments `moment`,
    in units of the step. An implicit step starts at x + sum_j forecast_ij L_j, with the slopes L of the substep before
    and one such matrix for each substep.
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
"""The name of the loop."""
