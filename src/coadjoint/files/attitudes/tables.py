"""Logs of attitudes as tables: CSV with or without names of columns, and TUM."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.attitudes.attitude_log import AttitudeLog, Floats, rotations_of
from coadjoint.files.ccsds import TextLine, ascending, elapsed, numbers_of
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.validation import read_choice

ORDERS = {"wxyz": (1, 2, 3, 0), "xyzw": (0, 1, 2, 3)}
DIRECTIONS = "body to space", "space to body"
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
RATE_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
TIMES = "t", "time", "timestamp", "date", "epoch", "utc"
NAMED = (("qx", "qy", "qz", "qw"), ("x", "y", "z", "w"), ("q_x", "q_y", "q_z", "q_w"), ("q1", "q2", "q3", "qc"))
"""Names of the components x, y, z, w of quaternions."""
NUMBERED = ("q0", "q1", "q2", "q3"), ("q1", "q2", "q3", "q4")
RATES = ("wx", "wy", "wz"), ("omega_x", "omega_y", "omega_z"), ("p", "q", "r"), ("gx", "gy", "gz")
UNIT = re.compile(r"\s*[\[(](.*)[\])]\s*$")
SPELLINGS = {
    "s": ("s", "sec", "seconds"),
    "ms": ("ms", "msec"),
    "us": ("us", "usec", "\N{MICRO SIGN}s", "\N{GREEK SMALL LETTER MU}s"),
    "ns": ("ns", "nsec"),
    "rad/s": ("rad/s", "rad/sec", "rad_s", "rad_sec", "rad_per_s", "rad_per_sec", "radps"),
    "deg/s": ("deg/s", "deg/sec", "deg_s", "deg_sec", "deg_per_s", "deg_per_sec", "degps", "dps", "\N{DEGREE SIGN}/s"),
}
"""Units as they are written in the brackets or at the end of a name."""
UNITS = {text: unit for unit, texts in SPELLINGS.items() for text in texts}
SUFFIXED = {**dict.fromkeys(TIMES, TIME_UNITS), **dict.fromkeys((name for one in RATES for name in one), RATE_UNITS)}
"""Names that may end with a unit, as in t_ms, and the units of each."""
RATES_NOTE = "# angular velocity in the body frame, "
"""Comment before the unit of the rates, in files that are written here."""
TUM = "timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"
ADVICE = "give attitude='wxyz' if the scalar part is the first one, and attitude='xyzw' if it is the last"


def log_of_table(
    file: Path, lines: Sequence[TextLine], attitude: Any, direction: Any, time_unit: Any, rates: Any, time_system: Any
) -> AttitudeLog:
    """Return the attitudes in a CSV file."""
    comments = [line for line in lines if line.text.startswith("#")]
    rows = [line for line in lines if not line.text.startswith("#")]
    if not rows:
        raise ValueError(f"{file} has no rows")
    separator = max(",;\t", key=rows[-1].text.count)
    cells = [_cells(line, separator, file) for line in rows]
    header: list[str] = []
    if not _is_number(cells[0][-1]):
        header = cells.pop(0)
        rows = rows[1:]
    elif comments and len(found := comments[-1].text.lstrip("# ").split(separator)) == len(cells[0]):
        header = found  # names behind the sign of a comment
    if not rows:
        raise ValueError(f"{file} has names of columns and no rows")
    width = len(cells[0])
    for line, row in zip(rows, cells, strict=True):
        if len(row) != width:
            raise ValueError(f"{file}, line {line.number}: {len(row)} columns, and {width} in line {rows[0].number}")
    names, units = _names_and_units(header)
    if header and len(header) != width:
        raise ValueError(f"{file}: {len(header)} names of columns, and {width} columns")
    columns = _quaternion_columns(file, names, width, attitude)
    of_time = next((names.index(one) for one in TIMES if one in names), None) if header else 0
    if of_time is None:
        raise ValueError(f"{file}: no column is named {', '.join(TIMES)}, but {', '.join(map(short, names))}")
    places = [f"{file}, line {line.number}" for line in rows]
    texts = [row[of_time].strip() for row in cells]
    t, epoch = _times(texts, places, units.get(of_time, ""), time_unit, time_system)
    ascending(t, lambda k: places[k])
    numbers = np.array([numbers_of([row[k] for k in columns], place) for row, place in zip(cells, places, strict=True)])
    omega, of_rates = None, _rate_columns(file, names, rates)
    if of_rates:
        known = {k: units.get(k, "") for k in of_rates}
        noted = {line.text.removeprefix(RATES_NOTE) for line in comments if line.text.startswith(RATES_NOTE)}
        unit = _rate_unit(file, [header[k].strip() for k in of_rates], {*known.values()}, noted, rates)
        omega = RATE_UNITS[unit] * np.array(
            [numbers_of([row[k] for k in of_rates], p) for row, p in zip(cells, places, strict=True)]
        )
    return AttitudeLog(t, turned(rotations_of(numbers, lambda k: places[k]), direction), omega, epoch=epoch)


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
    t = TIME_UNITS[read_choice(time_unit, "time_unit", TIME_UNITS)] * table[:, 0]
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
    known = [f"# attitude from the body, {log.body}, to space{f', {log.frame}' if log.frame else ''}; t in seconds"]
    if omega is not None:
        known.append(f"{RATES_NOTE}rad/s")
    if log.epoch:
        known.append(f"# t = 0 at {log.epoch}")
    rows = [",".join(map(repr, row)) for row in np.stack(columns, axis=1).tolist()]
    return "\n".join([*known, ",".join(names), *rows, ""])


def _cells(line: TextLine, separator: str, file: Path) -> list[str]:
    try:
        return next(csv.reader([line.text], delimiter=separator, skipinitialspace=True))
    except csv.Error as reason:
        raise ValueError(f"{file}, line {line.number}: {reason}") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _names_and_units(header: Sequence[str]) -> tuple[list[str], dict[int, str]]:
    """Return the names of columns in small letters without their units, in brackets or at the end, and the units."""
    names, units = [], {}
    for k, title in enumerate(header):
        unit = UNIT.search(title)
        if unit:
            written = unit.group(1).strip()
            units[k] = UNITS.get(written.lower(), written)
        names.append(UNIT.sub("", title).strip().lower())
    for k, name in enumerate(names):
        for bare, known in SUFFIXED.items():
            ending = name.removeprefix(f"{bare}_")
            if k not in units and ending != name and UNITS.get(ending) in known and bare not in names:
                names[k], units[k] = bare, UNITS[ending]
    return names, units


def _rate_columns(file: Path, names: Sequence[str], rates: Any) -> list[int]:
    """Return the columns of rates that are read; ValueError if there are none and `rates` says their unit."""
    if rates is False:
        return []
    known = next((one for one in RATES if {*one} <= {*names}), ())
    if rates is not None and not known:
        read_choice(rates, "rates", RATE_UNITS)
        raise ValueError(f"{file} has no columns {', '.join(RATES[0])} of rates; leave rates= out")
    return [names.index(one) for one in known]


def _rate_unit(file: Path, titles: Sequence[str], written: set[str], noted: set[str], rates: Any) -> str:
    """Return the unit of rates, by the names of their columns, a comment or `rates`, which agree; else ValueError."""
    given = set() if rates is None else {read_choice(rates, "rates", RATE_UNITS)}
    listed, stated = ", ".join(map(short, titles)), (written | noted) - {""}
    if len(written) > 1 or len(stated) > 1 or not stated <= RATE_UNITS.keys():
        raise ValueError(
            f"{file}: the rates {listed} have the units {', '.join(sorted(map(short, written | noted)))}; correct them "
            "to rad/s or deg/s, or give rates=False to leave them"
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
            f"{file}: no columns are named qw, qx, qy, qz, but {', '.join(map(short, names))}; rename those of the "
            "quaternion"
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
    name = read_choice(given, "time_unit", TIME_UNITS)
    if not _is_number(texts[0]):
        epoch = Epoch.read(texts[0].rstrip("Z"), f"{places[0]}: the date", time_system)
        return np.array([elapsed(one, epoch, f"{p}: the date") for one, p in zip(texts, places, strict=True)]), epoch
    if unit and unit != name:
        raise ValueError(f"{places[0]}: the unit of the time is {short(unit)}, and time_unit {name!r}; give that")
    numbers = [numbers_of([one], place)[0] for one, place in zip(texts, places, strict=True)]
    return TIME_UNITS[name] * np.array(numbers), None
