"""Logs of attitudes as tables: CSV with or without names of columns, and TUM."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.attitudes.attitude_log import AttitudeLog, Floats, rotations_of
from coadjoint.files.ccsds import TextLine, ascending, elapsed, numbers_of
from coadjoint.files.columns import (
    TIMES,
    UNITS,
    TextTable,
    bare,
    given_columns,
    is_number,
    split_unit,
    text_table,
    unit_size,
)
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.validation import read_choice

ORDERS = {"wxyz": (1, 2, 3, 0), "xyzw": (0, 1, 2, 3)}
DIRECTIONS = "body to space", "space to body"
QUATERNION = "qx", "qy", "qz", "qw"
NAMED = (QUATERNION, ("x", "y", "z", "w"), ("q_x", "q_y", "q_z", "q_w"), ("q1", "q2", "q3", "qc"))
"""Names of the components x, y, z, w of quaternions."""
NUMBERED = ("q0", "q1", "q2", "q3"), ("q1", "q2", "q3", "q4")
RATES = ("wx", "wy", "wz"), ("omega_x", "omega_y", "omega_z"), ("p", "q", "r"), ("gx", "gy", "gz")
COLUMNS = {"t": "s", **dict.fromkeys(QUATERNION, "1"), **dict.fromkeys(RATES[0], "rad/s")}
"""Columns of a log that users name, and their SI units."""
RATES_NOTE = "# angular velocity in the body frame, "
"""Comment before the unit of the rates, in files that are written here."""
FRAMES_NOTE, SECONDS_NOTE, EPOCH_NOTE = "# attitude from the body, ", "; t in seconds", "# t = 0 at "
"""Comments with the names of the frames and the date of t = 0, in files that are written here."""
GROUPS = "time", "quaternion", "rates"
TUM = "timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"
ADVICE = "give attitude='wxyz' if the scalar part is the first one, and attitude='xyzw' if it is the last"


def log_of_table(
    file: Path,
    lines: Sequence[TextLine],
    columns: Any,
    attitude: Any,
    direction: Any,
    time_unit: Any,
    rates: Any,
    time_system: Any,
) -> AttitudeLog:
    """Return the attitudes in a CSV file."""
    table = text_table(str(file), lines)
    width = len(table.rows[0])
    titles = table.names or [str(k + 1) for k in range(width)] * (columns is not None)
    try:
        given = given_columns(titles, COLUMNS, _expanded(columns, attitude))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    split = [split_unit(title) for title in titles]
    names, units = [name.lower() for name, _ in split], [unit for _, unit in split]
    found = {column: titles.index(name) for column, (name, _) in given.items()}
    for column, (_, unit) in given.items():
        units[found[column]] = unit or units[found[column]]
    if not {*found} >= {*QUATERNION}:
        _refuse_parts(file, found, QUATERNION)
        found |= zip(QUATERNION, _quaternion_columns(file, names, width, attitude), strict=True)
    if "t" not in found:
        of_time = next((k for k, title in enumerate(titles) if bare(title) in TIMES), None) if titles else 0
        if of_time is None:
            raise ValueError(
                f"{file}: no column is named {', '.join(TIMES)}, but {', '.join(map(short, names))}; name it by "
                "columns=, such as columns='t=NAME'"
            )
        found["t"] = of_time
    omega, of_rates = None, [found[name] for name in RATES[0] if name in found]
    if not of_rates:
        of_rates = _rate_columns(file, names, rates)
    _refuse_parts(file, found, RATES[0])
    for k in {found["t"], *of_rates, *(found[name] for name in QUATERNION)}:
        if titles and names.count(names[k]) > 1 and titles[k] not in [name for name, _ in given.values()]:
            raise ValueError(f"{file}: several columns are named {short(names[k])}, in other units; rename all but one")
    places = [f"{file}, line {number}" for number in table.numbers]
    texts = [row[found["t"]] for row in table.rows]
    t, epoch = _times(texts, places, units[found["t"]] if titles else "", time_unit, time_system)
    ascending(t, lambda k: places[k])
    if of_rates and rates is not False:
        noted = {line.removeprefix(RATES_NOTE) for line in table.comments if line.startswith(RATES_NOTE)}
        unit = _rate_unit(file, [titles[k] for k in of_rates], {units[k] for k in of_rates}, noted, rates)
        omega = UNITS["rad/s"][unit] * _numbers(table, of_rates, places)
    rotation = rotations_of(_numbers(table, [found[name] for name in QUATERNION], places), lambda k: places[k])
    body, frame, noted_epoch = _noted_frames(table.comments, str(file))
    if body and read_choice(direction, "direction", DIRECTIONS) != DIRECTIONS[0]:
        raise ValueError(f"{file}: direction is {short(direction)}, and a comment says {DIRECTIONS[0]}; leave it out")
    if epoch is not None and noted_epoch is not None:
        raise ValueError(f"{file} has dates and a comment with the date of t = 0; remove the comment")
    known = {"body": body} if body else {}
    return AttitudeLog(t, turned(rotation, direction), omega, frame, epoch=epoch or noted_epoch, **known)


def _expanded(columns: Any, attitude: Any) -> Any:
    """Return names of columns one by one, from those that name the time, the quaternion and the rates as groups."""
    if not hasattr(columns, "items"):
        return columns
    is_first = attitude is not None and read_choice(attitude, "attitude", ORDERS) == "wxyz"
    order = ("qw", "qx", "qy", "qz") if is_first else QUATERNION
    found: list[tuple[str, Any]] = []
    for column, text in columns.items():
        if column not in GROUPS:
            if column not in COLUMNS:
                raise ValueError(
                    f"columns: unknown column {short(column)}; name the groups {', '.join(GROUPS)}, or one by one "
                    f"{', '.join(COLUMNS)}"
                )
            found.append((column, text))
            continue
        group = ("t",) if column == "time" else RATES[0] if column == "rates" else order
        if column == "quaternion" and attitude is None:
            raise ValueError(f"columns: the quaternion is {short(text)}, of which the order is not known; {ADVICE}")
        parts = [text] if isinstance(text, str) else list(text) if isinstance(text, Sequence) else []
        if len(parts) != len(group):
            raise ValueError(f"columns: the {column} is {short(text)}; name {len(group)} columns")
        found += zip(group, parts, strict=True)
    if len({column for column, _ in found}) < len(found):
        raise ValueError(f"columns is {short(dict(columns))}; name each of {', '.join(COLUMNS)} once")
    return dict(found)


def _refuse_parts(file: Path, found: Mapping[str, int], group: Sequence[str]) -> None:
    missing = [name for name in group if name not in found]
    if missing and len(missing) < len(group):
        raise ValueError(f"{file}: columns has no {', '.join(missing)}; name all of {', '.join(group)}, or none")


def _numbers(table: TextTable, columns: Sequence[int], places: Sequence[str]) -> Floats:
    """Return columns as finite numbers, (k, n); ValueError with the line of one that is none."""
    rows = zip(table.rows, places, strict=True)
    return np.array([numbers_of([row[k] for k in columns], place) for row, place in rows])


def log_of_tum(file: Path, lines: Sequence[TextLine], attitude: Any, direction: Any, time_unit: Any) -> AttitudeLog:
    """Return the attitudes in a trajectory of the format TUM, whose quaternions are x, y, z, w."""
    if attitude not in (None, "xyzw"):
        raise ValueError(
            f"attitude is {short(attitude)}, and the format TUM has xyzw; leave it out, or give format='csv'"
        )
    rows = [line for line in lines if not line.text.startswith("#")]
    places = [f"{file}, line {line.number}" for line in rows]
    numbers = [numbers_of(line.text.split(), place) for line, place in zip(rows, places, strict=True)]
    for row, place in zip(numbers, places, strict=True):
        if len(row) != len(TUM):
            raise ValueError(f"{place}: {len(row)} numbers; the format TUM has {', '.join(TUM)}")
    if not rows:
        raise ValueError(f"{file} has no rows")
    table = np.array(numbers)
    t = UNITS["s"][read_choice("s" if time_unit is None else time_unit, "time_unit", UNITS["s"])] * table[:, 0]
    ascending(t, lambda k: places[k])
    return AttitudeLog(t, turned(rotations_of(table[:, 4:], lambda k: places[k]), direction))


def turned(rotation: Any, direction: Any) -> Any:
    """Return rotations of a direction as those from the body to space."""
    return rotation if read_choice(direction, "direction", DIRECTIONS) == DIRECTIONS[0] else rotation.inv()


def table_text(log: AttitudeLog, tum: bool) -> str:
    """Return a log as the text of a CSV or a TUM file."""
    q = log.rotation.as_quat()
    rows = []
    if tum:
        rows = [f"{t!r} 0 0 0 {' '.join(map(repr, row))}" for t, row in zip(log.t.tolist(), q.tolist(), strict=True)]
        return "\n".join(["# " + " ".join(TUM), *rows, ""])
    omega = log.angular_velocity
    columns = [log.t, *([] if omega is None else omega.T), q[:, 3], *q[:, :3].T]
    names = ["t", *([] if omega is None else RATES[0]), "qw", "qx", "qy", "qz"]
    known = [f"{FRAMES_NOTE}{log.body}, to space{f', {log.frame}' if log.frame else ''}{SECONDS_NOTE}"]
    if omega is not None:
        known.append(f"{RATES_NOTE}rad/s")
    if log.epoch:
        known.append(f"{EPOCH_NOTE}{log.epoch}")
    rows = [",".join(map(repr, row)) for row in np.stack(columns, axis=1).tolist()]
    return "\n".join([*known, ",".join(names), *rows, ""])


def _noted_frames(comments: Sequence[str], file: str) -> tuple[str, str, Epoch | None]:
    """Return the names of the frames of the body and of space, and the epoch, from the comments of `table_text`."""
    body, frame, epoch = "", "", None
    for comment in comments:
        if comment.startswith(FRAMES_NOTE) and comment.endswith(SECONDS_NOTE):
            body, _, frame = comment.removeprefix(FRAMES_NOTE).removesuffix(SECONDS_NOTE).partition(", to space")
            frame = frame.removeprefix(", ")
        elif comment.startswith(EPOCH_NOTE):
            date, _, system = comment.removeprefix(EPOCH_NOTE).rpartition(" ")
            epoch = Epoch.read(date, f"{file}: the date of t = 0", system)
    return body, frame, epoch


def _rate_columns(file: Path, names: Sequence[str], rates: Any) -> list[int]:
    """Return the columns of rates that are read; ValueError if there are none and `rates` says their unit."""
    if rates is False:
        return []
    known = next((one for one in RATES if {*one} <= {*names}), ())
    if rates is not None and not known:
        read_choice(rates, "rates", UNITS["rad/s"])
        raise ValueError(f"{file} has no columns {', '.join(RATES[0])} of rates; leave rates= out")
    return [names.index(one) for one in known]


def _rate_unit(file: Path, titles: Sequence[str], written: set[str], noted: set[str], rates: Any) -> str:
    """Return the unit of rates, by the names of their columns, a comment or `rates`, which agree; else ValueError."""
    given = set() if rates is None else {read_choice(rates, "rates", UNITS["rad/s"])}
    listed, stated = ", ".join(map(short, titles)), (written | noted) - {""}
    if len(written) > 1 or len(stated) > 1 or not stated <= UNITS["rad/s"].keys():
        raise ValueError(
            f"{file}: the rates {listed} have the units {', '.join(sorted(map(short, written | noted)))}; correct them "
            "to one of rad/s or deg/s, or give rates=False to leave them"
        )
    if given and stated and given != stated:
        raise ValueError(
            f"{file}: rates is {short(rates)}, and the file has {listed} in {', '.join(stated)}; give that"
        )
    if not given | stated:
        raise ValueError(
            f"{file} has rates {listed} without a unit; give rates='rad/s' or 'deg/s', or rates=False to leave them"
        )
    return next(iter(given | stated))


def _quaternion_columns(file: Path, names: Sequence[str], width: int, attitude: Any) -> list[int]:
    """Return the columns of x, y, z, w; ValueError unless the names or `attitude` say which."""
    order = None if attitude is None else ORDERS[read_choice(attitude, "attitude", ORDERS)]
    for known in NAMED:
        if {*known} <= {*names}:
            found = [names.index(one) for one in known]
            if order is not None and [sorted(found)[k] for k in order] != found:
                raise ValueError(
                    f"{file}: attitude is {short(attitude)}, and the columns are named "
                    f"{', '.join(names[k] for k in sorted(found))}; leave it out, or correct the names"
                )
            return found
    for known in NUMBERED:
        if {*known} <= {*names}:
            found = sorted(names.index(one) for one in known)
            if order is None:
                raise ValueError(f"{file}: the names {', '.join(known)} do not say which is the scalar part; {ADVICE}")
            return [found[k] for k in order]
    if names:
        raise ValueError(
            f"{file}: no columns are named qw, qx, qy, qz, but {', '.join(map(short, names))}; name those of the "
            "quaternion by columns=, such as columns='qw=NAME,qx=NAME,qy=NAME,qz=NAME'"
        )
    if width != 5:
        raise ValueError(f"{file} has {width} columns without names; give the time and four of a quaternion, or names")
    if order is None:
        raise ValueError(f"{file}: the columns of the quaternion have no names; {ADVICE}")
    return [1 + k for k in order]


def _times(
    texts: Sequence[str], places: Sequence[str], unit: str, given: Any, time_system: Any
) -> tuple[Floats, Epoch | None]:
    """Return times in seconds and the epoch of dates."""
    if given is not None:
        read_choice(given, "time_unit", UNITS["s"])
    if not is_number(texts[0]):
        epoch = Epoch.read(texts[0].rstrip("Z"), f"{places[0]}: the date", time_system)
        return np.array([elapsed(one, epoch, f"{p}: the date") for one, p in zip(texts, places, strict=True)]), epoch
    if unit and given not in (None, unit):
        raise ValueError(f"{places[0]}: the unit of the time is {short(unit)}, and time_unit {given!r}; give that")
    size = unit_size("t", "the time", unit or given or "s", "s")
    return size * np.array([numbers_of([one], place)[0] for one, place in zip(texts, places, strict=True)]), None
