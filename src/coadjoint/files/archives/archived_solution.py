"""Solutions in archives; arrays are read lazily."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.archives.archive_record import archive_record
from coadjoint.files.archives.archived_ensemble import archived_ensemble
from coadjoint.files.archives.archived_run import FINISHED, STEPS, states_of
from coadjoint.files.archives.blocks import BLOCK_SIZE_ATTRIBUTE
from coadjoint.files.archives.metadata_checks import as_archive_errors, check_archive, check_reported
from coadjoint.files.archives.reading import ArchiveError, ArchiveMoved, read_archive_path, read_root, read_state
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.results.run_record import RunRecord, Statistics
from coadjoint.runs.results.solution import Solution

REPORTED_ARRAYS = (f"{STATE_PREFIX}worst", "earlier", "initial")
"""Arrays of the run's state that a solution needs."""
ATTEMPTS = 20  # to read a root and its state between two commits of another process


def archived_solution(path: Path, system: Any = None) -> Solution:
    """Return the solution in the archive of one run, as currently committed."""
    arrays, attributes = read_root(path)
    check_archive(path, arrays, attributes)
    state = read_state(path, states_of(attributes)[-1])
    with as_archive_errors(path):
        check_reported(state, arrays)
    latest, earlier, initial = (state[name] for name in REPORTED_ARRAYS)
    worst = larger_deviations(earlier, latest)
    record = archive_record(
        path,
        arrays,
        attributes,
        system,
        {
            "initial": lambda record: {
                name: initial[0, i] if record.failed is None else initial[:, i] for i, name in enumerate(record.names)
            },
            "worst": lambda record: worst[0] if record.failed is None else worst,
            "text": _text,
        },
        finished=bool(attributes[FINISHED]),
        reached=int(attributes[STEPS]),
        stats=Statistics(
            int(attributes[STEPS]),
            int(attributes["evaluations"]),
            int(attributes["iterations"]),
            float(attributes["seconds"]),
            float(attributes.get("elapsed", np.nan)),
        ),
    )
    return Solution(record)


def _text(record: RunRecord) -> str:
    state = "finished" if record.finished else f"at step {record.reached} of {record.times.steps}"
    return f"<archive {record.path}, {state}: {record.arrays['time'].shape[0]} points>"


def _opened(path: Path, system: Any) -> Solution:
    is_ensemble = BLOCK_SIZE_ATTRIBUTE in read_root(path)[1]
    solution = archived_ensemble(path, system) if is_ensemble else archived_solution(path, system)
    solution.record.reopen = open_archive, (path, system)
    return solution


@suggest_keywords
def open_archive(path: str | Path, system: Any = None) -> Solution:
    """Open the archive of a run, finished or not, also while it is written.

    `load` opens archives as well as files. Use this function to refuse anything but an archive.

    Parameters
    ----------
    path : str or Path
        The folder that ``integrate(..., archive=path)`` writes.
    system : optional
        The system of the run, if it contains Python functions, which are not stored. It is needed only by attributes
        that use the system.

    Returns
    -------
    Solution
        The run as currently committed, with `path`, `finished`, `reached` and `attributes`. Arrays are read lazily.

    Raises
    ------
    ArchiveError
        The archive is missing, damaged, or of a later format.

    Examples
    --------
    >>> import coadjoint as co
    >>> import tempfile
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     sol = co.integrate(body, (1.0, 0.2, 0.1), (0, 10), 0.1, archive=f"{folder}/run.zarr")
    ...     co.open_archive(f"{folder}/run.zarr").x.shape
    (101, 3)
    """
    require_packages("an archive of a run", "xarray", "zarr")
    archive_path = read_archive_path(path)
    for attempt in range(ATTEMPTS):
        try:
            return _opened(archive_path, system)
        except ArchiveMoved as reason:  # a commit happened in between
            if attempt == ATTEMPTS - 1:
                raise ArchiveError(str(reason)) from None
    raise AssertionError
