"""C-kernels of SPICE, with a kernel of a clock that counts microseconds."""

from __future__ import annotations

from math import sin
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.attitudes.attitude_log import AttitudeLog, Floats
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import DAY, Epoch
from coadjoint.validation import is_integer

TICKS = 1_000_000  # a second
CLOCKS = 1000  # instruments of a clock
MODULUS = 10_000_000_000  # seconds
FRAMES = {"J2000": "J2000", "EME2000": "J2000", "ICRF": "J2000", "GCRF": "J2000"}
"""Names of frames that SPICE takes for its J2000."""


def ephemeris_time(epoch: Epoch) -> float:
    """Return the seconds of TDB since J2000, as SPICE counts them."""
    # The formula of the kernel of leap seconds, naif0012.tls.
    seconds = epoch.dynamical_days * DAY
    M = 6.239996 + 1.99096871e-7 * seconds
    return float(seconds + 1.657e-3 * sin(M + 1.671e-2 * sin(M)))


def clock_of(instrument: Any) -> int:
    """Return the number of the clock of an instrument, without its sign; ValueError for what is none."""
    if not is_integer(instrument) or not -(2**31) < instrument <= -CLOCKS:
        raise ValueError(
            f"instrument is {short(instrument)}; give a NAIF number, such as -999000 of the spacecraft -999"
        )
    return -int(instrument) // CLOCKS


def clock_text(log: AttitudeLog, instrument: int) -> str:
    """Return the text of the kernel of the clock, whose ticks begin at the first attitude."""
    number, begin = clock_of(instrument), ephemeris_time(log.epoch) + float(log.t[0])
    rows = {
        "SCLK_KERNEL_ID": "@2000-01-01/00:00:00",
        f"SCLK_DATA_TYPE_{number}": "1",
        f"SCLK01_TIME_SYSTEM_{number}": "1",
        f"SCLK01_N_FIELDS_{number}": "2",
        f"SCLK01_MODULI_{number}": f"{MODULUS} {TICKS}",
        f"SCLK01_OFFSETS_{number}": "0 0",
        f"SCLK01_OUTPUT_DELIM_{number}": "1",
        f"SCLK_PARTITION_START_{number}": "0",
        f"SCLK_PARTITION_END_{number}": f"{MODULUS * TICKS:.1E}",
        f"SCLK01_COEFFICIENTS_{number}": f"0 {begin!r} 1",
    }
    title = f"The clock of the spacecraft -{number}: microseconds from the first attitude on."
    return "\n".join(["KPL/SCLK", "", title, "", "\\begindata", *(f"{k} = ( {v} )" for k, v in rows.items()), ""])


def write_ck(log: AttitudeLog, path: Path, instrument: int) -> None:
    """Write a segment of type 3, which SPICE interpolates, to a file that does not exist."""
    import spiceypy

    frame = FRAMES.get(log.frame.upper())
    if frame is None or log.epoch is None:
        raise ValueError(f"{log!r} has the frame {short(log.frame)}; a CK needs an epoch and {', '.join(FRAMES)}")
    ticks = np.round(TICKS * (log.t - log.t[0]))
    if len(ticks) < 2 or not (np.diff(ticks) > 0.0).all():
        raise ValueError("a CK needs two attitudes, at times that are a microsecond apart")
    q = log.rotation.inv().as_quat()[:, [3, 0, 1, 2]]  # its matrix is from the reference frame to the instrument
    omega = log.angular_velocity
    # Of SPICE in the reference frame.
    rates: Floats = np.zeros((len(q), 3)) if omega is None else log.rotation.apply(omega)
    handle: Any = spiceypy.ckopn(str(path), "attitudes of coadjoint", 0)
    try:
        spiceypy.ckw03(
            handle,
            float(ticks[0]),
            float(ticks[-1]),
            instrument,
            frame,
            omega is not None,
            "attitude",
            len(ticks),
            ticks,
            np.ascontiguousarray(q),
            np.ascontiguousarray(rates),
            1,
            [float(ticks[0])],
        )
    finally:
        spiceypy.ckcls(handle)
