"""Base class of schemes around another scheme, and what callers do with the base of any of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.tangents import VariedTangents, tangent_by
from coadjoint.systems.system_checks import System


class Wrapper(VariedTangents):
    """A scheme with the attributes of its base, except for those that it overrides."""

    base: Method

    @property
    def order(self) -> int:
        """That of the base."""
        return self.base.order

    @property
    def explicit(self) -> bool:
        """As for the base."""
        return self.base.explicit

    @property
    def symmetric(self) -> bool:
        """As for the base."""
        return self.base.symmetric

    @property
    def compensates(self) -> bool:  # type: ignore[override]
        """As for the base."""
        return self.base.compensates

    @property
    def failures(self) -> Mapping[str, str]:  # type: ignore[override]
        """Those of the base."""
        return self.base.failures

    @property
    def largest(self) -> float:  # type: ignore[override]
        """As for the base."""
        return self.base.largest

    def tangent_by(self, system: System, x: Any, t: float, h: float) -> str:
        """Return the way of the base."""
        return tangent_by(self.base, system, x, t, h)
