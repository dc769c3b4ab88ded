"""Solutions read from files, and runs repeated from datasets."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.archives.archive import HIDDEN_FOLDER
from coadjoint.files.archives.archived_solution import solution_at
from coadjoint.files.archives.folder import ArchiveFolder, RemoteFolder, remote_folder
from coadjoint.files.archives.run_checks import ARRAY_TYPES, FLOAT_ARRAYS, SERIES_PREFIXES, check_arrays
from coadjoint.files.archives.stored_arrays import TYPES, StoredArray
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE, TAKEN_ATTRIBUTE
from coadjoint.files.datasets.named_axes import in_order, stacked
from coadjoint.files.datasets.stored_solution import (
    REQUIRED_ATTRIBUTES,
    StoredSolution,
    events_of_dataset,
    stored_inputs,
    stored_method,
)
from coadjoint.files.datasets.variables import state_of, with_vorticity
from coadjoint.files.datasets.writers import CHECKSUM, checksum_of
from coadjoint.files.output.file_validation import check_hdf5, check_zarr
from coadjoint.files.records.entries import Entry, as_value_errors, parsed
from coadjoint.files.records.records import system_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import STATE_DIMENSIONS
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import open_regular
from coadjoint.runs.events import RecordedEvents
from coadjoint.runs.integrate import integrate
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import NamedValues
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import Statistics, with_products
from coadjoint.runs.times import output_times_of, times_of
from coadjoint.systems.batch import SUFFIX
from coadjoint.systems.coordinates import coordinate_names, coordinates_of
from coadjoint.validation import read_path

if TYPE_CHECKING:
    import xarray

FILE_SIGNATURES = {b"\x89HDF": ("h5netcdf", ("xarray", "h5netcdf", "h5py")), b"CDF": ("scipy", ("xarray", "scipy"))}
"""File signatures, with the xarray engine and the packages it needs."""

RUN_VARIABLES = ("x", "x0", "energy", "time", "invariant")
"""Variables of every run."""


class LoadedSolution(StoredSolution):
    """The solution in a dataset that was read from a file into memory; a given system replaces the stored one."""

    _stacked: xarray.Dataset
    """The dataset with one axis of members."""
    _given_system: Any

    def __reduce__(self) -> tuple[Any, ...]:
        return solution_of_dataset, (self.path, self.dataset, self._given_system)

    def to_xarray(self, grid: Any = None) -> xarray.Dataset:
        dataset = self.dataset.copy()
        return dataset if grid is None else with_vorticity(dataset, self, grid)

    def inputs(self) -> dict[str, Any]:
        return stored_inputs(self._stacked, self._given_system, ())

    def _read_entire(self, name: str) -> NDArray[Any]:
        return np.asarray(self._stacked[name].values)

    @cached_property
    def _work_integrals(self) -> tuple[tuple[str, str], ...]:
        work_integrals = list(map(str, self._read("account"))) if "account" in self._arrays else []
        return tuple(_split_work_integral(label, self._names) for label in work_integrals)

    @cached_property
    def initial(self) -> Mapping[str, Any]:
        t0 = self._times.t0
        if self.t[0] == t0:
            return super().initial
        # The start is not among the saved times.
        if self.failed is None:
            return NamedValues(_invariants_at(self.system, self.x0, t0))
        invariants = [_invariants_at(self.system.of_member(m), x, t0) for m, x in enumerate(self.x0)]
        return NamedValues({name: np.array([values[name] for values in invariants]) for name in self._names})

    @cached_property
    def stats(self) -> Statistics:
        attributes = self.attributes
        named = (TAKEN_ATTRIBUTE, ENDED_ATTRIBUTE, "steps")
        steps = int(next(attributes[name] for name in named if name in attributes))
        work = int(attributes["evaluations"]), int(attributes["iterations"])
        seconds = float(attributes["seconds"]), float(attributes.get("elapsed", np.nan))
        found = Statistics(steps, *work, *seconds)
        return found if "not_stored" in attributes else with_products(found, self)

    @cached_property
    def events(self) -> RecordedEvents | None:
        if "event_time" not in self._arrays:
            if "events" in self.attributes:
                raise ValueError(f"{self.path}: was copied from an archive without its events; open the archive itself")
            return None
        events = events_of_dataset(self.dataset, self.system)
        t, x = self._read("event_time"), self._read("event_x")
        # Some versions of xarray read whole numbers as 32 bits.
        event_index, member, direction = (
            self._read(f"event_{name}").astype(np.int64, copy=False) for name in ("which", "member", "direction")
        )
        names = tuple(str(event.name) for event in events)
        coordinates, attitude = coordinates_of(self.system), self._read_if_stored("event_attitude")
        return RecordedEvents(names, t, x, event_index, member, direction, attitude, coordinates, events)


def solution_of_dataset(path: Path, dataset: xarray.Dataset, system: Any = None) -> Solution:
    """Return the solution in a dataset in memory."""
    content = stacked(dataset)
    arrays = {
        str(name): SimpleNamespace(dims=values.dims, attributes=values.attrs)
        for name, values in content.variables.items()
    }
    return LoadedSolution(
        {
            "path": path,
            "dataset": dataset,
            "attributes": dict(content.attrs),
            "_stacked": content,
            "_arrays": arrays,
            "_given_system": system,
        }
    )


def _split_work_integral(text: str, invariants: list[str]) -> tuple[str, str]:
    """Split the label of a work integral into force and invariant; both names may contain the separator.

    Examples
    --------
    >>> _split_work_integral("drag: on x: C: 2", ["energy", "2", "C: 2"])
    ('drag: on x', 'C: 2')
    """
    ending = text.rpartition(": ")[2]
    name = max((name for name in invariants if text.endswith(f": {name}")), key=len, default=ending)
    return text[: -len(name) - 2], name


def _invariants_at(system: Any, x: NDArray[Any], t: float) -> dict[str, Any]:
    """Return the energy and the Casimirs of one state."""
    return {"energy": system.energy(x, t)} | {name: function(x) for name, function in system.casimirs.items()}


@suggest_keywords
def load(path: str | Path | Mapping[str, Any], system: Any = None) -> Solution:
    """Open a run that was written to a file or a folder.

    Files written by ``sol.to_xarray().to_netcdf(path)``, ``to_zarr`` and `coadjoint run` are read into memory; an
    archive is read lazily, as by `open_archive`.

    Parameters
    ----------
    path : str, Path or mapping of fsspec
        A file ``.nc``, a folder ``.zarr``, or an archive. The kind is detected from the content, not from the name.
        From URLs and mappings of fsspec only archives are read, as by `open_archive`.
    system : optional
        The system of the run, if it contains Python functions, which are not stored. It is needed only by attributes
        that use the system.

    Returns
    -------
    Solution
        The run, with bitwise equal states, energies, Casimirs, attitudes, events and drifts. System and scheme are
        rebuilt lazily. `path` is the source, and `dataset` the content of a file, such as the coordinates of a sweep.

    Raises
    ------
    ValueError
        The file is missing or damaged, or contains no run of this library.
    ArchiveError
        An archive is damaged, or of a later format.
    MissingPackageError
        A package that the format needs is not installed.

    See Also
    --------
    open_archive : Open an archive, also while it is written.
    coadjoint.files.datasets.export.rebuild : Repeat the run of a dataset.

    Examples
    --------
    >>> import coadjoint as co
    >>> import tempfile
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), (0, 10), 0.1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = sol.to_xarray().to_netcdf(f"{folder}/run.nc", engine="h5netcdf")
    ...     again = co.load(f"{folder}/run.nc")
    >>> bool((again.x == sol.x).all()), again.drift() == sol.drift(), again.method
    (True, True, Splitting(order=2...))
    """
    folder = remote_folder(path) or ArchiveFolder(read_path(path, "path"))
    if isinstance(folder, RemoteFolder):
        return solution_at(folder, system)
    source = folder.path
    shown = in_one_line(str(source), 200)
    try:
        if (source / HIDDEN_FOLDER).is_dir():
            return solution_at(folder, system)
        engine, packages = _reader(source)
    except OneLineError:
        raise
    except (OSError, ValueError) as reason:
        raise OneLineError(f"{shown}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    require_packages(f"{shown}: reading it", *packages)
    import xarray

    try:
        if engine == "h5netcdf":
            check_hdf5(source)
        elif engine == "zarr":
            check_zarr(source)
        with xarray.open_dataset(source, engine=engine) as opened:
            missing = [
                key for key in (*REQUIRED_ATTRIBUTES, "evaluations", "iterations", "seconds") if key not in opened.attrs
            ]
            if missing or any(
                name not in opened.variables and f"{name}{SUFFIX}" not in opened.variables for name in RUN_VARIABLES
            ):
                raise OneLineError(f"{shown}: holds no run; it was not written by this library")
            check_available_memory(2 * opened.nbytes, f"{shown}: the run in it", "read parts of it with xarray")
            dataset = opened.load()
        checksum = dataset.attrs.get(CHECKSUM)
        if checksum is None:  # changed, or copied from an archive
            dataset = _checked(dataset, system)
        elif checksum != checksum_of(dataset):
            raise OneLineError(
                f"{shown}: its content does not match its checksum: it was damaged, or changed after it was "
                f"written; if the change was intended, remove its attribute {CHECKSUM} and write it again"
            )
    except OneLineError:
        raise
    except Exception as reason:  # readers raise errors of any type for damaged files
        raise OneLineError(f"{shown}: cannot be read as a dataset ({in_one_line(str(reason), 200)})") from None
    return solution_of_dataset(source, dataset, system)


def _checked(dataset: xarray.Dataset, system: Any) -> xarray.Dataset:
    """Return a dataset whose coordinates are in the order of its run; ValueError unless it describes one run."""
    content, attributes = stacked(dataset), dataset.attrs
    arrays = {
        name: StoredArray(
            tuple(map(str, array.dims)), TYPES.get(array.dtype.kind, "string"), array.shape, array.shape, array.attrs
        )
        for name, array in ((str(name), array) for name, array in content.variables.items())
        if name in (*FLOAT_ARRAYS, *ARRAY_TYPES) or name.startswith(SERIES_PREFIXES)
    }
    check_arrays(arrays, content["account"].values.tolist() if "account" in content.coords else [])
    span, step = json.loads(attributes["t_span"]), float(attributes["step"])
    times, t = times_of(span, step, int(attributes["save_every"])), content["time"].values
    try:
        saved = output_times_of(t, times)
    except ValueError as reason:
        raise ValueError(str(reason).replace("t_eval", "time")) from None
    # The last interval may be shorter, and an event may end the run at any time.
    at_steps = (saved.length[:-1] == 0.0) & (saved.number[:-1] % times.save_every == 0)
    if not (attributes["between_steps"] or at_steps.all()):
        first = float(t[int(at_steps.argmin())])
        raise ValueError(f"the time {first!r} is none at which the run saves; its times begin at {times.t0!r}")
    if "component" in dataset.coords:
        with suppress(ValueError):  # its functions were not stored
            stored = parsed(attributes["system"], "system")
            system = system_of(stored, dataset.sizes["component"]) if system is None else system
        if system is not None:
            dataset = in_order(dataset, "component", coordinate_names(system.in_numbers))
    return dataset


def _reader(path: Path) -> tuple[str, tuple[str, ...]]:
    """Return the xarray engine for a file or folder, and the packages it needs."""
    shown = in_one_line(str(path), 200)
    if path.is_dir():
        if not any((path / name).is_file() for name in ("zarr.json", ".zgroup")):
            raise OneLineError(
                f"{in_one_line(str(path), 200)}: is a folder that holds no run; give a .nc file or a .zarr folder"
            )
        return "zarr", ("xarray", "zarr")
    with open_regular(path) as file:
        signature = file.read(4)
    for known_signature, engine in FILE_SIGNATURES.items():
        if signature.startswith(known_signature):
            return engine
    raise OneLineError(f"{shown}: is no NetCDF file; give what to_xarray() or the command wrote")


@suggest_keywords
def solution_inputs(dataset: xarray.Dataset, system: Any = None, events: Any = None) -> dict[str, Any]:
    """Return the arguments of `integrate` that repeat the run of a dataset.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.
    system, events : optional
        Those of the run, if they contain Python functions, which are not stored.

    Returns
    -------
    dict
        ``integrate(**solution_inputs(dataset))``

    Raises
    ------
    TypeError
        The argument is not a dataset.
    ValueError
        Data that determine the motion were not stored, or the dataset is damaged; the message names the entry.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> solution_inputs(sol.to_xarray())["t_span"]
    (0.0, 1.0)
    """
    inputs = {**stored_inputs(dataset, system, events), "method": stored_method(dataset.attrs)}
    if _coadjoint_start(stacked(dataset)) is not None:
        raise ValueError("the run began with its own coadjoint matrix, which `integrate` does not take; use `rebuild`")
    return inputs


@suggest_keywords
def rebuild(dataset: xarray.Dataset) -> Solution:
    """Repeat the run of a dataset, bitwise, with any number of threads.

    Parameters
    ----------
    dataset : xarray.Dataset
        From `dataset_of`, or read from a file.

    Returns
    -------
    Solution
        The solution, without observed quantities, Casimirs and events that are functions.

    Raises
    ------
    ValueError
        Data that determine the motion were not stored, or the dataset is damaged; the message names the entry.
    IntegrationError
        The run fails, as it did before.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> bool((rebuild(sol.to_xarray()).x == sol.x).all())
    True
    """
    inputs = {**stored_inputs(dataset), "method": stored_method(dataset.attrs)}
    element = _coadjoint_start(stacked(dataset))
    with as_value_errors(Entry(None, "the run of this dataset")):
        if element is None:
            return integrate(**inputs)
        prepared = {name: inputs.pop(name) for name in ("system", "method", "step", "attitude", "watch", "observe")}
        return PreparedRun(**prepared).run(**inputs, attitude=element)


def _coadjoint_start(dataset: xarray.Dataset) -> NDArray[np.float64] | None:
    """Return the initial coadjoint matrix, which `integrate` does not take; None for a unit matrix or none at all."""
    if dataset.attrs["attitude_carried"] != "coadjoint":
        return None
    element = state_of(dataset, "attitude0", STATE_DIMENSIONS[1:2])
    return None if np.array_equal(element, np.broadcast_to(np.eye(element.shape[-1]), element.shape)) else element
