"""One constructor in the tables of domains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from domains.kinds import Domain


@dataclass(frozen=True)
class Case:
    """A constructor with the domain of each parameter.

    `then` is applied to what it makes, where a value can be checked only on a system, before the first step; `usual`
    are values of the other parameters that differ from the first ones inside.
    """

    make: Callable[..., Any]
    domains: Mapping[str, Domain]
    then: Callable[[Any], Any] | None = None
    usual: Mapping[str, Any] | None = None

    def arguments(self) -> dict[str, Any]:
        return {name: domain.inside[0] for name, domain in self.domains.items()} | dict(self.usual or {})

    def __call__(self, **given: Any) -> Any:
        made = self.make(**given)
        return made if self.then is None else self.then(made)
