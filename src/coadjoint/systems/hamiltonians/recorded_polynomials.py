"""Polynomials among the recorded operations of a function."""

from __future__ import annotations

from typing import Any

from coadjoint.algebra.exact.numbers import is_finite, quotient
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE
from coadjoint.systems.hamiltonians.traced_function import Traced, TracedFunction

MAX_MONOMIALS = 1000
"""Of a polynomial that is multiplied out."""

Monomials = dict[tuple[int, ...], Any]
"""The coordinates of each monomial, with multiplicity, to its coefficient."""


class RecordedPolynomials:
    """The monomials of the recorded operations that are polynomials of the coordinates."""

    def __init__(self, recorded: TracedFunction) -> None:
        self._nodes, self._n = recorded.graph.nodes, len(recorded.variables)
        self._expanded: dict[int, Monomials | None] = {}

    def monomials(self, node: Traced) -> Monomials | None:
        """Return the monomials of a node, or None if it is no polynomial of the coordinates, or a large one."""
        # Earlier nodes come first, so that there is no recursion.
        needed, pending = set[int](), [node.index]
        while pending:
            index = pending.pop()
            if index not in needed and index not in self._expanded:
                needed.add(index)
                pending += [a.index for a in self._nodes[index][1] if isinstance(a, Traced)]
        for index in sorted(needed):
            found = self._expand(index)
            usable = found is not None and len(found) <= MAX_MONOMIALS and all(map(is_finite, found.values()))
            self._expanded[index] = found if usable else None
        return self._expanded[node.index]

    def _expand(self, index: int) -> Monomials | None:
        operation, arguments = self._nodes[index]
        if operation == "variable":
            return {(index,): 1} if index < self._n else None
        if operation not in ("add", "sub", "neg", "mul", "div", "pow"):
            return None
        parts: list[Monomials | None] = [
            self._expanded[a.index] if isinstance(a, Traced) else {(): a} for a in arguments
        ]
        if any(part is None for part in parts):
            return None
        first, *others = [part for part in parts if part is not None]
        if operation == "neg":
            return {key: -value for key, value in first.items()}
        (second,) = others
        if operation in ("add", "sub"):
            total = dict(first)
            for key, value in second.items():
                total[key] = total.get(key, 0) + (value if operation == "add" else -value)
            return total
        if operation == "mul":
            return _product(first, second)
        if isinstance(arguments[1], Traced):
            return None
        number = arguments[1]
        if operation == "div":
            return {key: quotient(value, number) for key, value in first.items()} if number != 0 else None
        degree = max(map(len, first), default=0)
        if number != int(number) or not 0 <= number or degree * number > MAX_DEGREE:
            return None
        power: Monomials | None = {(): 1}
        for _ in range(int(number)):
            power = None if power is None else _product(power, first)
        return power


def _product(left: Monomials, right: Monomials) -> Monomials | None:
    if len(left) * len(right) > 16 * MAX_MONOMIALS:
        return None
    total: Monomials = {}
    for first, a in left.items():
        for second, b in right.items():
            key = tuple(sorted(first + second))
            total[key] = total.get(key, 0) + a * b
    return total if len(total) <= MAX_MONOMIALS and max(map(len, total), default=0) <= MAX_DEGREE else None
