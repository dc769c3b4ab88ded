"""Use of Newton's method in a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.composed import Substeps
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod


def took_newton(method: Method, memory: NDArray[np.float64]) -> bool:
    """Return whether an implicit step of any member starts with Newton's method: the first number of its memory.

    `memory` (members, numbers) is that of a run; only Runge-Kutta methods and their substeps use it so.
    """
    form = method.expanded
    stages = form.base if isinstance(form, Substeps) else form
    return isinstance(stages, RungeKuttaMethod) and bool(np.any(memory[:, :1] > 0.0))
