"""Capability of schemes with steps that restore the energy, and mostly other invariants."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from coadjoint.methods.protocol.method import Method
from coadjoint.systems.system_checks import System


class RestoresInvariants(Method):
    """A scheme with steps that may restore invariants."""

    @abstractmethod
    def restored(self, system: System) -> Mapping[str, Any] | None:
        """Return the invariants that a step restores, as the function `restored`."""


def restored(method: Method, system: System) -> Mapping[str, Any] | None:
    """Return the invariants that a step restores besides the energy; None if it does not restore the energy either.

    The mapping is from names to `Polynomial` or `Quadratic`.
    """
    form = method.expanded
    return form.restored(system) if isinstance(form, RestoresInvariants) else None
