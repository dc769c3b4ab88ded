"""Solutions in archives, finished or not; arrays are read with all checks of the archive, on first use."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archived_run import ACCOUNTS_ATTRIBUTE, FINISHED, SAVE_EVERY, STEPS, states_of
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
from coadjoint.files.archives.metadata_checks import as_archive_errors, check_archive, check_reported
from coadjoint.files.archives.reading import (
    ArchiveError,
    ArchiveMoved,
    chunk_file,
    missing_chunk_error,
    open_folder,
    read_archive_path,
    read_array,
    read_root,
    read_state,
)
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.datasets.export import stored_inputs
from coadjoint.files.datasets.named_axes import coordinate_variables, label_of, stored_axes, unstacked
from coadjoint.files.datasets.stored_solution import StoredSolution
from coadjoint.keyword_hints import NamedValues, suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import Statistics

if TYPE_CHECKING:
    import xarray

REPORTED_ARRAYS = (f"{STATE_PREFIX}worst", "earlier", "initial")
"""Arrays of the run's state that a solution needs."""
ATTEMPTS = 20  # to read a root and its state between two commits of another process

Floats = NDArray[np.float64]


class ArchivedSolution(StoredSolution):
    """The solution in an archive as committed when it was opened; arrays are read with all checks of the archive."""

    _in_memory = False
    _given_system: Any
    _ending = None
    events = None

    def __reduce__(self) -> tuple[Any, ...]:
        return open_archive, (self.path, self._given_system)

    def check_complete(self) -> None:
        """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
        check_complete(self.path, self._arrays)

    def inputs(self, events: Any = ()) -> dict[str, Any]:
        import xarray

        names: list[str] = [name for name in ("x0", "attitude0") if name in self._arrays]
        if self.attributes["between_steps"]:
            names.append("time")
        variables = {name: (self._arrays[name].dims, self._read_entire(name)) for name in names}
        return stored_inputs(xarray.Dataset(variables, attrs=self.attributes), self._given_system, events)

    def to_xarray(self) -> xarray.Dataset:
        import xarray

        from coadjoint.files.archives.archived_variables import ArchivedArray, variable

        attributes, arrays = self.attributes, self._arrays
        coordinates = str(attributes.get("coordinates", "")).split()
        own = {name: value for name, value in attributes.items() if name != "coordinates"}
        x0 = arrays["x0"]
        axes = stored_axes(attributes, x0.shape[0] if x0.dims[0] == MEMBER else 1)
        variables: dict[str, Any] = {}
        for name, array in arrays.items():
            if array.kind == "string":
                variables[name] = (array.dims, list(map(str, self._read_entire(name))), dict(array.attributes))
            elif axes and name in coordinates:
                entry = {name: (array.dims, self._read_entire(name), dict(array.attributes))}
                variables[name] = unstacked(xarray.Dataset(coords=entry, attrs=own))[name].variable
            else:
                missing, check = self._may_be_missing(name), self._check_last_point
                variables[label_of(name, axes)] = variable(ArchivedArray(self.path, name, array, missing, axes, check))
        variables |= coordinate_variables(axes)
        coordinates = [name for name in [*coordinates, *coordinate_variables(axes)] if name in variables]
        return xarray.Dataset(variables, attrs=own).set_coords(coordinates)

    @cached_property
    def _accounts(self) -> tuple[tuple[str, str], ...]:
        return tuple((force, name) for force, name in json.loads(self.attributes[ACCOUNTS_ATTRIBUTE]))

    @cached_property
    def incomplete(self) -> str | None:
        return super().incomplete or (None if self.finished else "unfinished")

    def _may_be_missing(self, name: str) -> Callable[[tuple[int, ...]], bool] | None:
        """Return a predicate for chunks of an array that may not be written yet; None if all are committed."""
        return None

    @property
    def _check_last_point(self) -> Callable[[], None] | None:
        """Raises ArchiveError if the last point was replaced: by a later end of a run whose last interval is shorter
        than the others; None if it cannot be.
        """
        steps = int(self.attributes.get(STEPS, 0))
        replaceable = self.attributes[FINISHED] and steps % int(self.attributes.get(SAVE_EVERY, steps or 1)) > 0
        return partial(_check_steps, self.path, steps) if replaceable else None

    def _read_entire(self, name: str) -> NDArray[Any]:
        array = self._arrays[name]
        what = f"{name} of the archive {self.path}"
        check_available_memory(16 * prod(array.shape), what, f"read a part of to_xarray()[{name!r}]")
        values = read_array(self.path, name, array, may_be_missing=self._may_be_missing(name))
        if array.grows and (check := self._check_last_point) is not None:
            check()
        return values

    @property
    def _progress(self) -> str:
        raise NotImplementedError


class ArchivedMembers(ArchivedSolution):
    """The solution in the archive of one run, whose members advance together."""

    _state: Mapping[str, Any]

    def __repr__(self) -> str:
        state = "finished" if self.finished else f"at step {self.reached} of {self._times.steps}"
        return f"<archive {self.path}, {state}: {self._arrays['time'].shape[0]} points>"

    @cached_property
    def finished(self) -> bool:  # type: ignore[override]
        return bool(self.attributes[FINISHED])

    @cached_property
    def reached(self) -> int:  # type: ignore[override]
        return int(self.attributes[STEPS])

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        values, single = self._state["initial"], self.failed is None
        return NamedValues({name: values[0, i] if single else values[:, i] for i, name in enumerate(self._names)})

    @cached_property
    def _worst(self) -> Floats:
        worst = larger_deviations(self._state["earlier"], self._state[f"{STATE_PREFIX}worst"])
        return worst[0] if self.failed is None else worst

    @cached_property
    def stats(self) -> Statistics:
        attributes = self.attributes
        return Statistics(
            self.reached,
            int(attributes["evaluations"]),
            int(attributes["iterations"]),
            float(attributes["seconds"]),
            float(attributes.get("elapsed", np.nan)),
        )


class ArchivedEnsemble(ArchivedSolution):
    """The solution in the archive of an ensemble in blocks.

    All times are present from the beginning; values not computed yet are NaN, and `status` has the progress.
    """

    def __repr__(self) -> str:
        return f"<archive {self.path}: {self.progress_text} are computed>"

    @cached_property
    def blocks(self) -> Sequence[Block]:  # type: ignore[override]
        return blocks_of(self._arrays["x0"].shape[0], int(self.attributes[BLOCK_SIZE_ATTRIBUTE]))

    @cached_property
    def _heads(self) -> list[dict[str, Any]]:
        """The heads of the markers of the blocks; empty for blocks that have not begun."""
        with open_folder(self.path) as folder:
            return [read_head(folder, block.number) or {} for block in self.blocks]

    @cached_property
    def finished(self) -> bool:  # type: ignore[override]
        return all(head.get(FINISHED, 0) for head in self._heads)

    @cached_property
    def reached(self) -> int:  # type: ignore[override]
        return min(int(head.get(STEPS, 0)) for head in self._heads)

    @cached_property
    def status(self) -> NDArray[np.int64]:  # type: ignore[override]
        return self._read(STATUS)

    @property
    def _pending_members(self) -> NDArray[np.bool_]:
        return np.asarray(self.status == PENDING)

    @cached_property
    def progress_text(self) -> str:  # type: ignore[override]
        return f"{int(np.count_nonzero(~self._pending_members))} of {len(self.status)} members"

    @cached_property
    def stats(self) -> Statistics:
        """The work of the run; the seconds are summed over all workers."""
        evaluations, iterations = (
            sum(head.get(name, 0) for head in self._heads) for name in ("evaluations", "iterations")
        )
        seconds = sum(float(head.get("seconds", 0.0)) for head in self._heads)
        return Statistics(self.reached, evaluations, iterations, seconds, float(self.attributes.get("elapsed", np.nan)))

    def _may_be_missing(self, name: str) -> Callable[[tuple[int, ...]], bool] | None:
        array = self._arrays[name]
        if self.attributes[FINISHED] or MEMBER not in array.dims or not is_computed(name, array):
            return None
        axis, rows = array.dims.index(MEMBER), array.chunk[0]

        def not_written(indices: tuple[int, ...]) -> bool:
            head = self._heads[indices[axis]]
            return not head or (array.grows and indices[0] * rows >= head["rows"])

        return not_written


def _opened(path: Path, system: Any) -> Solution:
    """Return the solution in an archive as currently committed."""
    arrays, attributes = read_root(path)
    fields = {"path": path, "attributes": attributes, "_arrays": arrays, "_given_system": system}
    check_archive(path, arrays, attributes)
    if BLOCK_SIZE_ATTRIBUTE in attributes:
        return ArchivedEnsemble(fields)
    state = read_state(path, states_of(attributes)[-1])
    with as_archive_errors(path):
        check_reported(state, arrays)
    return ArchivedMembers(fields | {"_state": {name: state[name] for name in REPORTED_ARRAYS}})


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


def _check_steps(path: Path, steps: int) -> None:
    """Raise ArchiveError if a run that had ended at a step has been resumed to a later end."""
    if int(read_root(path)[1].get(STEPS, 0)) != steps:
        raise ArchiveError(
            f"{path}: was resumed to a later end after it was opened, and its last point at that time, of step "
            f"{steps}, was replaced; open it again"
        )


def check_complete(path: Path, arrays: Mapping[str, StoredArray]) -> None:
    """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
    with open_folder(path) as folder:
        for name, array in arrays.items():
            try:
                files = folder.names(name)
            except OSError as reason:
                raise ArchiveError(f"{path}: {name} cannot be read ({reason.strerror})") from None
            for indices, _, _ in array.chunks_in([range(0, size, chunk) for size, chunk in array.extent]):
                if chunk_file(indices) not in files:
                    raise missing_chunk_error(path, name, indices)
            if array.grows:
                first_row = array.shape[0] - array.shape[0] % array.chunk[0]
                rows = range(first_row, array.shape[0])
                read_array(path, name, array, [rows, *map(range, array.shape[1:])])
