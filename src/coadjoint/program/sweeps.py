"""Sweeps: the passes through the parts of a Hamiltonian that make up a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol


class Sweep(NamedTuple):
    """One pass through the parts over a fraction of the step, forward or backward.

    Parameters
    ----------
    forward : bool
        Whether the parts are applied in their order, or in reverse.
    coefficient : number
        The fraction of the step.
    moment : number
        The moment of the step, as a fraction, at which functions of time are evaluated.
    turn : bool
        Whether the sweep forms a second-order step with the previous one: the part at which they meet flows once over
        both.
    """

    forward: bool
    coefficient: Any
    moment: Any
    turn: bool = False


class Swept(Protocol):
    """Protocol of schemes composed of exact flows of parts."""

    @property
    def parts(self) -> Any:
        """Choice of the parts: "auto", "coordinates", or sets of coordinates."""

    @property
    def rotation(self) -> str:
        """Rotations by the angle itself ("exact"), or by tan(angle/2) := half the angle ("rational")."""

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step, first to last, with coefficients in the given number type."""

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a step P K P^-1, whose `sweeps` are the kernel K."""
