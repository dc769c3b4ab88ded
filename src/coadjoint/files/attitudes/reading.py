"""Readers and writers of logs of attitudes, chosen by the format of the file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coadjoint.files.attitudes.aem import aem_text, log_of_aem
from coadjoint.files.attitudes.attitude_log import AttitudeLog
from coadjoint.files.attitudes.ck import clock_of, clock_text, write_ck
from coadjoint.files.attitudes.tables import log_of_table, log_of_tum, table_text
from coadjoint.files.ccsds import lines_of
from coadjoint.files.output.output_files import check_target, pending, write_text
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_choice, read_title

FORMATS = "csv", "tum", "aem"
SUFFIXES = {".csv": "csv", ".tum": "tum", ".aem": "aem"}
TABLES = ".csv", ".tum", ".aem"
KERNELS = (".bc",)


@suggest_keywords
def read(
    path: str | Path,
    *,
    format: str | None = None,
    columns: Mapping[str, Any] | str | None = None,
    attitude: str | None = None,
    direction: str = "body to space",
    time_unit: str | None = None,
    rates: str | bool | None = None,
    time_system: str = "UTC",
    segment: int | None = None,
) -> AttitudeLog:
    """Return the log of attitudes in a file: CSV, TUM, or an attitude ephemeris message of CCSDS (AEM).

    Parameters
    ----------
    path : str or pathlib.Path
        The file. An AEM, in keywords and values, is known by its first line; ``.csv`` and ``.tum`` by their suffix.
    format : {"csv", "tum", "aem"}, optional
        That of a file with another suffix.
    columns : mapping or str, optional
        Columns of a CSV file with other names, with a unit in brackets unless the name ends with it:
        ``{"time": "stamp[ms]", "quaternion": ["a", "b", "c", "d"], "rates": ["u[deg/s]", "v[deg/s]", "w[deg/s]"]}``,
        with the order of the quaternion by `attitude`, or one by one, ``{"t": "stamp[ms]", "qw": "a", ...}`` or
        ``"t=stamp[ms],qw=a,..."``. Text without ``=`` lists all columns in their order, with ``-`` for those to leave
        out. What is not named here is found by its name.
    attitude : {"wxyz", "xyzw"}, optional
        The order of the quaternion in a CSV file whose columns are not named ``qw, qx, qy, qz``.
    direction : {"body to space", "space to body"}
        What the quaternions of a CSV or TUM file turn: by default the components of a vector in the body into those in
        space. An AEM says it itself.
    time_unit : {"s", "ms", "us", "ns", "ps", "fs", "min", "h", "d"}, optional
        Unit of times that are numbers; times may also be dates. By default that in the name of the column, as in
        ``t [ms]`` or ``t_ms``, which may not be another one, and otherwise seconds.
    rates : {"rad/s", "deg/s", "rpm", "rev/s", "Hz", "deg/h", False}, optional
        Unit of the columns ``wx, wy, wz`` of a CSV file, the angular velocity in the body frame. It is needed if it is
        not in their names, as in ``wx [deg/s]`` or ``wx_deg_s``, nor in the comment that `write` makes. With False
        they are not read.
    time_system : {"UTC", "UT1", "TAI", "GPS", "TT", "TDB"}
        That of dates in a CSV file.
    segment : int, optional
        Number of the segment of an AEM with several, from 0 on.

    Returns
    -------
    AttitudeLog
        With rotations from the body to space. Of a file with dates its first one is t = 0. The names of the frames
        and the epoch are those of an AEM, or of the comments that `write` makes in a CSV file.

    Raises
    ------
    ValueError, TypeError
        A file that cannot be read, with its line; a quaternion whose order is not known, or that is not of length 1;
        rates whose unit is not known; units that contradict each other; times that do not ascend.

    Notes
    -----
    CCSDS 504.0-B-2, Attitude Data Messages (2024), and the first issue, of which quaternions are read.

    Examples
    --------
    >>> import coadjoint as co
    >>> log = co.attitudes.read("log.csv", attitude="wxyz")  # doctest: +SKIP
    >>> found = co.fit(ready, x0, log.t_span, {"attitude": log.rotation}, {"inertia": (0, 2)}, t_eval=log.t,
    ...     sigma={"attitude": 1e-3})  # doctest: +SKIP
    """
    file, lines = lines_of(path)
    kind = format
    if kind is None:
        kind = "aem" if lines[0].text.startswith(("CCSDS_AEM", "<")) else SUFFIXES.get(file.suffix.lower())
    if kind is None:
        raise ValueError(f"{file}: the suffix {short(file.suffix)} does not say the format; give format='csv' or 'tum'")
    if read_choice(kind, "format", FORMATS) == "aem":
        given = {
            "columns": (columns, None),
            "attitude": (attitude, None),
            "rates": (rates, None),
            "direction": (direction, "body to space"),
        }
        for name, (value, default) in given.items():
            if value != default:
                raise ValueError(f"{name} is {short(value)}, and an AEM says it itself; leave it out")
        return log_of_aem(file, lines, segment)
    if segment is not None:
        raise ValueError(f"segment is {short(segment)}, and a table has none; leave it out")
    if kind == "tum":
        if columns is not None:
            raise ValueError("columns was given, and those of the format TUM are known; leave it out")
        if rates not in (None, False):
            raise ValueError("rates was given, and the format TUM has none; leave it out")
        return log_of_tum(file, lines, attitude, direction, time_unit)
    return log_of_table(file, lines, columns, attitude, direction, time_unit, rates, time_system)


@suggest_keywords
def write(
    path: str | Path,
    log: AttitudeLog,
    *,
    object_name: str = "UNKNOWN",
    object_id: str = "UNKNOWN",
    originator: str = "coadjoint",
    instrument: int | None = None,
) -> None:
    """Write a log of attitudes: ``.csv``, ``.tum``, ``.aem`` (CCSDS, version 2), or ``.bc``, a C-kernel of SPICE.

    Parameters
    ----------
    path : str or pathlib.Path
        The file, whose suffix sets the format; it is replaced atomically.
    log : AttitudeLog
        For an AEM and a kernel with a frame and an epoch.
    object_name, object_id, originator : str
        What an AEM names.
    instrument : int, optional
        Of a kernel, the NAIF number of the structure whose attitude it is, such as -999000 of the spacecraft -999. The
        kernel of its clock, in microseconds from the first attitude on, is written beside it with the suffix ``.tsc``.

    Raises
    ------
    MissingPackageError
        A kernel without the package spiceypy.
    ValueError, TypeError
        A log without a frame or an epoch, a frame that SPICE does not know, or another suffix.

    Examples
    --------
    >>> import os, tempfile
    >>> import coadjoint as co
    >>> sat = co.systems.body((1.0, 2.0, 2.5))
    >>> sol = co.integrate(sat, sat.state(angular_velocity=(0.1, 0.2, 0.3)), (0, 10), 0.5)
    >>> log = co.attitudes.AttitudeLog.of(sol, frame="J2000", epoch="2026-03-01T00:00:00")
    >>> path = os.path.join(tempfile.mkdtemp(), "attitude.aem")
    >>> co.attitudes.write(path, log)
    >>> again = co.attitudes.read(path)
    >>> bool((again.rotation * log.rotation.inv()).magnitude().max() < 1e-14)
    True
    """
    if not isinstance(log, AttitudeLog):
        raise TypeError(f"log is {short(log)}; give a co.attitudes.AttitudeLog, such as AttitudeLog.of(solution)")
    target = check_target(path, (*TABLES, *KERNELS))
    if target.suffix in KERNELS:
        if instrument is None:
            raise ValueError("instrument was not given; give a NAIF number, such as -999000 of the spacecraft -999")
        clock = target.with_suffix(".tsc")
        check_target(clock, (".tsc",))
        clock_of(instrument)
        with pending(target) as unfinished:
            write_ck(log, unfinished.path, int(instrument))
        write_text(clock_text(log, int(instrument)), clock, (".tsc",))
        return
    if target.suffix == ".aem":
        named = {"object_name": object_name, "object_id": object_id, "originator": originator}
        text = aem_text(log, *(read_title(value, name) for name, value in named.items()))
    else:
        text = table_text(log, target.suffix == ".tum")
    write_text(text, target, TABLES)
