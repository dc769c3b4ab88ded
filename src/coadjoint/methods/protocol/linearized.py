"""Capability for the derivative of a step as a linear map, forward and transposed, without its matrix."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.systems.system_checks import System

Floats = NDArray[np.float64]


class LinearizedStep(Protocol):
    """A step and its derivative at a state: `end` is the state (n,) after it."""

    @property
    def end(self) -> Floats:
        """State after the step."""

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step for those before it."""

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step for that after it."""


class Linearized(Method):
    """A scheme whose derivative is applied to tangents and cotangents without its matrix."""

    @abstractmethod
    def linearized(self, system: System, x: Floats, t: float, h: float) -> LinearizedStep:
        """Return a step from a state given as a vector, with its derivative."""


class DenseStep(NamedTuple):
    """A step with the matrix (n, n) of its derivative."""

    end: Floats
    matrix: Floats

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step."""
        return np.asarray((self.matrix @ rows.T).T)

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step."""
        return np.asarray(row @ self.matrix)


class JoinedSteps(NamedTuple):
    """Several steps, one after the other."""

    steps: Sequence[LinearizedStep]

    @property
    def end(self) -> Floats:
        """State after the last step."""
        return self.steps[-1].end

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step."""
        for step in self.steps:
            rows = step.tangents(rows)
        return rows

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step."""
        for step in reversed(self.steps):
            row = step.cotangent(row)
        return row


def linearized(method: Method, system: System, x: Floats, t: float, h: float) -> LinearizedStep:
    """Return a step with its derivative; of schemes without this capability by `Method.tangent`."""
    form = method.expanded
    if isinstance(form, Linearized):
        return form.linearized(system, x, t, h)
    end, matrix = form.tangent(system, x, t, h)
    return DenseStep(np.asarray(end), np.asarray(matrix))
