"""Parts that were chosen: an order, and multiples of Casimirs to take off; what `Splitting.tuned` returns inside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ChosenParts:
    """An explicit choice of parts: those of ``parts="auto"`` after a given shift, in a given order.

    Parameters
    ----------
    order : tuple of int
        Numbers of the parts as they come for the shifted Hamiltonian, first applied first.
    shift : tuple of (str, float)
        Name of a quadratic Casimir C and factor c: the parts add up to H - sum c C, which moves the momentum as H does.

    Raises
    ------
    ValueError
        If `order` is not a permutation.

    Examples
    --------
    >>> ChosenParts((1, 0), (("|x|^2", 0.25),)).order
    (1, 0)
    """

    order: tuple[int, ...]
    shift: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if sorted(self.order) != list(range(len(self.order))):
            raise ValueError(f"the order of parts {self.order} is not a permutation of 0, 1, ...")

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> ChosenParts:
        """Return the choice from its written form, ``{"order": [...], "shift": {...}}``."""
        unknown = sorted(set(given) - {"order", "shift"})
        if unknown or "order" not in given:
            raise ValueError(f"parts has the keys {sorted(given)}; it must have 'order' and may have 'shift'")
        return cls(
            tuple(int(k) for k in given["order"]),
            tuple((str(name), float(factor)) for name, factor in dict(given.get("shift", {})).items()),
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the written form."""
        return {"order": list(self.order), "shift": dict(self.shift)}
