"""What a run has saved: a `Solution` takes its parts from here when they are first asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.runs.observed import Observed
from coadjoint.runs.solution import Statistics

if TYPE_CHECKING:
    from coadjoint.runs.run import Run


class Saved:
    """The first `kept` saved points of a run, without the tables that it was made by.

    Its attributes are those of `Solution`, which says what they are.
    """

    def __init__(self, run: Run, kept: int, observed: Observed | None) -> None:
        self.system, self.method, self.watched = run.system, run.method, run.watching
        self._saved, self._state, self._kept, self._seconds = run.saved, run.state, kept, run.seconds
        self._times, self._start, self._names, self._turned = run.times, run.start, run.loops.names, run.loops.turned
        self.observed: Mapping[str, NDArray[np.float64]] = {}
        if observed is not None:
            series = observed.along(self.t, self._series("x"))
            self.observed = {name: self._picked(values) for name, values in series.items()}

    def _series(self, name: str) -> NDArray[Any]:
        return self._saved[name][: self._kept]

    def _picked(self, series: NDArray[Any]) -> NDArray[Any]:
        """Without the axis of members where there is one alone."""
        return series[:, 0] if self._start.single else series

    @property
    def t(self) -> NDArray[np.float64]:
        """The saved times."""
        return self._times.at(self._times.saved[: self._kept])

    @property
    def x(self) -> NDArray[np.float64]:
        """Momenta."""
        return self._picked(self._series("x"))

    @property
    def energy(self) -> NDArray[np.float64]:
        """The Hamiltonian."""
        return self._picked(self._series("values")[..., 0])

    @property
    def casimirs(self) -> dict[str, NDArray[np.float64]]:
        """Name -> values."""
        values = self._series("values")
        return {name: self._picked(values[..., i + 1]) for i, name in enumerate(self._names[1:])}

    @property
    def attitude(self) -> NDArray[np.float64] | None:
        """Group elements, with what was taken off the Hamiltonian put back."""
        if self._start.representation is None:
            return None
        found = self._turned(self._start, self._times, self._saved, self._kept)
        return found[:, 0] if self._start.single else found

    @property
    def stats(self) -> Statistics:
        """The work done."""
        return Statistics(
            steps=int(self._times.steps),
            evaluations=int(self._state["evaluations"].sum()),
            iterations=int(self._state["iterations"].sum()),
            seconds=self._seconds,
        )

    @property
    def failed(self) -> NDArray[np.bool_] | None:
        """Which members of an ensemble failed."""
        return None if self._start.single else self._state["status"] != 0

    @property
    def t_span(self) -> tuple[float, float]:
        """Start and end."""
        return self._times.t0, self._times.end

    @property
    def step(self) -> float:
        """Its size."""
        return abs(self._times.h)

    @property
    def save_every(self) -> int:
        """As it was given, no more than the steps."""
        return self._times.save_every

    @property
    def carried(self) -> str | None:
        """In which matrices the group element is."""
        return self._start.carried

    @property
    def _worst(self) -> NDArray[np.float64]:
        worst = self._state["worst"]
        return worst[0] if self._start.single else worst
