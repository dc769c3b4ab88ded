"""Reference motions that are integrated: one system run at two orders, evaluated at any times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.check_case import Columns
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.integrate import integrate

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class IntegratedMotion:
    """A run of a system from x0 by the first of two schemes; `columns` converts states (k, n) at times (k,).

    Times of the system, its step too, are in units of `time_unit` seconds.
    """

    system: Any
    x0: Floats
    step: float
    methods: tuple[Method, Method]
    columns: Callable[[Floats, Floats], Columns]
    time_unit: float = 1.0

    def states(self, times: Floats, method: Method) -> Floats:
        """Return the states at times in any order, (k, n)."""
        order = np.argsort(times, kind="stable")
        steps = max(1, math.ceil(times.max() / self.step - 1e-9))
        sorted_times = np.clip(times[order], 0.0, steps * self.step)
        run = integrate(
            self.system,
            self.x0,
            (0.0, steps * self.step),
            self.step,
            method,
            t_eval=sorted_times,
            watch=False,
        )
        states = np.empty((len(times), len(self.x0)))
        states[order] = run.x
        return states

    def __call__(self, times: Floats) -> Columns:
        t = times / self.time_unit
        return self.columns(self.states(t, self.methods[0]), t)

    def spread(self, times: Floats) -> float:
        """Return the largest difference of the states by both schemes, relative to the largest of each coordinate."""
        first, second = (self.states(times / self.time_unit, method) for method in self.methods)
        sizes = np.abs(first).max(axis=0)
        return float((np.abs(first - second).max(axis=0) / np.where(sizes > 0.0, sizes, 1.0)).max())
