"""Result of one self-test check: measurement and bound."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Result of one check: the property, its value and bound, and the scheme and system nearest to failing.

    `least`: the bound is a lower one, as for an order. `skipped`: the reason why the check was skipped, or empty.

    Examples
    --------
    >>> print(Finding("order of Splitting(order=4)", 3.96, 3.5, "su(3)", least=True))
    ok    order of Splitting(order=4)                        3.96   at least     3.5  su(3)
    >>> Finding("Casimirs", float("nan"), 1e-13).passed
    False
    """

    what: str
    measured: float = math.nan
    allowed: float = math.nan
    where: str = ""
    least: bool = False
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """Whether the measurement satisfies its bound; skipped checks pass."""
        if self.skipped:
            return True
        return self.measured >= self.allowed if self.least else self.measured <= self.allowed

    def __str__(self) -> str:
        if self.skipped:
            return f"skip  {self.what:42}  {self.skipped}"
        verdict, bound = "ok" if self.passed else "FAIL", "at least" if self.least else "at most"
        numbers = f"{self.measured:9.3g}   {bound:8}  {self.allowed:7.2g}"
        return f"{verdict:4}  {self.what:42}  {numbers}  {self.where}".rstrip()
