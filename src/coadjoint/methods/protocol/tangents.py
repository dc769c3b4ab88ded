"""Capabilities for derivatives of steps: compiled loops with tangent vectors, and derivatives of different kinds."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.step_derivatives import derivative_of
from coadjoint.systems.system_checks import System

if TYPE_CHECKING:
    from coadjoint.kernels.loop import CompiledLoop
    from coadjoint.kernels.tables.tangents import Frame


class CompiledTangents(Method):
    """A scheme with a loop that carries tangent vectors with the state."""

    @abstractmethod
    def tangent_loop(self, system: System, h: float, frame: Frame) -> CompiledLoop | None:
        """Return this loop, as the function `tangent_loop`."""


def tangent_loop(method: Method, system: System, h: float, frame: Frame) -> CompiledLoop | None:
    """Return the loop that carries tangent vectors with the state, whose bits do not depend on them.

    None if there is no such loop: `Method.tangent` is then called for every step. Raises ValueError or TypeError if the
    scheme cannot be used for the system, or a derivative is not known.
    """
    form = method.expanded
    return form.tangent_loop(system, h, frame) if isinstance(form, CompiledTangents) else None


class VariedTangents(Method):
    """A scheme with a derivative that is computed in different ways, which depend on the system or on a base."""

    @abstractmethod
    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        """Return the way for this system, as the function `tangent_by`."""


def tangent_by(method: Method, system: System, x: Any, t: float, h: float) -> str:
    """Return how `Method.tangent` computes the derivative: by "formula", "complex step" or "differences".

    The first two are exact to round-off; differences have about nine digits.
    """
    if type(method).tangent is Method.tangent:
        return derivative_of(lambda y: method.step(system, y, t, h), np.asarray(x, dtype=np.float64)).by
    return method.tangent_by(system, x, t, h) if isinstance(method, VariedTangents) else "formula"
