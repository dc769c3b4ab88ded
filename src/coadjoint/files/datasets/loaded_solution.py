"""Solutions read from files: `load`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import OneLineError, in_one_line
from coadjoint.files.archives.archived_solution import open_archive
from coadjoint.files.archives.reading import HIDDEN_FOLDER
from coadjoint.files.datasets.content_checksum import CHECKSUM, checksum_of
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE, REQUIRED_ATTRIBUTES, events_of_dataset, stored_inputs
from coadjoint.files.datasets.named_axes import stacked
from coadjoint.files.datasets.stored_record import initial_values, stored_record
from coadjoint.files.output.file_validation import check_hdf5, check_zarr
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.runs.events import RecordedEvents, TerminalEvent
from coadjoint.runs.results.run_record import RunRecord, Statistics
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.batch import SUFFIX
from coadjoint.systems.protocol import coordinates_of, member_of
from coadjoint.validation import read_path

if TYPE_CHECKING:
    import xarray

FILE_SIGNATURES = {b"\x89HDF": ("h5netcdf", ("xarray", "h5netcdf", "h5py")), b"CDF": ("scipy", ("xarray", "scipy"))}
"""File signatures, with the xarray engine and the packages it needs."""

RUN_VARIABLES = ("x", "x0", "energy", "time", "invariant")
"""Variables of every run."""


class LoadError(OneLineError):
    """A file or folder contains no readable run."""


def solution_of_dataset(path: Path, dataset: xarray.Dataset, system: Any = None) -> Solution:
    """Return the solution in a dataset that was read from a file into memory; `system` replaces the stored one."""
    content, dataset = dataset, stacked(dataset)
    arrays = {
        str(name): SimpleNamespace(dims=values.dims, attributes=values.attrs)
        for name, values in dataset.variables.items()
    }
    accounts = list(map(str, dataset["account"].values)) if "account" in arrays else []
    names = list(map(str, dataset["invariant"].values)) if accounts else []

    def inputs(events: Any = ()) -> dict[str, Any]:
        return stored_inputs(dataset, system, events)

    record = stored_record(
        arrays,
        dict(dataset.attrs),
        lambda name: np.asarray(dataset[name].values),
        {"initial": _initial, "ending": _ending, "stats": _stats, "worst": _worst, "events": _events},
        path=path,
        dataset=content,
        accounts=tuple(_split_account(label, names) for label in accounts),
        inputs=inputs,
        to_xarray=content.copy,
        reopen=(solution_of_dataset, (path, content, system)),
    )
    return Solution(record)


def _initial(record: RunRecord) -> Mapping[str, Any]:
    t0 = record.times.t0
    if record.t[0] == t0:
        return initial_values(record)
    # The start is not among the saved times.
    if record.failed is None:
        return _invariants_at(record.system, record.x0, t0)
    member_invariants = [_invariants_at(member_of(record.system, m), x, t0) for m, x in enumerate(record.x0)]
    return {name: np.array([invariants[name] for invariants in member_invariants]) for name in record.names}


def _ending(record: RunRecord) -> TerminalEvent | None:
    if ENDED_ATTRIBUTE not in record.attributes:
        return None
    values = np.array([record.energy[-1], *(series[-1] for series in record.casimirs.values())])
    attitude = None if record.attitude is None else record.attitude[-1]
    steps = int(record.attributes[ENDED_ATTRIBUTE])
    return TerminalEvent(len(record.t), steps, float(record.t[-1]), record.x[-1], values, attitude)


def _stats(record: RunRecord) -> Statistics:
    attributes = record.attributes
    steps = int(attributes[ENDED_ATTRIBUTE if ENDED_ATTRIBUTE in attributes else "steps"])
    work = int(attributes["evaluations"]), int(attributes["iterations"])
    return Statistics(steps, *work, float(attributes["seconds"]), float(attributes.get("elapsed", np.nan)))


def _worst(record: RunRecord) -> NDArray[np.float64]:
    names = ("change", "balance") if "change" in record.arrays else ("drift",)
    return np.concatenate([np.moveaxis(record.read(name), -2, -1) for name in names], axis=-1)


def _events(record: RunRecord) -> RecordedEvents | None:
    if "event_time" not in record.arrays:
        return None
    system: Any = record.system
    events = events_of_dataset(record.dataset, system)
    t, x, event_index, member, direction = (
        record.read(f"event_{name}") for name in ("time", "x", "which", "member", "direction")
    )
    attitude = record.read("event_attitude") if "event_attitude" in record.arrays else None
    names = tuple(str(event.name) for event in events)
    return RecordedEvents(names, t, x, event_index, member, direction, attitude, coordinates_of(system), events)


def _split_account(text: str, invariants: list[str]) -> tuple[str, str]:
    """Split the label of an account into force and invariant; both names may contain the separator.

    Examples
    --------
    >>> _split_account("drag: on x: C: 2", ["energy", "2", "C: 2"])
    ('drag: on x', 'C: 2')
    """
    ending = text.rpartition(": ")[2]
    name = max((name for name in invariants if text.endswith(f": {name}")), key=len, default=ending)
    return text[: -len(name) - 2], name


def _invariants_at(system: Any, x: NDArray[Any], t: float) -> dict[str, Any]:
    """Return the energy and the Casimirs of one state."""
    return {"energy": system.energy(x, t)} | {name: function(x) for name, function in system.casimirs.items()}


@suggest_keywords
def load(path: str | Path, system: Any = None) -> Solution:
    """Open a run that was written to a file or a folder.

    Files written by ``sol.to_xarray().to_netcdf(path)``, ``to_zarr`` and `coadjoint run` are read into memory; an
    archive is read lazily, as by `open_archive`.

    Parameters
    ----------
    path : str or Path
        A file ``.nc``, a folder ``.zarr``, or an archive. The kind is detected from the content, not from the name.
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
    source = read_path(path, "path")
    shown = in_one_line(str(source), 200)
    try:
        if (source / HIDDEN_FOLDER).is_dir():
            return open_archive(source, system)
        engine, packages = _reader(source)
    except (OSError, ValueError) as reason:
        if isinstance(reason, OneLineError):
            raise
        raise LoadError(f"{shown}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
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
                raise LoadError(f"{shown}: holds no run; it was not written by this library")
            check_available_memory(2 * opened.nbytes, f"{shown}: the run in it", "read parts of it with xarray")
            dataset = opened.load()
        checksum = dataset.attrs.get(CHECKSUM)
        if checksum is not None and checksum != checksum_of(dataset):
            raise LoadError(
                f"{shown}: its content does not match its checksum: it was damaged, or changed after it was "
                f"written; if the change was intended, remove its attribute {CHECKSUM} and write it again"
            )
    except LoadError:
        raise
    except Exception as reason:  # readers raise errors of any type for damaged files
        raise LoadError(f"{shown}: cannot be read as a dataset ({in_one_line(str(reason), 200)})") from None
    return solution_of_dataset(source, dataset, system)


def _reader(path: Path) -> tuple[str, tuple[str, ...]]:
    """Return the xarray engine for a file or folder, and the packages it needs."""
    shown = in_one_line(str(path), 200)
    if path.is_dir():
        if not any((path / name).is_file() for name in ("zarr.json", ".zgroup")):
            raise LoadError(
                f"{in_one_line(str(path), 200)}: is a folder that holds no run; give a .nc file or a .zarr folder"
            )
        return "zarr", ("xarray", "zarr")
    if path.exists() and not path.is_file():
        raise LoadError(f"{shown}: is no file and no folder")
    with open(path, "rb", opener=_open_nonblocking) as file:
        signature = file.read(4)
    for known_signature, engine in FILE_SIGNATURES.items():
        if signature.startswith(known_signature):
            return engine
    raise LoadError(f"{shown}: is no NetCDF file; give what to_xarray() or the command wrote")


def _open_nonblocking(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
