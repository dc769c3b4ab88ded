"""What a table is made from: a step as passes through the parts of a Hamiltonian."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol


class Sweep(NamedTuple):
    """One pass through the parts: forward or backward, over a fraction of the step, functions of time taken at a moment
    of it. A `turn` makes a second-order step with the sweep before: the part at which they meet flows once over both.
    """

    forward: bool
    coefficient: Any
    moment: Any
    turn: bool = False


class Swept(Protocol):
    """A scheme that is made of exact flows of parts."""

    @property
    def parts(self) -> Any:
        """How the Hamiltonian is taken apart: "auto", "coordinates", or sets of coordinates."""

    @property
    def rotation(self) -> str:
        """Rotations by the angle itself ("exact"), or by tan(angle/2) := half the angle ("rational")."""

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step, first to last, with coefficients in the given number type."""

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a step P K P^-1, whose `sweeps` are the kernel K."""
