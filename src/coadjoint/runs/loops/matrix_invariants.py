"""Invariants of matrices, which the loops do not track: they are computed at the saved points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import NamedArrays
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.systems.matrices.matrix_system import MatrixSystem

Floats = NDArray[np.float64]


class MatrixInvariants:
    """The energy and the invariants of a system of matrices, and with `accounts` the same minus the work of forces."""

    def __init__(self, system: MatrixSystem, names: Sequence[str], accounts: Sequence[tuple[str, str]]) -> None:
        self._system, self._names, self._accounts = system, names, accounts

    def measure(
        self, times: Times, start: Start, saved: NamedArrays, worst: NDArray[Any], points: NDArray[np.int64]
    ) -> None:
        """Compute the values at the new saved `points`, in place.

        `worst`, (members, tenths, invariants), holds the largest deviations in each tenth of the run.
        """
        if not len(points):
            return
        first = self._values(start.momenta, times.t0)
        for k in points.tolist():
            number = int(times.saved[k])
            values = saved["values"][k] = self._values(saved["x"][k], float(times.at(times.saved[k])))
            tenth = max(0, number - 1) * worst.shape[1] // max(1, times.steps)
            with np.errstate(invalid="ignore"):  # members may be about to overflow
                worst[:, tenth] = np.fmax(worst[:, tenth], np.abs(values - first))

    def at(self, states: Floats, t: Floats) -> Floats:
        """Return the values of states (m, size) at times (m,)."""
        return np.concatenate([self._values(x[None], time) for x, time in zip(states, t.tolist(), strict=True)])

    def _values(self, states: Floats, t: float) -> Floats:
        system = self._system
        # States after a failure are NaN; user functions are not called on them.
        finite = np.isfinite(states[:, : system.dim]).all(axis=-1)
        result = np.full((len(states), len(self._names) * (2 if self._accounts else 1)), np.nan)
        W = system.from_vector(states[finite, : system.dim])
        with np.errstate(all="ignore"):
            values = [system.energy(W, t), *system.casimirs_at(W).values()]
        if self._accounts:
            # Minus the work of the forces, from the accounts of a state; the start has none.
            work = {name: np.zeros(len(W)) for name in self._names}
            for (_, name), column in zip(self._accounts, states[finite, system.dim :].T, strict=False):
                work[name] += column
            values += [value - work[name] for value, name in zip(values, self._names, strict=True)]
        result[finite] = np.stack(values, axis=-1)
        return result
