"""Solutions in archives; arrays are read lazily."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archived_run import ACCOUNTS_ATTRIBUTE, FINISHED, STEPS, states_of
from coadjoint.files.archives.blocks import BLOCK_SIZE_ATTRIBUTE
from coadjoint.files.archives.metadata_checks import as_archive_errors, check_archive, check_reported
from coadjoint.files.archives.store import (
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
from coadjoint.files.datasets.read_solution import ReadSolution
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import need
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.solution import Statistics

if TYPE_CHECKING:
    import xarray


REPORTED_ARRAYS = (f"{STATE_PREFIX}worst", "earlier", "initial")
"""Arrays of the run's state that a solution needs."""
ATTEMPTS = 20


class ArchivedSolution(ReadSolution):
    """A run in an archive, as of the time it was opened by `open_archive`.

    It has all attributes of a `Solution`. Arrays are read lazily and cached; ``to_xarray()`` reads parts of arrays that
    do not fit in memory.

    Attributes
    ----------
    path : Path
        The archive.
    finished : bool
        Whether the run has reached its end; otherwise `resume` continues it.
    reached : int
        Number of steps taken.
    attributes : dict
        Attributes of the run, as in its dataset.
    """

    def __init__(self, path: Path, system: Any = None) -> None:
        arrays, attributes = read_root(path)
        check_archive(path, arrays, attributes)
        state = read_state(path, states_of(attributes)[-1])
        with as_archive_errors(path):
            check_reported(state, arrays)
        self.__dict__.update(
            path=path,
            finished=bool(attributes[FINISHED]),
            reached=int(attributes[STEPS]),
            choice=None,
            events=None,
            _ending=None,
            _error=None,
            _began=None,
            _system_argument=system,
            _arrays=arrays,
            attributes=attributes,
            _stored={name: state[name] for name in REPORTED_ARRAYS},
            _accounts=tuple((force, name) for force, name in json.loads(attributes[ACCOUNTS_ATTRIBUTE])),
        )

    path: Path
    finished: bool
    reached: int
    _system_argument: Any
    _arrays: dict[str, StoredArray]
    _stored: dict[str, NDArray[Any]]

    def __reduce__(self) -> tuple[Any, ...]:
        return open_archive, (self.path, self._system_argument)

    def __repr__(self) -> str:
        state = "finished" if self.finished else f"at step {self.reached} of {self._times.steps}"
        return f"<archive {self.path}, {state}: {self._arrays['time'].shape[0]} points>"

    def inputs(self, events: Any = ()) -> dict[str, Any]:
        import xarray

        names: list[str] = [name for name in ("x0", "attitude0") if name in self._arrays]
        if self.attributes["between_steps"]:
            names.append("time")
        values = {name: (self._arrays[name].dims, self._read_entire(name)) for name in names}
        return stored_inputs(xarray.Dataset(values, attrs=self.attributes), self._system_argument, events)

    def _read_entire(self, name: str) -> NDArray[Any]:
        array = self._arrays[name]
        what = f"{name} of the archive {self.path}"
        check_available_memory(16 * prod(array.shape), what, f"read a part of to_xarray()[{name!r}]")
        return read_array(self.path, name, array, may_be_missing=self._may_be_missing(name))

    def _may_be_missing(self, name: str) -> Callable[[tuple[int, ...]], bool] | None:
        """Return a predicate for chunks that may not be written yet; None if all chunks are committed."""
        return None

    def check_complete(self) -> None:
        """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
        with open_folder(self.path) as folder:
            for name, array in self._arrays.items():
                try:
                    files = folder.names(name)
                except OSError as reason:
                    raise ArchiveError(f"{self.path}: {name} cannot be read ({reason.strerror})") from None
                for indices, _, _ in array.chunks_in([range(0, size, chunk) for size, chunk in array.extent]):
                    if chunk_file(indices) not in files:
                        raise missing_chunk_error(self.path, name, indices)
                if array.grows:
                    first_row = array.shape[0] - array.shape[0] % array.chunk[0]
                    rows = range(first_row, array.shape[0])
                    read_array(self.path, name, array, [rows, *map(range, array.shape[1:])])

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        values = self._stored["initial"]
        return {name: values[0, i] if self.failed is None else values[:, i] for i, name in enumerate(self._names)}

    @cached_property
    def stats(self) -> Statistics:
        attributes = self.attributes
        return Statistics(
            self.reached, int(attributes["evaluations"]), int(attributes["iterations"]), float(attributes["seconds"])
        )

    @cached_property
    def _worst(self) -> NDArray[np.float64]:
        worst = larger_deviations(self._stored["earlier"], self._stored[f"{STATE_PREFIX}worst"])
        return worst[0] if self.failed is None else worst

    def to_xarray(self) -> xarray.Dataset:
        import xarray

        from coadjoint.files.archives.archived_variables import ArchivedArray, variable

        variables: dict[str, Any] = {}
        for name, array in self._arrays.items():
            if array.kind == "string":
                variables[name] = (array.dims, list(map(str, self._read_entire(name))), dict(array.attributes))
            else:
                variables[name] = variable(ArchivedArray(self.path, name, array, self._may_be_missing(name)))
        coordinates = str(self.attributes.get("coordinates", "")).split()
        attributes = {name: value for name, value in self.attributes.items() if name != "coordinates"}
        return xarray.Dataset(variables, attrs=attributes).set_coords(
            [name for name in coordinates if name in variables]
        )


def _opened(path: Path, system: Any) -> ArchivedSolution:
    if BLOCK_SIZE_ATTRIBUTE in read_root(path)[1]:
        from coadjoint.files.archives.archived_ensemble import ArchivedEnsemble

        return ArchivedEnsemble(path, system)
    return ArchivedSolution(path, system)


def open_archive(path: str | Path, system: Any = None) -> ArchivedSolution:
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
    ArchivedSolution
        The run as currently committed. Arrays are read lazily.

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
    need("an archive of a run", "xarray", "zarr")
    archive_path = read_archive_path(path)
    for attempt in range(ATTEMPTS):
        try:
            return _opened(archive_path, system)
        except ArchiveMoved as reason:  # a commit happened in between
            if attempt == ATTEMPTS - 1:
                raise ArchiveError(str(reason)) from None
    raise AssertionError
