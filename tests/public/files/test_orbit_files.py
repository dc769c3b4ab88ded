"""Orbit ephemeris messages of CCSDS: the variants of the standard, and what is refused."""

from datetime import datetime, timedelta

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

O = co.orbits
EXACT = O.kepler(7.6e6, 0.02, 51.0, 30.0, 80.0, 20.0, degrees=True)
T = np.arange(0.0, 1801.0, 60.0)
BEGIN = datetime(2026, 3, 1, 12)


def rows(t=T, date=None, digits=9, extra="", suffix=""):
    """Return lines of data in kilometres."""
    date = date or (lambda s: (BEGIN + timedelta(seconds=s)).isoformat(timespec="milliseconds"))
    states = np.concatenate(EXACT.at(t), axis=1) / 1e3
    return "\n".join(
        f"{date(s)}{suffix} " + " ".join(f"{x:.{digits}f}" for x in row) + extra
        for s, row in zip(t, states, strict=True)
    )


def message(data=None, version="2.0", tail="", head="", **metadata):
    known = {
        "OBJECT_NAME": "SOME SATELLITE",
        "OBJECT_ID": "2026-001A",
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "EME2000",
        "TIME_SYSTEM": "UTC",
        "START_TIME": "2026-03-01T12:00:00.000",
        "STOP_TIME": "2026-03-01T12:30:00.000",
        **metadata,
    }
    lines = "\n".join(f"{name} = {value}" for name, value in known.items() if value is not None)
    start = f"CCSDS_OEM_VERS = {version}\n{head}CREATION_DATE = 2026-02-28T01:02:03\nORIGINATOR = TEST\n"
    return f"{start}\nMETA_START\n{lines}\nMETA_STOP\n\n{rows() if data is None else data}\n{tail}"


COVARIANCE = """COVARIANCE_START
EPOCH = 2026-03-01T12:00:00
COV_REF_FRAME = RTN
3.3e-04
4.6e-04 6.7e-04
COVARIANCE_STOP
"""
DAY_OF_YEAR = {"data": rows(date=lambda s: (BEGIN + timedelta(seconds=s)).strftime("%Y-%jT%H:%M:%S"))}
READ = {
    "plain": {},
    "version 1": {"version": "1.0"},
    "version 3": {"version": "3.0", "head": "CLASSIFICATION = public\n"},
    "comments": {"head": "COMMENT a = b\n", "data": "COMMENT a line\n" + rows()},
    "day of the year": {**DAY_OF_YEAR, "START_TIME": "2026-060T12:00:00", "STOP_TIME": "2026-060T12:30:00"},
    "Z": {"data": rows(suffix="Z"), "START_TIME": "2026-03-01T12:00:00Z"},
    "accelerations": {"data": rows(extra=" 0.001 0.002 0.003"), "version": "2.0"},
    "covariance": {"tail": COVARIANCE},
    "interpolation": {"INTERPOLATION": "HERMITE", "INTERPOLATION_DEGREE": "7"},
    "other frames": {"REF_FRAME": "ICRF"},
    "TDB": {"TIME_SYSTEM": "TDB", "REF_FRAME": "TEME"},
    "tabs and windows": {"data": rows().replace(" ", "\t").replace("\n", "\r\n")},
    "metres of Mars": {"CENTER_NAME": "MARS BARYCENTER"},
}


@pytest.mark.parametrize("case", READ)
def test_messages(tmp_path, case):
    path, options = tmp_path / "a.oem", {}
    path.write_text(message(**READ[case]), newline="")
    if case.endswith("Mars"):
        with refused(ValueError, "MARS BARYCENTER", "planet="):
            O.read_oem(path)
        options["planet"] = O.Planet(4.28e13, 3.39e6)
    orbit = O.read_oem(path, **options)
    assert orbit.t_span == (0.0, 1800.0) and orbit.epoch.date == BEGIN
    assert orbit.frame == READ[case].get("REF_FRAME", "EME2000")
    assert orbit.epoch.system == READ[case].get("TIME_SYSTEM", "UTC")
    middles = T[:-1] + 30.0
    # Nine digits of a kilometre are a micrometre, and degree 7 keeps a tenth of a millimetre.
    assert np.abs(orbit.at(middles).position - EXACT.at(middles).position).max() < 1e-4
    assert orbit.sampling_error < 0.1


def test_useable_times_other_epochs_and_segments(tmp_path):
    path = tmp_path / "a.oem"
    useable = {"USEABLE_START_TIME": "2026-03-01T12:05:00", "USEABLE_STOP_TIME": "2026-03-01T12:25:00.5"}
    path.write_text(message(**useable))
    orbit = O.read_oem(path)
    assert orbit.t_span == (0.0, 1200.5) and orbit.epoch.date == BEGIN + timedelta(minutes=5)
    assert np.abs(orbit.position(100.0) - EXACT.position(400.0)).max() < 1e-4
    with refused(ValueError, "outside"):
        orbit.position(1201.0)
    later = O.read_oem(path, epoch="2026-03-01T12:10:00.25")
    assert np.abs(later.position(0.0) - EXACT.position(600.25)).max() < 1e-4
    assert later.t_span == (-300.25, 900.25)
    first, second = message(data=rows(T[:10])), message(data=rows(T[9:]))
    path.write_text(first + second.partition("ORIGINATOR = TEST\n")[2])
    with refused(ValueError, "2 segments", "segment=0"):
        O.read_oem(path)
    assert O.read_oem(path, segment=0).t_span == (0.0, 540.0)
    assert O.read_oem(path, segment=1, epoch=BEGIN).t_span == (540.0, 1800.0)
    with refused(ValueError, "segment is 2"):
        O.read_oem(path, segment=2)


def test_leap_seconds_of_utc(tmp_path):
    """Two minutes about the end of 2016 have a second more in UTC, and not in TAI."""
    start = datetime(2016, 12, 31, 23, 59)

    def data(leap):
        return rows(
            np.arange(0.0, 121.0, 10.0) + leap * (np.arange(13) >= 6),
            date=lambda s: (start + timedelta(seconds=s - leap * (s >= 60))).isoformat(),
        )

    path = tmp_path / "a.oem"
    for system, leap in (("UTC", 1.0), ("TAI", 0.0)):
        path.write_text(message(data(leap), START_TIME=start.isoformat(), STOP_TIME=None, TIME_SYSTEM=system))
        orbit = O.read_oem(path)
        assert orbit.t_span == (0.0, 120.0 + leap)
        assert np.abs(orbit.position(95.0) - EXACT.position(95.0)).max() < 1e-3


REFUSED = {
    "nothing": ("", ("empty",)),
    "another file": ("a,b\n1,2\n", ("CCSDS_OEM_VERS",)),
    "XML": ("<?xml version='1.0'?><oem/>", ("XML",)),
    "no segment": ("CCSDS_OEM_VERS = 2.0\nORIGINATOR = A\n", ("META_START",)),
    "cut metadata": (message().partition("META_STOP")[0], ("META_STOP",)),
    "no data": (message(""), ("no lines of data",)),
    "a number": (message(rows().replace("12:01:00.000 ", "12:01:00.000 x")), ("line 16", "x")),
    "NaN": (message(rows(extra="").replace("12:01:00.000 ", "12:01:00.000 nan ", 1)), ("line 16", "nan")),
    "a column": (message(rows().replace("12:01:00.000 ", "12:01:00.000 1.0 ")), ("line 16", "7 numbers")),
    "a date": (message(rows().replace("12:01:00.000 ", "25:01:00.000 ")), ("line 16", "25:01")),
    "an order": (message(rows().replace("12:01:00.000 ", "11:01:00.000 ")), ("line 16", "ascend")),
    "no frame": (message(REF_FRAME=None), ("REF_FRAME",)),
    "a turning frame": (message(REF_FRAME="ITRF2014"), ("ITRF2014", "turns")),
    "a time system": (message(TIME_SYSTEM="MRT"), ("MRT",)),
    "metres": (
        message(
            "\n".join(
                " ".join(
                    [r.split()[0], *(f"{float(x) * 1e3:.6f}" if k < 3 else x for k, x in enumerate(r.split()[1:]))]
                )
                for r in rows().splitlines()
            )
        ),
        ("velocity", "position"),
    ),
    "twice": (message(REF_FRAME="ICRF\nREF_FRAME = TEME"), ("REF_FRAME", "twice")),
    "bytes": (b"CCSDS_OEM_VERS = 2.0\n\xff\xfe", ("UTF-8",)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_messages(tmp_path, case):
    text, named = REFUSED[case]
    path = tmp_path / "wrong.oem"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with refused(ValueError, "wrong.oem", *named):
        O.read_oem(path)


def test_a_large_file_and_a_folder_are_refused(tmp_path):
    path = tmp_path / "large.oem"
    with open(path, "wb") as file:
        file.truncate((1 << 30) + 1)
    with refused(ValueError, "large.oem", "bytes"):
        O.read_oem(path)
    with pytest.raises(OSError):
        O.read_oem(tmp_path)
    with refused(TypeError, "path"):
        O.read_oem(3)
