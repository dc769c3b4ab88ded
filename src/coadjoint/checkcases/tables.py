"""Samples of others: tables from CSV, Parquet and NetCDF files, and the assignment of their columns."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.errors import unknown_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import open_regular
from coadjoint.short_repr import short
from coadjoint.validation import read_path, to_array

Floats = npt.NDArray[np.float64]

MAX_BYTES = 2**30  # of a file of samples: some ten million rows
MAX_COLUMNS = 10_000
MAX_NAME_LENGTH = 200  # characters of the name of a column
MEMORY_FACTOR = 12  # lines as Python text and their numbers, beside the bytes of a CSV file
SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".nc")

UNITS = {
    "rad/s": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180,
        "rpm": math.pi / 30,
        "rev/s": 2 * math.pi,
        "Hz": 2 * math.pi,
        "deg/h": math.pi / 648000,
    },
    "s": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1e-9,
        "ps": 1e-12,
        "fs": 1e-15,
        "min": 60.0,
        "h": 3600.0,
        "d": 86400.0,
    },
    "m": {"m": 1.0, "km": 1e3, "nm": 1e-9, "ft": 0.3048, "angstrom": 1e-10},
    "m/s": {"m/s": 1.0, "km/s": 1e3, "ft/s": 0.3048},
    "1": {"1": 1.0},
    "1/s": {"1/s": 1.0},
}
"""SI unit -> units that are converted to it, with their sizes."""

ALIASES: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("t",), ("t", "time", "times", "seconds", "simtime", "elapsedtime")),
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
        with open_regular(file) as opened:
            size = os.fstat(opened.fileno()).st_size
            if size > MAX_BYTES:
                raise ValueError(f"{path}: has {size} bytes; give at most {MAX_BYTES}, such as every tenth sample")
            if file.suffix.lower() not in (".parquet", ".nc"):
                check_available_memory(MEMORY_FACTOR * size, f"the samples of {path}")
                return _read_csv(opened.read().decode("utf-8-sig"), str(path))
        return (_read_parquet if file.suffix.lower() == ".parquet" else _read_netcdf)(file)
    except OSError as reason:
        raise ValueError(f"{path}: cannot be read ({reason.strerror or reason}); give another file") from None
    except UnicodeDecodeError as reason:
        raise ValueError(f"{path}: is no text in UTF-8 ({reason.reason} at byte {reason.start})") from None


def _read_csv(text: str, path: str) -> dict[str, Floats]:
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] not in "#%"]
    if not lines:
        raise ValueError(f"{path}: has no line of numbers")
    delimiter = next((mark for mark in (",", ";", "\t") if mark in lines[0][1]), None)
    first = _fields(lines[0][1], delimiter)
    header = any(not _is_number(entry) for entry in first)
    names = first if header else [str(k + 1) for k in range(len(first))]
    if len(names) > MAX_COLUMNS:
        raise ValueError(f"{path}: has {len(names)} columns; give at most {MAX_COLUMNS}")
    if any(len(name) > MAX_NAME_LENGTH for name in names):
        raise ValueError(f"{path}: the name of a column has more than {MAX_NAME_LENGTH} characters; give a shorter one")
    rows = lines[header:]
    if not rows:
        raise ValueError(f"{path}: has a line of names and no line of numbers")
    values = np.empty((len(rows), len(names)))
    for k, (number, line) in enumerate(rows):
        fields = _fields(line, delimiter)
        if len(fields) != len(names):
            raise ValueError(f"{path}, line {number}: has {len(fields)} fields, and the first has {len(names)}")
        try:
            if "_" in line:
                raise ValueError
            values[k] = [float(entry) if entry else math.nan for entry in fields]
        except ValueError:
            wrong = next(entry for entry in fields if entry and not _is_number(entry))
            hint = "; write decimal points" if delimiter == ";" and "," in wrong else ""
            raise ValueError(f"{path}, line {number}: {short(wrong)} is no number{hint}") from None
    repeated = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if repeated is not None:
        raise ValueError(f"{path}: two columns have the name {short(repeated)}; rename one")
    return dict(zip(names, values.T.copy(), strict=True))


def _fields(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    if '"' in line:
        return [entry.strip() for entry in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    return [entry.strip() for entry in line.rstrip("\r\n").split(delimiter)]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # which Python allows between digits


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
    sources = _given_sources(raw, needed, given)
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
        factor = _factor(column, name, unit or _unit_of(name)[1], needed[column])
        values = to_array(raw[name], f"column {short(name)}")
        if values.ndim != 1:
            raise ValueError(f"column {short(name)} has shape {values.shape}; give one number a sample, (k,)")
        result[column] = np.asarray(values, dtype=np.float64) * factor
        if name != column or factor != 1.0:
            converted = f" (converted from {unit or _unit_of(name)[1]})" if factor != 1.0 else ""
            notes.append(f"{column} is {short(name)}{converted}")
    if "t" not in result:
        raise ValueError(f"no column is the time t; there are {_listed(raw)}: name it by columns t=NAME")
    result.notes = tuple(notes)
    used = {name for name, _ in sources.values()}
    result.unused = tuple(str(name) for name in raw if name not in used)
    return result


def _refuse_unordered_quaternion(
    raw: Mapping[str, Any], needed: Mapping[str, str], sources: Mapping[str, tuple[str, str]]
) -> None:
    """Refuse four numbers q1 to q4, unless the user named the columns of the attitude or others hold it."""
    plain = {_plain(str(name)): str(name) for name in raw}
    if "qw" not in needed or "qw" in sources or not plain.keys() >= set(UNORDERED):
        return
    q1, q2, q3, q4 = (plain[name] for name in UNORDERED)
    raise ValueError(
        f"{q1}, {q2}, {q3}, {q4} are a quaternion of unknown order, since programs differ about which one is the "
        f"scalar; give columns qw={q4},qx={q1},qy={q2},qz={q3} if {q4} is, qw={q1},qx={q2},qy={q3},qz={q4} if {q1} "
        "is, or all names of columns in their order with - for these, to leave them out"
    )


def _plain(name: str) -> str:
    """Return a name in lower case without unit and signs."""
    return re.sub(r"[^a-z0-9]", "", _unit_of(name)[0].lower())


def _listed(names: Any) -> str:
    return short(", ".join(map(str, names)))


def _given_sources(
    raw: Mapping[str, Any], needed: Mapping[str, str], given: Mapping[str, str] | str | None
) -> dict[str, tuple[str, str]]:
    """Return the columns that the user named: column -> (name in the table, unit or "")."""
    sources: dict[str, tuple[str, str]] = {}
    for column, text in () if given is None else _pairs_of(given, tuple(raw)):
        if column not in needed:
            raise unknown_name("column", column, needed)
        name, unit = (text, "") if text in raw else _unit_of(text)
        if name not in raw:
            raise ValueError(
                f"columns: {short(column)}={short(text)}, and the table has no column {short(name)}; it has "
                f"{_listed(raw)}"
            )
        if column in sources or any(name == other for other, _ in sources.values()):
            raise ValueError(f"columns: {short(column)}={short(text)} names a column again; name each once")
        sources[column] = name, unit
    return sources


def _pairs_of(given: Any, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return pairs of a column of the case and a name in the table, with a unit in brackets if one was given."""
    if hasattr(given, "items"):
        return [(str(column), str(name)) for column, name in given.items()]
    try:
        entries = [entry.strip() for entry in str.split(given, ",") if entry.strip()]
    except TypeError:
        raise TypeError(f"columns is {short(given)}; give a mapping of names, or text such as wx=p[deg/s]") from None
    if any("=" in entry for entry in entries):
        return [(left.strip(), right.strip()) for left, _, right in (entry.partition("=") for entry in entries)]
    if len(entries) != len(names):
        raise ValueError(f"columns names {len(entries)} columns in their order; the table has {len(names)}")
    split = [(*_unit_of(entry), name) for entry, name in zip(entries, names, strict=True) if entry != "-"]
    return [(column, f"{name}[{unit}]" if unit else name) for column, unit, name in split]


def _unit_of(name: str) -> tuple[str, str]:
    """Split a name with a unit in brackets, such as "p [deg/s]"."""
    text = name.strip()
    begin = max(text.rfind("["), text.rfind("("))
    if text.endswith(("]", ")")) and begin >= 0:
        return text[:begin].rstrip(), text[begin + 1 : -1].strip()
    lower = name.lower()
    for part, unit in (("_deg_sec", "deg/s"), ("_rad_sec", "rad/s"), ("_deg_s", "deg/s"), ("_rad_s", "rad/s")):
        if lower.endswith(part) or f"{part}_" in lower:  # as in bodyAngularRateWrtEi_deg_s_Roll
            place = lower.find(part)
            return name[:place] + name[place + len(part) :], unit
    return name, ""


def _factor(column: str, name: str, unit: str, si: str) -> float:
    """Return the size of a unit; refuse one that is not a unit of this quantity."""
    if unit in ("", si, "-"):
        return 1.0
    known = UNITS.get(si, {si: 1.0})
    if unit not in known:
        raise ValueError(f"{column}: {short(name)} has the unit {short(unit)}; give one of {', '.join(known)}")
    return known[unit]


def _matched_sources(raw: Mapping[str, Any], needed: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return the columns that are found by their names, exact ones first; groups are complete or left out."""
    plain: dict[str, list[str]] = {}
    for name in raw:
        plain.setdefault(_plain(str(name)), []).append(str(name))
    found: dict[str, tuple[str, str]] = {}
    for column in needed:
        exact = [name for name in raw if _unit_of(str(name))[0].strip() == column]
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
            raise ValueError(f"{', '.join(columns)} could be {several}; name them by columns {columns[0]}=NAME")
        for alias in complete:
            found |= {column: (plain[word][0], "") for column, word in zip(columns, alias, strict=True)}
    return found


def _alternatives(entry: str, count: int) -> Iterator[tuple[str, ...]]:
    words = tuple(entry.split())
    if len(words) == count:
        yield words
