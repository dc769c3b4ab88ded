"""Capability of schemes that choose their own steps: runs with a smaller error, and with a given tolerance."""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple

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
