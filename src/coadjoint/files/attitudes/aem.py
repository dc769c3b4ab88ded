"""Attitude ephemeris messages of CCSDS."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.attitudes.attitude_log import AttitudeLog, rotations_of
from coadjoint.files.ccsds import (
    TextLine,
    ascending,
    dated,
    messages_of,
    required,
    segment_of,
    table_of,
    time_system_of,
)
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch, leap_seconds

DEGREE = np.pi / 180.0
MAX_SECONDS = 1e10  # from the epoch of a log: three centuries
COUNTS = {"QUATERNION": 4, "QUATERNION/DERIVATIVE": 8, "QUATERNION/ANGVEL": 7, "QUATERNION/RATE": 7}
"""Types of data that are read: quaternions, of which rates of version 1 and derivatives are left out."""
BODIES = "SC_BODY", "SC", "BODY", "CSS", "INSTRUMENT", "STARTRACKER", "IMU", "ACTUATOR", "RW", "SA", "TAM"
"""Beginnings of the names of frames that are fixed in a spacecraft."""


def log_of_aem(file: Path, lines: Sequence[TextLine], segment: Any) -> AttitudeLog:
    """Return the attitudes in a message; ValueError with the line that is wrong."""
    version, segments = messages_of(file, lines, "AEM")
    chosen = segment_of(file, segments, segment)
    kind, a, b, first = required(file, chosen, "ATTITUDE_TYPE", "REF_FRAME_A", "REF_FRAME_B", "START_TIME")
    system, data = time_system_of(file, chosen), chosen.metadata
    if kind not in COUNTS:
        raise ValueError(f"{file}: ATTITUDE_TYPE is {short(kind)}; quaternions are read: {', '.join(COUNTS)}")
    order, forward = "LAST", True
    if version == "1.0":
        order, way = required(file, chosen, "QUATERNION_TYPE", "ATTITUDE_DIR")
        if order not in ("FIRST", "LAST") or way not in ("A2B", "B2A"):
            raise ValueError(f"{file}: QUATERNION_TYPE is {short(order)} and ATTITUDE_DIR {short(way)}")
        forward = way == "A2B"
    else:
        # Of version 1, without a meaning in version 2; other values than those which are implied contradict it.
        order = data.get("QUATERNION_TYPE", order)
        forward = data.get("ATTITUDE_DIR", "A2B") == "A2B"
        if order != "LAST" or not forward:
            raise ValueError(f"{file}: version {version} has quaternions from A to B with the scalar part last only")
    a_is_body, b_is_body = (one.upper().startswith(BODIES) for one in (a, b))
    if a_is_body == b_is_body:
        raise ValueError(
            f"{file}: the frames are {short(a)} and {short(b)}, of which one must be that of the spacecraft, such as "
            "SC_BODY_1"
        )
    date, fraction = dated(first, f"{file}: START_TIME")
    epoch = Epoch(date + timedelta(seconds=fraction), system)
    t, numbers = table_of(file, chosen.data, epoch, (COUNTS[kind],))
    ascending(t, lambda k: f"{file}, line {chosen.data[k].number}")
    q = numbers[:, :4] if order == "LAST" else numbers[:, [1, 2, 3, 0]]
    rotation = rotations_of(q, lambda k: f"{file}, line {chosen.data[k].number}")
    # That from A to B turns the axes of A into those of B: from the body B to space A.
    attitude = rotation if forward == b_is_body else rotation.inv()
    omega, body, space = None, *((b, a) if b_is_body else (a, b))
    if kind == "QUATERNION/ANGVEL":
        (frame,) = required(file, chosen, "ANGVEL_FRAME")
        if frame not in (a, b):
            raise ValueError(f"{file}: ANGVEL_FRAME is {short(frame)}; it must be {a} or {b}")
        omega = DEGREE * numbers[:, 4:7] * (1.0 if b_is_body else -1.0)
        omega = omega if frame == body else attitude.inv().apply(omega)
    return AttitudeLog(t, attitude, omega, space, body, epoch)


def aem_text(log: AttitudeLog, object_name: str, object_id: str, originator: str) -> str:
    """Return a log as the text of a message of version 2."""
    if not log.frame or log.epoch is None:
        missing = "frame" if not log.frame else "epoch"
        raise ValueError(f"the log has no {missing}, which an AEM names; give AttitudeLog(..., {missing}=...)")
    if not log.body.upper().startswith(BODIES) or log.frame.upper().startswith(BODIES):
        raise ValueError(
            f"the frames of the log are {short(log.frame)} and {short(log.body)}; an AEM names that of the spacecraft "
            "SC_BODY_1 or such"
        )
    dates = [_date_text(log.epoch, t) for t in log.t.tolist()]
    omega = log.angular_velocity
    numbers = log.rotation.as_quat()
    if omega is not None:
        numbers = np.concatenate([numbers, omega / DEGREE], axis=1)
    now = datetime.now(UTC).replace(tzinfo=None, microsecond=0)
    metadata = {
        "OBJECT_NAME": object_name,
        "OBJECT_ID": object_id,
        "REF_FRAME_A": log.frame,
        "REF_FRAME_B": log.body,
        "TIME_SYSTEM": log.epoch.system,
        "START_TIME": dates[0],
        "STOP_TIME": dates[-1],
        "ATTITUDE_TYPE": "QUATERNION" if omega is None else "QUATERNION/ANGVEL",
        **({} if omega is None else {"ANGVEL_FRAME": log.body}),
    }
    rows = [" ".join([date, *map(repr, row)]) for date, row in zip(dates, numbers.tolist(), strict=True)]
    return "\n".join(
        [
            "CCSDS_AEM_VERS = 2.0",
            f"CREATION_DATE = {now.isoformat()}",
            f"ORIGINATOR = {originator}",
            "",
            "META_START",
            *(f"{name} = {value}" for name, value in metadata.items()),
            "META_STOP",
            "",
            "DATA_START",
            *rows,
            "DATA_STOP",
            "",
        ]
    )


def _date_text(epoch: Epoch, t: float) -> str:
    """Return the date at a time with nanoseconds."""
    if not abs(t) < MAX_SECONDS:
        raise ValueError(f"t is {t:g} seconds from the epoch of the log; give an epoch that is nearer")
    whole = int(np.floor(t))
    nanoseconds = round((t - whole) * 1e9) + 1000 * epoch.date.microsecond
    date = epoch.date.replace(microsecond=0) + timedelta(seconds=whole + nanoseconds // 10**9)
    if epoch.system == "UTC" and leap_seconds(date) != leap_seconds(epoch.date):
        raise ValueError(f"a leap second lies between {epoch} and t = {t:g}; give an epoch in TAI")
    return f"{date.isoformat()}.{nanoseconds % 10**9:09d}"
