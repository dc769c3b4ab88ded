"""Explicit choice of parts: an order, and multiples of Casimirs to subtract, as made by `Splitting.tuned`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coadjoint.short_repr import short
from coadjoint.validation import read_integer, read_list, read_number


@dataclass(frozen=True)
class ChosenParts:
    """Explicit choice of parts: those of ``parts="auto"`` after a given shift, in a given order.

    `order` numbers the parts of the shifted Hamiltonian, first applied first, and must be a permutation. `shift` has
    pairs of a quadratic Casimir's name and a factor c; the parts add up to H - sum c C, which generates the same
    motion. `linear` lists coordinates whose linear coefficients count as present even if zero, so that systems that
    differ only in these coefficients have the same parts.
    """

    order: tuple[int, ...]
    shift: tuple[tuple[str, float], ...] = ()
    linear: tuple[int, ...] = ()

    def __repr__(self) -> str:
        more = f", linear={self.linear}" if self.linear else ""
        return f"ChosenParts(order={self.order}, shift={self.shift}{more})"

    def __post_init__(self) -> None:
        order = [
            read_integer(k, "a part", 0) for k in read_list(self.order, "the order of parts", "give numbers of parts")
        ]
        if sorted(order) != list(range(len(order))):
            raise ValueError(f"the order of parts {short(order)} is not a permutation of 0, 1, ...")
        object.__setattr__(self, "order", tuple(order))
        rule = "give pairs of the name of a Casimir and a factor"
        pairs = [read_list(pair, "a shift", rule) for pair in read_list(self.shift, "the shift", rule)]
        if any(len(pair) != 2 or not isinstance(pair[0], str) for pair in pairs):
            raise TypeError(f"the shift is {short(self.shift)}; {rule}")
        shift = tuple((name, read_number(factor, f"the factor of {short(name)}")) for name, factor in pairs)
        object.__setattr__(self, "shift", shift)
        linear = read_list(self.linear, "the linear coefficients that are present", "give coordinates")
        object.__setattr__(self, "linear", tuple(read_integer(k, "a coordinate", 0) for k in linear))

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> ChosenParts:
        """Construct a choice from ``{"order": [...], "shift": {...}, "linear": [...]}``."""
        unknown = set(mapping) - {"order", "shift", "linear"}
        if unknown or "order" not in mapping:
            raise ValueError(
                f"parts has the keys {short(list(mapping))}; it must have 'order' and may have 'shift' and 'linear'"
            )
        shift = mapping.get("shift", {})
        if not isinstance(shift, Mapping):
            raise TypeError(f"the shift is {short(shift)}; give a mapping from the name of a Casimir to a factor")
        return cls(mapping["order"], tuple(shift.items()), mapping.get("linear", ()))

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping accepted by `from_mapping`."""
        present = {"linear": list(self.linear)} if self.linear else {}
        return {"order": list(self.order), "shift": dict(self.shift), **present}
