"""Epochs: dates in a named time system, the rotation of the Earth and the precession of its axis."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from coadjoint.short_repr import short
from coadjoint.validation import read_choice

Floats = NDArray[np.float64]

J2000 = datetime(2000, 1, 1, 12)
FIRST_YEAR, LAST_YEAR = 1800, 2200
"""Years of epochs, for which precession and the sun are known."""
DAY = 86400.0
CENTURY = 36525.0
TAI_BEHIND_TT = 32.184
GPS_BEHIND_TAI = 19.0
LEAP_SECONDS = (
    *("1972-07", "1973-01", "1974-01", "1975-01", "1976-01", "1977-01", "1978-01", "1979-01", "1980-01", "1981-07"),
    *("1982-07", "1983-07", "1985-07", "1988-01", "1990-01", "1991-01", "1992-07", "1993-07", "1994-07", "1996-01"),
    *("1997-07", "1999-01", "2006-01", "2009-01", "2012-07", "2015-07", "2017-01"),
)
"""Months from whose first day on TAI - UTC is a second larger; before the first one it is 10 s (IERS Bulletin C)."""
TIME_SYSTEMS = ("UTC", "UT1", "TAI", "GPS", "TT", "TDB")
"""UT1 differs from UTC by less than 0.9 s, and TDB from TT by less than 2 ms; they are not told apart here."""
ARCSECOND = np.pi / 648000.0


class Epoch(NamedTuple):
    """A date, with microseconds, in a time system."""

    date: datetime
    system: str

    @classmethod
    def read(cls, value: Any, what: str, system: Any = "UTC") -> Self:
        """Validate a date of ISO 8601 or CCSDS, text or a datetime, of which one with a zone is in UTC."""
        name = read_choice(system, "time_system", TIME_SYSTEMS)
        if isinstance(value, Epoch):
            return cls(*value)
        date = value if isinstance(value, datetime) else _date_of(value, what)
        if date.tzinfo is not None:
            if name != "UTC":
                raise ValueError(
                    f"{what} is {short(str(value))}, in UTC, and time_system is {name!r}; give one of them"
                )
            date = date.astimezone(UTC).replace(tzinfo=None)
        if not FIRST_YEAR <= date.year <= LAST_YEAR:
            raise ValueError(f"{what} is in the year {date.year}; give one from {FIRST_YEAR} to {LAST_YEAR}")
        return cls(date, name)

    def __str__(self) -> str:
        return f"{self.date.isoformat()} {self.system}"

    def seconds_to(self, other: Epoch) -> float:
        """Return the seconds to another epoch of the same time system, of UTC without leap seconds between."""
        return (other.date - self.date).total_seconds()

    def after(self, seconds: float) -> Epoch:
        return Epoch(self.date + timedelta(seconds=seconds), self.system)

    @property
    def utc(self) -> datetime:
        """The date in UTC, which is taken for UT1."""
        if self.system in ("UTC", "UT1"):
            return self.date
        behind = {"TAI": 0.0, "GPS": -GPS_BEHIND_TAI}.get(self.system, TAI_BEHIND_TT)
        atomic = self.date - timedelta(seconds=behind)
        return atomic - timedelta(seconds=leap_seconds(atomic - timedelta(seconds=leap_seconds(atomic))))

    @property
    def days(self) -> float:
        """Days of UT1 since J2000, 2000-01-01 12:00."""
        return (self.utc - J2000) / timedelta(days=1)

    @property
    def dynamical_days(self) -> float:
        """Days of TT since J2000."""
        return self.days + (TAI_BEHIND_TT + leap_seconds(self.utc)) / DAY


def leap_seconds(date: datetime) -> int:
    """Return TAI - UTC at a date of UTC, in seconds."""
    month = f"{date.year:04d}-{date.month:02d}"
    return 10 + sum(one <= month for one in LEAP_SECONDS)


def _date_of(value: Any, what: str) -> datetime:
    advice = "give a date such as '2024-03-20T03:06:00', with its time_system"
    if not isinstance(value, str):
        raise TypeError(f"{what} is {short(value)}; {advice}")
    text = value.strip()
    day, _, clock = text.partition("T")
    if day.count("-") == 1:  # CCSDS: the day of the year
        try:
            day = datetime.strptime(day, "%Y-%j").date().isoformat()
        except ValueError:
            raise ValueError(f"{what} is {short(value)}, which is no date; {advice}") from None
    whole, _, fraction = clock.removesuffix("Z").partition(".")
    try:
        if fraction and not (fraction.isascii() and fraction.isdigit()):
            raise ValueError
        date = datetime.fromisoformat(f"{day}T{whole or '00:00:00'}")
        date += timedelta(seconds=float(f"0.{fraction or 0}"))
    except ValueError:
        raise ValueError(f"{what} is {short(value)}, which is no date; {advice}") from None
    return date.replace(tzinfo=UTC) if clock.endswith("Z") and date.tzinfo is None else date


def sidereal_angle(epoch: Epoch) -> tuple[float, float]:
    """Return the mean sidereal time of Greenwich at an epoch, in radians, and its rate per second (IAU 1982)."""
    # From the mean equinox of date. The rate is that at the epoch: it changes by 1e-15 a century.
    days = epoch.days
    T = days / CENTURY
    seconds = 67310.54841 + (876600.0 * 3600.0 + 8640184.812866) * T + 0.093104 * T * T - 6.2e-6 * T**3
    rate = 1.00273790935 + 5.9e-11 * T
    return float(np.mod(2.0 * np.pi * seconds / DAY, 2.0 * np.pi)), 2.0 * np.pi * rate / DAY


def precession(epoch: Epoch) -> Floats:
    """Return the rotation from the mean equator and equinox of J2000 to those of date (IAU 1976)."""
    T = epoch.dynamical_days / CENTURY
    zeta = ARCSECOND * (2306.2181 + (0.30188 + 0.017998 * T) * T) * T
    theta = ARCSECOND * (2004.3109 - (0.42665 + 0.041833 * T) * T) * T
    z = ARCSECOND * (2306.2181 + (1.09468 + 0.018203 * T) * T) * T
    return rotation(2, -z) @ rotation(1, theta) @ rotation(2, -zeta)


def rotation(axis: int, angle: float) -> Floats:
    """Return the matrix that turns the axes by an angle, so that vectors get their components along the new ones."""
    c, s, (i, j) = np.cos(angle), np.sin(angle), ((axis + 1) % 3, (axis + 2) % 3)
    R = np.eye(3)
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = s, -s
    return R


OF_DATE = "TEME", "MOD", "TOD"
OF_J2000 = "J2000", "EME2000", "GCRF", "ICRF"
EARTH_FIXED = "ITRF", "ITRS", "ECEF", "WGS", "GRC", "TDR"
"""Names of frames: of the equator of date, of that of J2000 or within 0.1 arcseconds of it, and those that turn."""


def is_of_date(frame: str, what: str) -> bool:
    """Return whether a frame is that of the equator of date, and not of J2000; ValueError if it is another one."""
    name = frame.upper()
    if name not in (*OF_DATE, *OF_J2000):
        given = f"is {short(frame)}" if frame else "has no name"
        raise ValueError(
            f"{what} needs the equator of the Earth, and the frame of the orbit {given}; give frame= as one of "
            f"{', '.join((*OF_J2000, *OF_DATE))}"
        )
    return name in OF_DATE
