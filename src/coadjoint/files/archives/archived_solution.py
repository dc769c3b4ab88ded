"""Solutions in archives, finished or not; arrays are read with all checks of the archive, on first use."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.files.archives.archive import (
    DONE,
    FAILED,
    FINISHED,
    PENDING,
    STATUS,
    STEPS,
    WORK_INTEGRALS_ATTRIBUTE,
    Archive,
    MemberBlock,
    identity_of,
    sums_among,
    total_progress,
)
from coadjoint.files.archives.folder import ArchiveError, ArchiveUnreadable, Folder, read_location, reading
from coadjoint.files.archives.run_checks import EVENTS_ATTRIBUTE, check_archive, check_reported
from coadjoint.files.archives.store import ArchiveStore
from coadjoint.files.datasets.named_axes import MEMBER, coordinate_variables, label_of, stored_axes, unstacked
from coadjoint.files.datasets.stored_solution import StoredSolution, stored_inputs
from coadjoint.files.datasets.variables import event_variables, joined_complex, with_vorticity
from coadjoint.files.records.reconstruction import events_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import NUMBERS, RecordedEvents, events_of_numbers, joined_events
from coadjoint.runs.piecewise_run import STATE_PREFIX, larger_deviations
from coadjoint.runs.results.quantities import NamedValues
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import Statistics, with_products

if TYPE_CHECKING:
    import xarray

REPORTED_ARRAYS = (f"{STATE_PREFIX}worst", "earlier", "initial")
"""Arrays of the run's state that a solution needs."""
ATTEMPTS = 20  # to read a root and its state between two commits of another process

Floats = NDArray[np.float64]


class ArchivedSolution(StoredSolution):
    """The solution in an archive as committed when it was opened; values not computed yet are NaN."""

    _in_memory = False
    _archive: Archive
    _given_system: Any
    _state: Mapping[str, Any] | None

    def __reduce__(self) -> tuple[Any, ...]:
        return solution_at, (self._archive.folder, self._given_system, identity_of(self.attributes))

    def __repr__(self) -> str:
        state = "finished" if self.finished else f"at step {self.reached} of {self._times.steps}"
        content = self.progress_text if self._state is None else f"{self._arrays['time'].shape[0]} points"
        return f"<archive {self.path}, {state}: {content}>"

    def check_complete(self) -> None:
        """Raise ArchiveError if committed chunks are missing, or the last chunks of growing arrays are damaged."""
        self._archive.check_complete()

    def inputs(self) -> dict[str, Any]:
        import xarray

        names: list[str] = [name for name in ("x0", "attitude0") if name in self._arrays]
        if self.attributes["between_steps"]:
            names.append("time")
        variables = {name: (self._arrays[name].dims, self._read_entire(name)) for name in names}
        return stored_inputs(xarray.Dataset(variables, attrs=self.attributes), self._given_system, ())

    def to_xarray(self, grid: Any = None) -> xarray.Dataset:
        import xarray

        from coadjoint.files.archives.archived_variables import ArchivedArray, variable

        attributes, arrays = self.attributes, self._arrays
        coordinates = str(attributes.get("coordinates", "")).split()
        own = {name: value for name, value in attributes.items() if name != "coordinates"}
        axes = stored_axes(attributes, self._archive.members)
        variables: dict[str, Any] = {}
        for name, array in arrays.items():
            if array.kind == "string":
                variables[name] = (array.dims, list(map(str, self._read_entire(name))), dict(array.attributes))
            elif axes and name in coordinates:
                entry = {name: (array.dims, self._read_entire(name), dict(array.attributes))}
                variables[name] = unstacked(xarray.Dataset(coords=entry, attrs=own))[name].variable
            else:
                variables[label_of(name, axes)] = variable(ArchivedArray(self._archive, name, axes))
        if self.events is not None:
            variables |= event_variables(self.events)
        variables |= coordinate_variables(axes)
        coordinates = [name for name in [*coordinates, *coordinate_variables(axes)] if name in variables]
        dataset = xarray.Dataset(variables, attrs=own).set_coords(coordinates)
        return dataset if grid is None else with_vorticity(dataset, self, grid)

    def _read_entire(self, name: str) -> NDArray[Any]:
        return self._archive.read(name)

    @cached_property
    def _work_integrals(self) -> tuple[tuple[str, str], ...]:
        return tuple((force, name) for force, name in json.loads(self.attributes[WORK_INTEGRALS_ATTRIBUTE]))

    @cached_property
    def incomplete(self) -> str | None:
        return super().incomplete or (None if self.finished else "unfinished")

    @cached_property
    def _progress(self) -> dict[str, Any]:
        return total_progress(self._archive.heads)

    @cached_property
    def finished(self) -> bool:  # type: ignore[override]
        return bool(self._progress[FINISHED])

    @cached_property
    def reached(self) -> int:  # type: ignore[override]
        return int(self._progress[STEPS])

    @cached_property
    def stats(self) -> Statistics:
        """The work of the run; the seconds are summed over all workers."""
        evaluations, iterations, seconds = (self._progress[name] for name in ("evaluations", "iterations", "seconds"))
        elapsed = float(self.attributes.get("elapsed", np.nan))
        return with_products(Statistics(self.reached, evaluations, iterations, float(seconds), elapsed), self)

    @cached_property
    def events(self) -> RecordedEvents | None:
        """The crossings found so far, also those of blocks that are not finished."""
        if EVENTS_ATTRIBUTE not in self.attributes:
            return None
        try:
            system = self.system
        except ValueError:  # its functions were not stored
            system = None
        archive, arrays, none = self._archive, self._arrays, np.zeros(0, dtype=np.int64)
        with reading(archive.folder, "the events"):
            asked = events_of(self.attributes[EVENTS_ATTRIBUTE], EVENTS_ATTRIBUTE, system)
            x = joined_complex(np.zeros((1, *arrays["x0"].shape[MEMBER in arrays["x0"].dims :])), arrays["x0"].dims)
            attitude = np.zeros((0, *arrays["attitude0"].shape[-2:])) if "attitude0" in arrays else None
            coordinates = tuple(map(str, self._read("component"))) if "component" in arrays else ()
            names = tuple(str(event.name) for event in asked)
            found = RecordedEvents(names, np.zeros(0), x[:0], none, none, none, attitude, coordinates, asked)
            if self._state is not None:
                return events_of_numbers(self._state, found, archive.members)
            pieces = [found]
            for block in archive.blocks:
                if (marker := archive.read_marker(block)) is not None:
                    pieces.append(events_of_numbers(marker.numbers, found, block.last - block.first))
                    pieces[-1].member += block.first
            return joined_events(pieces)

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        if self._state is None:
            return super().initial
        values, single = self._state["initial"], self.failed is None
        return NamedValues({name: values[0, i] if single else values[:, i] for i, name in enumerate(self._names)})

    @cached_property
    def _worst(self) -> Floats:
        if self._state is None:
            return super()._worst
        worst = larger_deviations(self._state["earlier"], self._state[f"{STATE_PREFIX}worst"])
        return worst[0] if self.failed is None else worst

    @cached_property
    def blocks(self) -> Sequence[MemberBlock]:  # type: ignore[override]
        return self._archive.blocks

    @cached_property
    def status(self) -> NDArray[np.int64]:  # type: ignore[override]
        if STATUS in self._arrays:
            return self._read(STATUS)
        failed = bool(self.attributes.get("run_failed")) if self.failed is None else self.failed
        return np.full(self._archive.members, np.where(failed, FAILED, DONE if self.finished else PENDING))

    @cached_property
    def _pending_members(self) -> NDArray[np.bool_] | None:
        return np.asarray(self.status == PENDING) if self._state is None else None

    @cached_property
    def progress_text(self) -> str:  # type: ignore[override]
        if self._state is not None:
            return f"the run up to step {self.reached}"
        blocks = zip(self.blocks, self._archive.heads, strict=True)
        done = sum(block.last - block.first for block, head in blocks if head.get(FINISHED))
        return f"{done} of {self._archive.members} members"


def _opened(archive: Archive, system: Any) -> Solution:
    """Return the solution in an archive as committed when its root was read."""
    check_archive(archive)
    fields: dict[str, Any] = {"path": archive.folder.path, "_archive": archive}
    fields |= {"attributes": archive.attributes, "_arrays": archive.arrays, "_given_system": system}
    state = None
    if not archive.has_blocks:
        stored = archive.read_state(archive.states[-1])
        archive.sums = sums_among(stored)
        with reading(archive.folder, "the archive"):
            check_reported(stored, archive)
        state = {name: stored[name] for name in stored if name in REPORTED_ARRAYS or name.startswith(NUMBERS)}
    archive.check_extent()
    return ArchivedSolution(fields | {"_state": state})


def solution_at(folder: Folder, system: Any = None, identity: str | None = None) -> Solution:
    """Return the solution in an archive as currently committed, of a given run if it is pickled; see `open_archive`."""
    require_packages("an archive of a run", "xarray", "zarr")
    archive = Archive.at(folder)
    if identity not in (None, identity_of(archive.attributes)):
        raise ArchiveError(f"{folder}: another run has taken the place of the one that was pickled")
    for _ in range(ATTEMPTS - 1):
        try:
            return _opened(archive, system)
        except ArchiveUnreadable:
            raise
        except ArchiveError:
            before, archive = archive, Archive.at(folder)
            if archive.attributes == before.attributes:  # otherwise a commit removed the state in between
                raise
    return _opened(archive, system)


@suggest_keywords
def open_archive(path: str | Path | Mapping[str, Any], system: Any = None) -> Solution:
    """Open the archive of a run, finished or not, also while it is written.

    `load` opens archives as well as files. Use this function to refuse anything but an archive.

    Parameters
    ----------
    path : str, Path or mapping of fsspec
        The folder that ``integrate(..., archive=path)`` writes, or a copy elsewhere: a URL that fsspec opens, such as
        ``"s3://bucket/run.zarr"``, or for further options ``fsspec.get_mapper(url, ...)``.
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
    MissingPackageError
        A package that the format or the URL needs is not installed.

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
    return solution_at(read_location(path), system)


def raise_if_failed(archive: Solution) -> Solution:
    """Return the solution of a run that has ended, or raise the failure that ended it."""
    attributes = archive.attributes
    if not attributes.get("run_failed"):
        return archive
    raise IntegrationError(
        attributes["failed_reason"],
        step=int(attributes["failed_step"]),
        time=float(attributes["failed_time"]),
        residual=float(attributes["failed_residual"]),
        partial=archive,
    )


@contextmanager
def closing(store: ArchiveStore, system: Any) -> Iterator[None]:
    """Close an archive at the end; its solution is the partial solution of an interrupt."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        interrupt.partial = open_archive(store.path, system)  # type: ignore[attr-defined]
        interrupt.add_note(
            f"{store.path} contains the computed steps; co.resume({str(store.path)!r}) continues the run"
        )
        raise
    finally:
        store.close()
