"""Results of differentiated runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.short_repr import record_repr

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Tangents:
    """Derivatives of a run along directions of its initial state and its parameters; see `PreparedRun.jvp`.

    Attributes
    ----------
    x : ndarray
        The shape of ``sol.x``, with a trailing axis of directions if these were given with one.
    attitude : ndarray or None
        In the same way for ``sol.attitude``.
    energy : ndarray
        In the same way for ``sol.energy``.
    events : mapping
        In the same way for the crossings of events: "t" for ``sol.events.t``, and "x" for ``sol.events.x``; empty
        without events.
    rule : mapping
        For each parameter, "exact" if the derivative is that of the computed map, "added part" or "differences"; see
        the notes of `PreparedRun.jvp`. Of a batch, the one farthest from the computed map.
    """

    x: Floats
    attitude: Floats | None
    energy: Floats
    events: Mapping[str, Floats] = field(default_factory=dict)
    rule: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return record_repr(self)


class Gradient(Mapping[str, Any]):
    """Derivatives of a number by the initial state and the parameters of a run; see `PreparedRun.vjp`.

    A mapping with the keys "x0", the names of the parameters, with an attitude "attitude0", and with inputs "inputs": a
    mapping from their names to derivatives.

    Attributes
    ----------
    rule : mapping
        As in `Tangents`.
    """

    def __init__(self, values: Mapping[str, Any], rule: Mapping[str, str]) -> None:
        self._values, self.rule = dict(values), dict(rule)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        arrays = {name: value for name, value in self.items() if not isinstance(value, Mapping)}
        for group in (value for value in self.values() if isinstance(value, Mapping)):
            arrays |= group
        return f"<gradient by {', '.join(f'{name} {np.shape(value)}' for name, value in arrays.items())}>"


def overflow(what: str, step: int, time: float, solution: Any, derivatives: Any) -> IntegrationError:
    """Return the error of derivatives that are not finite."""
    return IntegrationError(
        f"the derivative {what}: small changes grow beyond all numbers; take a shorter span",
        step=step,
        time=time,
        residual=float("nan"),
        partial=solution,
        derivatives=derivatives,
    )
