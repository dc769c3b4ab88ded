"""Capability of schemes that choose their own steps: runs with a smaller error, and with a given tolerance."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.systems.system_checks import System

SIZE_SAMPLES = 240  # samples of the size of a motion, at output points that do not affect the steps


class FinerRun(NamedTuple):
    """A more accurate scheme and number of steps, and the remaining fraction of the original error."""

    method: Method
    steps: int
    left: float


class OwnSteps(Method):
    """A scheme that can choose its own steps; it does so if `own_steps` is true."""

    @abstractmethod
    def finer(self, steps: int, times: float) -> FinerRun:
        """Return a run with own steps that are shorter by a factor; `steps` is the number of output points."""

    @property
    def fixed_steps(self) -> Method | None:
        """The scheme of these steps, with lengths that are given; None if it is not known."""
        return None

    def next_length(self, system: System, x: NDArray[np.float64], h: float, memory: Any) -> tuple[float, Any]:
        """Return the length of the next step, with the sign of h, and what the choice of the one after it needs.

        `memory` is that of the step before, None at the start. For schemes with `fixed_steps`.
        """
        raise NotImplementedError

    def reaching(self, system: System, tolerance: float) -> Method:
        """Return the same scheme with another tolerance, and the order of least work for it."""
        raise _no_tolerance_error(self)


def reaching(method: Method, system: System, tolerance: float) -> Method:
    """Return a scheme with this error of a step, relative to the largest momentum so far; TypeError if it has none."""
    if not isinstance(method, OwnSteps):
        raise _no_tolerance_error(method)
    return method.reaching(system, tolerance)


def _no_tolerance_error(method: Method) -> TypeError:
    return TypeError(f"{method} has no tolerance that could be chosen for an accuracy; give step= in its place")


def fixed_steps(method: Method) -> Method:
    """Return the scheme itself, or that of the steps that it chooses; TypeError if this is not known."""
    if not method.own_steps:
        return method
    found = method.fixed_steps if isinstance(method, OwnSteps) else None
    if found is None:
        raise TypeError(
            f"{method} chooses its own steps, and its runs have no derivatives; define fixed_steps and next_length"
        )
    return found
