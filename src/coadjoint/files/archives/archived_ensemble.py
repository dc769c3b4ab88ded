"""Ensembles in archives, possibly with members that are not computed yet."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archived_run import ACCOUNTS_ATTRIBUTE, FINISHED, STEPS
from coadjoint.files.archives.archived_solution import ArchivedSolution, open_archive
from coadjoint.files.archives.blocks import (
    BLOCK_SIZE_ATTRIBUTE,
    MEMBER,
    PENDING,
    STATUS,
    Block,
    blocks_of,
    is_computed,
    read_head,
)
from coadjoint.files.archives.metadata_checks import check_archive
from coadjoint.files.archives.store import open_folder, read_root
from coadjoint.runs.solution import Statistics


class ArchivedEnsemble(ArchivedSolution):
    """An ensemble in an archive, as of the time it was opened.

    All times are present from the beginning; values not computed yet are NaN, and `status` has the progress.

    Attributes
    ----------
    finished : bool
        Whether every member has been computed to its end, or has failed.
    reached : int
        Number of steps that every member has taken.
    status : ndarray of int, shape (members,)
        0 for members that are not computed yet, 1 for those that are, 2 for those that have failed.
    """

    def __init__(self, path: Path, system: Any = None) -> None:
        arrays, attributes = read_root(path)
        check_archive(path, arrays, attributes)
        self.__dict__.update(
            path=path,
            choice=None,
            events=None,
            _ending=None,
            _error=None,
            _began=None,
            _system_argument=system,
            _arrays=arrays,
            attributes=attributes,
            _accounts=tuple((force, name) for force, name in json.loads(attributes[ACCOUNTS_ATTRIBUTE])),
        )

    @cached_property
    def blocks(self) -> list[Block]:
        """Blocks of members that are run together."""
        return blocks_of(self._arrays["x0"].shape[0], int(self.attributes[BLOCK_SIZE_ATTRIBUTE]))

    @cached_property
    def _marker_heads(self) -> list[dict[str, Any]]:
        """Heads of the markers of the blocks; empty for blocks that have not begun."""
        with open_folder(self.path) as folder:
            return [read_head(folder, block.number) or {} for block in self.blocks]

    def _may_be_missing(self, name: str) -> Callable[[tuple[int, ...]], bool] | None:
        array = self._arrays[name]
        if self.attributes[FINISHED] or MEMBER not in array.dims or not is_computed(name, array):
            return None
        axis, rows = array.dims.index(MEMBER), array.chunk[0]

        def not_written(indices: tuple[int, ...]) -> bool:
            head = self._marker_heads[indices[axis]]
            return not head or (array.grows and indices[0] * rows >= head["rows"])

        return not_written

    @cached_property
    def finished(self) -> bool:  # type: ignore[override]
        """Whether every block is finished."""
        return all(head.get(FINISHED, 0) for head in self._marker_heads)

    @cached_property
    def reached(self) -> int:  # type: ignore[override]
        """Number of steps that every member has taken."""
        return min(int(head.get(STEPS, 0)) for head in self._marker_heads)

    @cached_property
    def status(self) -> NDArray[np.int64]:
        """Status of the members."""
        return self._read_entire(STATUS)

    @cached_property
    def stats(self) -> Statistics:
        """Work of the run; the seconds are summed over all workers."""
        work = {name: sum(head.get(name, 0) for head in self._marker_heads) for name in ("evaluations", "iterations")}
        return Statistics(
            self.reached, **work, seconds=sum(float(head.get("seconds", 0.0)) for head in self._marker_heads)
        )

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        """Invariants at the first time; NaN for members that have not begun."""
        values = [self.energy, *self.casimirs.values()]
        return {name: series[0] for name, series in zip(self._names, values, strict=True)}

    @cached_property
    def _worst(self) -> NDArray[np.float64]:
        names = ("change", "balance") if self._accounts else ("drift",)
        return np.concatenate([np.moveaxis(self._read_entire(name), 1, 2) for name in names], axis=-1)

    @property
    def progress_text(self) -> str:
        """Number of computed members as text."""
        return f"{int(np.count_nonzero(self.status != PENDING))} of {len(self.status)} members"

    def __repr__(self) -> str:
        return f"<archive {self.path}: {self.progress_text} are computed>"

    def __reduce__(self) -> tuple[Any, ...]:
        return open_archive, (self.path, self._system_argument)
