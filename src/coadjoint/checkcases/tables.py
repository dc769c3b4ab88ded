"""Samples of others: tables from CSV, Parquet and NetCDF files, and the assignment of their columns."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.files.ccsds import MAX_BYTES, lines_of
from coadjoint.files.columns import (
    MAX_COLUMNS,
    TextTable,
    bare,
    given_columns,
    is_number,
    split_unit,
    text_table,
    unit_size,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import open_regular
from coadjoint.short_repr import short
from coadjoint.validation import read_path, to_array

Floats = npt.NDArray[np.float64]

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".nc")

ALIASES: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("t",), ("t", "time", "times", "timestamp", "seconds", "simtime", "elapsedtime")),
    (("wx", "wy", "wz"), ("wx wy wz", "omegax omegay omegaz", "omega1 omega2 omega3", "w1 w2 w3", "p q r")),
    (("wx", "wy", "wz"), ("gyrox gyroy gyroz", "ratex ratey ratez", "omegaxbody omegaybody omegazbody")),
    (("wx", "wy", "wz"), ("angularvelocityx angularvelocityy angularvelocityz", "angvelx angvely angvelz")),
    (("qw", "qx", "qy", "qz"), ("qw qx qy qz", "quatw quatx quaty quatz", "q0 q1 q2 q3")),
    (("qw", "qx", "qy", "qz"), ("orientationw orientationx orientationy orientationz",)),
)
"""Columns of a case and names under which they are found, without units and signs."""

UNORDERED = ("q1", "q2", "q3", "q4")
"""Names of a quaternion that are refused: programs differ about which one is the scalar."""


@suggest_keywords
def read_table(path: str | Path) -> dict[str, Floats]:
    r"""Read the columns of a file of samples: CSV, Parquet or NetCDF.

    Nothing in the file is executed, and it is bounded in size. `CheckCase.compare` reads files by it.

    Parameters
    ----------
    path : str or Path
        CSV with the suffix ``.csv``, ``.txt``, ``.tsv`` or ``.dat``: numbers separated by commas, semicolons, tabs or
        spaces, lines of comments that start with ``#`` or ``%``, and a line of names, or none. ``.parquet`` needs
        pyarrow, and ``.nc`` (NetCDF 4) xarray and h5netcdf.

    Returns
    -------
    dict
        From names to arrays (k,). Columns of a CSV file without a line of names are ``"1"``, ``"2"``, ...

    Raises
    ------
    ValueError
        The file cannot be read, is too large, or is no table of numbers; with file and row.
    MissingPackageError
        The package of its format is not installed.

    Examples
    --------
    >>> import tempfile, pathlib, coadjoint as co
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "mine.csv")
    ...     _ = file.write_text("# a comment\ntime, wx\n0, 1.5\n0.1, 1.25\n")
    ...     co.checkcases.read_table(file)["wx"]
    array([1.5 , 1.25])
    """
    file = read_path(path, "path")
    if file.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{short(path)}: the suffix must be one of {', '.join(SUFFIXES)}; rename or convert the file")
    try:
        if file.suffix.lower() in (".parquet", ".nc"):
            with open_regular(file) as opened:
                size = os.fstat(opened.fileno()).st_size
            if size > MAX_BYTES:
                raise ValueError(f"{path}: has {size} bytes; give at most {MAX_BYTES}, such as every tenth sample")
            return (_read_parquet if file.suffix.lower() == ".parquet" else _read_netcdf)(file)
        return _numbers_of(str(path), text_table(str(path), lines_of(file)[1]))
    except OSError as reason:
        raise ValueError(f"{path}: cannot be read ({reason.strerror or reason}); give another file") from None


def _numbers_of(path: str, table: TextTable) -> dict[str, Floats]:
    """Return the columns of a table as numbers, NaN for empty cells; without names they are "1", "2", ..."""
    names = table.names or [str(k + 1) for k in range(len(table.rows[0]))]
    values = np.empty((len(table.rows), len(names)))
    for k, row in enumerate(table.rows):
        wrong = next((cell for cell in row if cell and not is_number(cell)), None)
        if wrong is not None:
            hint = "; write decimal points" if "," in wrong else ""
            raise ValueError(f"{path}, line {table.numbers[k]}: {short(wrong)} is no number{hint}")
        values[k] = [float(cell) if cell else math.nan for cell in row]
    return dict(zip(names, values.T.copy(), strict=True))


def _read_parquet(file: Path) -> dict[str, Floats]:
    require_packages(f"{file}: Parquet", "pyarrow")
    import pyarrow
    from pyarrow import parquet

    try:
        opened = parquet.ParquetFile(file)
        rows, kinds = opened.metadata.num_rows, {field.name: field.type for field in opened.schema_arrow}
        names = [
            name for name, kind in kinds.items() if pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind)
        ]
        if len(names) > MAX_COLUMNS or 8 * rows * len(names) > MAX_BYTES:
            raise ValueError(f"{file}: has {rows} rows of {len(names)} columns; give at most {MAX_BYTES} bytes")
        table = opened.read(columns=names)
        return {name: np.asarray(table.column(name).to_numpy(), dtype=np.float64) for name in names}
    except pyarrow.ArrowException as reason:
        raise ValueError(f"{file}: is no table of Parquet ({str(reason).partition(chr(10))[0]})") from None


def _read_netcdf(file: Path) -> dict[str, Floats]:
    require_packages(f"{file}: NetCDF", "xarray", "h5netcdf", "h5py")
    import xarray

    try:
        dataset = xarray.open_dataset(file, engine="h5netcdf", decode_times=False)
    except Exception as reason:  # a damaged file raises arbitrary errors of HDF5
        raise ValueError(f"{file}: is no NetCDF file ({type(reason).__name__}); give NetCDF 4") from None
    with dataset:
        found = columns_of_dataset(dataset, str(file))
    if not found:
        raise ValueError(f"{file}: has no variable of one dimension with numbers")
    return found


def columns_of_dataset(dataset: Any, where: str) -> dict[str, Floats]:
    """Return the variables and coordinates of one dimension in a dataset of xarray, with their units in brackets."""
    found: dict[str, Floats] = {}
    for name, variable in dataset.variables.items():
        if variable.ndim != 1 or variable.dtype.kind not in "iuf":
            continue
        if 8 * variable.size > MAX_BYTES:
            raise ValueError(f"{where}: {short(str(name))} has {variable.size} values; give at most {MAX_BYTES // 8}")
        unit = str(variable.attrs.get("units", ""))
        found[f"{name} [{unit}]" if unit else str(name)] = np.asarray(variable.to_numpy(), dtype=np.float64)
    return found


class AssignedColumns(dict[str, Floats]):
    """Columns of a case from those of others.

    `notes` says which were taken and how they were converted; `unused` are columns that were not recognized, and
    `is_chosen` is whether the user named the quantities to compare.
    """

    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    is_chosen: bool = False


def assign_columns(
    raw: Mapping[str, Any], needed: Mapping[str, str], given: Mapping[str, str] | str | None
) -> AssignedColumns:
    """Return the columns of a case, by name with their SI units, that are among those of others, in SI units."""
    sources = given_columns([str(name) for name in raw], needed, given)
    # Text without "=" has an entry for every column, so that each column was considered.
    is_complete = given is not None and not hasattr(given, "items") and "=" not in given
    result = AssignedColumns()
    result.is_chosen = is_complete or any(column != "t" for column in sources)
    for column, source in _matched_sources(raw, needed).items():
        sources.setdefault(column, source)
    if not is_complete:
        _refuse_unordered_quaternion(raw, needed, sources)
    notes = []
    for column, (name, unit) in sources.items():
        factor = unit_size(column, name, unit or split_unit(name)[1], needed[column])
        values = to_array(raw[name], f"column {short(name)}")
        if values.ndim != 1:
            raise ValueError(f"column {short(name)} has shape {values.shape}; give one number a sample, (k,)")
        result[column] = np.asarray(values, dtype=np.float64) * factor
        if name != column or factor != 1.0:
            converted = f" (converted from {unit or split_unit(name)[1]})" if factor != 1.0 else ""
            notes.append(f"{column} is {short(name)}{converted}")
    if "t" not in result:
        raise ValueError(
            f"no column is the time t; there are {_listed(raw)}; name it by columns= (--columns), such as t=NAME"
        )
    result.notes = tuple(notes)
    used = {name for name, _ in sources.values()}
    result.unused = tuple(str(name) for name in raw if name not in used)
    return result


def _refuse_unordered_quaternion(
    raw: Mapping[str, Any], needed: Mapping[str, str], sources: Mapping[str, tuple[str, str]]
) -> None:
    """Refuse four numbers q1 to q4, unless the user named the columns of the attitude or others hold it."""
    plain = {bare(str(name)): str(name) for name in raw}
    if "qw" not in needed or "qw" in sources or not plain.keys() >= set(UNORDERED):
        return
    q1, q2, q3, q4 = (plain[name] for name in UNORDERED)
    raise ValueError(
        f"{q1}, {q2}, {q3}, {q4} are a quaternion of unknown order, since programs differ about which one is the "
        f"scalar; give columns= (--columns) qw={q4},qx={q1},qy={q2},qz={q3} if {q4} is, "
        f"qw={q1},qx={q2},qy={q3},qz={q4} if {q1} is, or all names of columns in their order with - for these, "
        "to leave them out"
    )


def _listed(names: Any) -> str:
    return short(", ".join(map(str, names)))


def _matched_sources(raw: Mapping[str, Any], needed: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the columns that are found by their names, exact ones first; groups are complete or left out."""
    plain: dict[str, list[str]] = {}
    for name in raw:
        plain.setdefault(bare(str(name)), []).append(str(name))
    found: dict[str, tuple[str, str]] = {}
    for column in needed:
        exact = [name for name in raw if split_unit(str(name))[0].strip() == column]
        if len(exact) == 1:
            found[column] = exact[0], ""
    for columns, aliases in ALIASES:
        if any(column not in needed or column in found for column in columns):
            continue
        complete = [
            alias
            for entry in aliases
            for alias in _alternatives(entry, len(columns))
            if all(len(plain.get(word, ())) == 1 for word in alias)
        ]
        if len(complete) > 1:
            several = " and ".join(" ".join(plain[word][0] for word in alias) for alias in complete)
            raise ValueError(
                f"{', '.join(columns)} could be {several}; name them by columns= (--columns), such as {columns[0]}=NAME"
            )
        for alias in complete:
            found |= {column: (plain[word][0], "") for column, word in zip(columns, alias, strict=True)}
    return found


def _alternatives(entry: str, count: int) -> Iterator[tuple[str, ...]]:
    words = tuple(entry.split())
    if len(words) == count:
        yield words
