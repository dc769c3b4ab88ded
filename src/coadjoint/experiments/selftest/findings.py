"""Result of one self-test check: measurement and bound."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Result of one check, with its value, its bound (a lower one if `least`), and the subject nearest to failing."""

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
