"""Records of runs in archives: arrays are read with all checks of the archive, on first use."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from coadjoint.files.archives.archived_run import ACCOUNTS_ATTRIBUTE, FINISHED, SAVE_EVERY, STEPS
from coadjoint.files.archives.reading import (
    ArchiveError,
    chunk_file,
    missing_chunk_error,
    open_folder,
    read_array,
    read_root,
)
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.datasets.export import stored_inputs
from coadjoint.files.datasets.named_axes import MEMBER, coordinate_variables, label_of, stored_axes, unstacked
from coadjoint.files.datasets.stored_record import stored_record
from coadjoint.memory import check_available_memory
from coadjoint.runs.results.run_record import RunRecord

if TYPE_CHECKING:
    import xarray

MayBeMissing = Callable[[str], Callable[[tuple[int, ...]], bool] | None]
"""For the name of an array, a predicate for chunks that may not be written yet; None if all chunks are committed."""


def archive_record(
    path: Path,
    arrays: Mapping[str, StoredArray],
    attributes: dict[str, Any],
    system: Any,
    functions: Mapping[str, Callable[[RunRecord], Any]],
    may_be_missing: MayBeMissing = lambda name: None,
    **values: Any,
) -> RunRecord:
    """Return the record of a run in an archive; `functions` and `values` add its own fields."""
    steps = int(attributes.get(STEPS, 0))
    # A later end replaces the last point of a run whose last interval is shorter than the others.
    replaceable = attributes[FINISHED] and steps % int(attributes.get(SAVE_EVERY, steps or 1)) > 0
    check_last_point = partial(_check_steps, path, steps) if replaceable else None

    def read_entire(name: str) -> NDArray[Any]:
        array = arrays[name]
        what = f"{name} of the archive {path}"
        check_available_memory(16 * prod(array.shape), what, f"read a part of to_xarray()[{name!r}]")
        values = read_array(path, name, array, may_be_missing=may_be_missing(name))
        if array.grows and check_last_point is not None:
            check_last_point()
        return values

    def inputs(events: Any = ()) -> dict[str, Any]:
        import xarray

        names: list[str] = [name for name in ("x0", "attitude0") if name in arrays]
        if attributes["between_steps"]:
            names.append("time")
        variables = {name: (arrays[name].dims, read_entire(name)) for name in names}
        return stored_inputs(xarray.Dataset(variables, attrs=attributes), system, events)

    def to_xarray() -> xarray.Dataset:
        import xarray

        from coadjoint.files.archives.archived_variables import ArchivedArray, variable

        coordinates = str(attributes.get("coordinates", "")).split()
        own = {name: value for name, value in attributes.items() if name != "coordinates"}
        x0 = arrays["x0"]
        axes = stored_axes(attributes, x0.shape[0] if x0.dims[0] == MEMBER else 1)
        variables: dict[str, Any] = {}
        for name, array in arrays.items():
            if array.kind == "string":
                variables[name] = (array.dims, list(map(str, read_entire(name))), dict(array.attributes))
            elif axes and name in coordinates:
                entry = {name: (array.dims, read_entire(name), dict(array.attributes))}
                variables[name] = unstacked(xarray.Dataset(coords=entry, attrs=own))[name].variable
            else:
                lazy = ArchivedArray(path, name, array, may_be_missing(name), axes, check_last_point)
                variables[label_of(name, axes)] = variable(lazy)
        variables |= coordinate_variables(axes)
        coordinates = [name for name in [*coordinates, *coordinate_variables(axes)] if name in variables]
        return xarray.Dataset(variables, attrs=own).set_coords(coordinates)

    return stored_record(
        arrays,
        attributes,
        read_entire,
        functions,
        path=path,
        accounts=tuple((force, name) for force, name in json.loads(attributes[ACCOUNTS_ATTRIBUTE])),
        events=None,
        ending=None,
        inputs=inputs,
        to_xarray=to_xarray,
        check_complete=partial(check_complete, path, arrays),
        **values,
    )


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
