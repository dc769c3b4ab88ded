"""Ensembles in archives, possibly with members that are not computed yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archive_record import archive_record
from coadjoint.files.archives.archived_run import FINISHED, STEPS
from coadjoint.files.archives.blocks import (
    BLOCK_SIZE_ATTRIBUTE,
    MEMBER,
    PENDING,
    STATUS,
    blocks_of,
    is_computed,
    read_head,
)
from coadjoint.files.archives.metadata_checks import check_archive
from coadjoint.files.archives.reading import open_folder, read_root
from coadjoint.files.datasets.stored_record import initial_values
from coadjoint.runs.results.run_record import RunRecord, Statistics
from coadjoint.runs.results.solution import Solution


def archived_ensemble(path: Path, system: Any = None) -> Solution:
    """Return the solution in the archive of an ensemble in blocks.

    All times are present from the beginning; values not computed yet are NaN, and `status` has the progress.
    """
    arrays, attributes = read_root(path)
    check_archive(path, arrays, attributes)

    def blocks() -> list[Any]:
        return blocks_of(arrays["x0"].shape[0], int(attributes[BLOCK_SIZE_ATTRIBUTE]))

    @cache
    def heads() -> list[dict[str, Any]]:
        """Return the heads of the markers of the blocks; empty for blocks that have not begun."""
        with open_folder(path) as folder:
            return [read_head(folder, block.number) or {} for block in blocks()]

    def may_be_missing(name: str) -> Callable[[tuple[int, ...]], bool] | None:
        array = arrays[name]
        if attributes[FINISHED] or MEMBER not in array.dims or not is_computed(name, array):
            return None
        axis, rows = array.dims.index(MEMBER), array.chunk[0]

        def not_written(indices: tuple[int, ...]) -> bool:
            head = heads()[indices[axis]]
            return not head or (array.grows and indices[0] * rows >= head["rows"])

        return not_written

    def stats(record: RunRecord) -> Statistics:
        """Return the work of the run; the seconds are summed over all workers."""
        evaluations, iterations = (sum(head.get(name, 0) for head in heads()) for name in ("evaluations", "iterations"))
        seconds = sum(float(head.get("seconds", 0.0)) for head in heads())
        elapsed = float(attributes.get("elapsed", np.nan))
        return Statistics(record.reached, evaluations, iterations, seconds, elapsed)

    functions: Mapping[str, Callable[[RunRecord], Any]] = {
        "blocks": lambda record: blocks(),
        "finished": lambda record: all(head.get(FINISHED, 0) for head in heads()),
        "reached": lambda record: min(int(head.get(STEPS, 0)) for head in heads()),
        "status": lambda record: record.read(STATUS),
        "progress_text": _progress_text,
        "initial": initial_values,
        "worst": _worst,
        "stats": stats,
        "text": lambda record: f"<archive {path}: {record.progress_text} are computed>",
    }
    return Solution(archive_record(path, arrays, attributes, system, functions, may_be_missing))


def _progress_text(record: RunRecord) -> str:
    return f"{int(np.count_nonzero(record.status != PENDING))} of {len(record.status)} members"


def _worst(record: RunRecord) -> NDArray[np.float64]:
    names = ("change", "balance") if record.accounts else ("drift",)
    return np.concatenate([np.moveaxis(record.read(name), 1, 2) for name in names], axis=-1)
