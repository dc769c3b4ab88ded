"""Partial steps: states between two steps by a shorter step of the same scheme, for many states at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.kernels.arrays import Extent, Layout, NamedArrays
from coadjoint.kernels.blas_threads import limited_blas_threads
from coadjoint.kernels.interface import codes
from coadjoint.kernels.tables.recording import partial_step_schedule
from coadjoint.kernels.tables.structures import as_structure
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.execution import failure_text, run_in_threads, status_name
from coadjoint.runs.loops.groups import rows_of_groups
from coadjoint.runs.loops.loops import Loops

Floats = NDArray[np.float64]

MAX_NUMBERS = 2**20
"""Array entries processed at a time."""
SINGLE_THREAD_ROWS = 256
"""Up to this many rows one thread is faster than starting others."""


def noises_of(system: Any) -> list[str]:
    """Return the labels of the forces that are noise."""
    return [label for label, force in system.labelled_forces if force.random]


def reject_noise(system: Any) -> None:
    """Reject a system with noise: its increment over a partial step is not determined by that of the whole step."""
    noises = noises_of(system)
    if noises:
        raise ValueError(
            f"{noises[0]} of {system.of_member(0).name} is a noise, drawn once for a step: there is no state between "
            "two steps; give times that are whole numbers of steps from the start"
        )


class StepResult(NamedTuple):
    """Momenta, elements and invariants after one step of each row; NaN in failed rows, whose `status` is not zero."""

    momenta: Floats
    groups: Floats
    values: Floats
    before: Floats
    status: NDArray[np.int64]
    residual: Floats


class PartialSteps:
    """Steps of any lengths by the scheme of a run, without history; the bits of a row depend on that row only."""

    def __init__(self, system: Any, method: Method, loops: Loops, workers: int = 1) -> None:
        from coadjoint.kernels.tables.invariants import invariants_table

        reject_noise(system)
        self.method, self.loops, self.workers = method, loops, workers
        self._no_values = as_structure(invariants_table([], system.dim).tables)

    def take(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64] | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the momenta and elements after one step of each row (of member `owners`), as stored in the loops."""
        result = self.attempt(momenta, groups, times, lengths, owners)
        failed = np.flatnonzero(result.status)
        if len(failed):
            row = int(failed[0])
            owner = row if owners is None else int(owners[row])
            raise self._failure(result, row, owner, float(times[row]), float(lengths[row]))
        return result[:2]

    def attempt(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64] | None = None,
        watched: bool = False,
    ) -> StepResult:
        """Like `take`, but return failures instead of raising, and the tracked invariants if `watched`."""
        tracked, m = self.loops.tracked if watched else 0, len(momenta)
        x, group, after, before = (
            np.full((m, width), np.nan) for width in (momenta.shape[1], groups.shape[1], tracked, tracked)
        )
        result = StepResult(x, group, after, before, np.zeros(m, dtype=np.int64), np.zeros(m))
        owners = np.arange(len(momenta)) if owners is None else owners
        finite = np.flatnonzero(np.isfinite(momenta).all(axis=1))
        numbers = 4 * momenta.shape[1] + 4 * groups.shape[1] + self.loops.memory + 16 * tracked + 8
        chunk = max(1, MAX_NUMBERS // numbers)
        workers = self.workers if len(finite) > SINGLE_THREAD_ROWS else 1
        for first in range(0, len(finite), chunk):
            chunk_rows = finite[first : first + chunk]
            arguments = (
                momenta[chunk_rows],
                groups[chunk_rows],
                times[chunk_rows],
                lengths[chunk_rows],
                owners[chunk_rows],
            )
            for target, values in zip(result, self._take(*arguments, watched, workers), strict=True):
                target[chunk_rows] = values
        return result

    def _take(
        self,
        momenta: Floats,
        groups: Floats,
        times: Floats,
        lengths: Floats,
        owners: NDArray[np.int64],
        watched: bool,
        workers: int,
    ) -> list[NDArray[Any]]:
        loops = self.loops
        groups_of_loops = loops.groups if watched else [group._replace(watch=self._no_values) for group in loops.groups]
        rows, filled, member_batches = rows_of_groups(groups_of_loops, owners, workers, loops.block)
        count = loops.tracked if watched else 0
        layout = Layout(Extent(len(rows), 1, momenta.shape[1], groups.shape[1], count, loops.memory))
        saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
        state["momenta"][:], state["groups"][:] = momenta[rows], groups[rows]
        starts, steps = times[rows].astype(np.float64), np.where(filled, lengths[rows], 0.0)
        schedule = partial_step_schedule(starts, steps)
        with limited_blas_threads(loops.rows, workers):
            run_in_threads(member_batches, (layout, schedule, saved, state, 0, 1), loops, workers)
        slots = np.empty(len(momenta), dtype=np.int64)
        slots[rows[filled]] = np.flatnonzero(filled)
        arrays = (saved["x"][0], saved["group"][0], saved["values"][0], state["first"])
        status = state["status"][slots]
        ends = [np.where(status[:, None] == codes("Status")["DONE"], array[slots], np.nan) for array in arrays]
        return [*ends, status, state["residual"][slots]]

    def _failure(self, result: StepResult, row: int, owner: int, start: float, length: float) -> IntegrationError:
        residual = float(result.residual[row])
        reason = failure_text(status_name(result.status[row]), self.method, self.loops, residual)
        return IntegrationError(
            f"in a part of a step, of length {length:g} from t = {start:g}, {reason} for member {owner}; "
            "take a smaller step",
            step=0,
            time=start,
            residual=residual,
        )
