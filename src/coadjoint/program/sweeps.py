"""Sweeps: the passes through the parts of a Hamiltonian that make up a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol


class Sweep(NamedTuple):
    """One pass through the parts over a fraction `coefficient` of the step, forward or backward.

    Functions of time are evaluated at `moment`, a fraction of the step. A `turn` makes a second-order step with the
    previous sweep: the part at which they meet flows once over both.
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
