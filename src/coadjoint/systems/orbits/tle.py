"""Orbits from two-line elements, propagated by the package sgp4."""

from __future__ import annotations

import re
from datetime import timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import J2000, Epoch
from coadjoint.systems.orbits.orbit import EARTH, Orbit
from coadjoint.systems.orbits.samples import sampled_orbit
from coadjoint.systems.orbits.spline import hermite_spline
from coadjoint.validation import read_finite, read_positive

Floats = NDArray[np.float64]

LENGTH = 69  # of a line of elements
ANGLE, MANTISSA = r" *\d+\.\d+ *", r"[ +-]?[ \d]{5}[ +-]?\d"
FIELDS = {
    (18, 32): (0, "date", r"[ \d]\d[ \d]{2}\d\.\d{8}"),
    (33, 43): (0, "change of the mean motion", r"[ +-]*\d?\.\d+ *"),
    (44, 52): (0, "second change of the mean motion", MANTISSA),
    (53, 61): (0, "drag", MANTISSA),
    (8, 16): (1, "inclination", ANGLE),
    (17, 25): (1, "right ascension", ANGLE),
    (26, 33): (1, "eccentricity", r"[ \d]{6}\d"),
    (34, 42): (1, "argument of the perigee", ANGLE),
    (43, 51): (1, "mean anomaly", ANGLE),
    (52, 63): (1, "mean motion", ANGLE),
}
"""Columns: the line from 0 on, the name and the pattern of what the propagation needs."""
J2000_JULIAN = 2451545.0
SAMPLES_A_REVOLUTION = 32  # at the start; doubled until the error is small enough
MAX_SAMPLES = 1 << 20
STALLED, MAX_STALLED = 0.75, 3
"""Part of the error that must not remain when samples are doubled, and how often it may."""
MINUTE, DAY, KILOMETRE = 60.0, 86400.0, 1000.0


@suggest_keywords
def from_tle(lines: Any, t_span: Any, *, epoch: Any = None, error: float = 0.01) -> Orbit:
    """Return the orbit of two-line elements, propagated by SGP4 or SDP4 (package sgp4).

    Choose it for a satellite that flies: CelesTrak and Space-Track publish elements of all. They are accurate to about
    a kilometre at their date, and some kilometres more after each day.

    Parameters
    ----------
    lines : str or sequence of str
        The two lines, with or without a line with the name before them.
    t_span : (float, float)
        Where the orbit is to be known, in seconds from the epoch; runs must lie within.
    epoch : str, datetime.datetime or Epoch, optional
        Date in UTC at t = 0; by default that of the elements.
    error : float
        Largest distance of the spline from SGP4 between samples, in metres; samples are added until it is met.

    Returns
    -------
    Orbit
        In metres and seconds, in the frame TEME, the true equator and mean equinox of date of SGP4. Its
        `sampling_error` is the distance from SGP4 that was found in the middle of the pieces, and its velocity the
        derivative of the position, from which that of SGP4 differs by some centimetres per second.

    Raises
    ------
    MissingPackageError
        The package sgp4 is missing.
    ValueError, TypeError
        Lines with a wrong length, number or checksum, or of two satellites; a satellite that decays within the span; or
        an error that is not met.

    Notes
    -----
    D. A. Vallado, P. Crawford, R. Hujsak and T. S. Kelso, Revisiting Spacetrack Report #3, AIAA 2006-6753.

    Examples
    --------
    >>> import coadjoint as co
    >>> lines = '''ISS (ZARYA)
    ... 1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927
    ... 2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537'''
    >>> orbit = co.orbits.from_tle(lines, (0, 7200))
    >>> orbit
    <orbit in TEME from t = 0 to 7200, t = 0 at 2008-09-20T12:25:40.104192 UTC>
    >>> orbit.sampling_error < 0.01
    True
    """
    first, second = read_lines(lines)
    require_packages("propagation of two-line elements", "sgp4")
    from sgp4.api import SGP4_ERRORS, Satrec

    span, tolerance = read_finite(t_span, "t_span"), read_positive(error, "error")
    if span.shape != (2,) or not span[0] < span[1]:
        raise ValueError(f"t_span is {short(t_span)}; give the start and the end, which is later, in seconds")
    satellite = Satrec.twoline2rv(first, second)
    if satellite.error:
        raise ValueError(f"SGP4 refuses these elements: {SGP4_ERRORS.get(satellite.error, satellite.error)}")
    of_elements = J2000 + timedelta(days=satellite.jdsatepoch - J2000_JULIAN) + _days(satellite.jdsatepochF)
    start = Epoch(of_elements, "UTC") if epoch is None else Epoch.read(epoch, "epoch")
    if start.system != "UTC":
        raise ValueError(f"epoch is in {start.system}; give one in UTC, the time system of two-line elements")
    shift = Epoch(of_elements, "UTC").seconds_to(start)

    def states(t: Floats) -> tuple[Floats, Floats]:
        count = len(t)
        check_available_memory(8 * 14 * count, f"{count} samples of SGP4")
        days = (shift + t) / DAY
        failures, r, v = satellite.sgp4_array(np.full(count, satellite.jdsatepoch), satellite.jdsatepochF + days)
        if failures.any():
            k = int(np.argmax(failures != 0))
            raise ValueError(
                f"SGP4 fails at t = {t[k]:.10g} s: {SGP4_ERRORS.get(int(failures[k]), failures[k])}; give a t_span "
                "that is nearer to the date of the elements"
            )
        return KILOMETRE * r, KILOMETRE * v

    period = MINUTE * 2.0 * np.pi / satellite.no_kozai
    pieces = max(4, int(np.ceil(SAMPLES_A_REVOLUTION * (span[1] - span[0]) / period)))
    if pieces > MAX_SAMPLES:
        raise ValueError(f"t_span has {(span[1] - span[0]) / period:.3g} revolutions; give a shorter one")
    last, stalled = np.inf, 0
    while pieces <= MAX_SAMPLES and stalled < MAX_STALLED:
        t = np.linspace(span[0], span[1], pieces + 1)
        middles = 0.5 * (t[:-1] + t[1:])
        r, (between, _) = states(t)[0], states(middles)
        # Velocities of SGP4 leave out parts of the derivatives of its positions.
        spline = hermite_spline(t, r, None, 7)
        found = np.sqrt(((spline.coefficients[:, 0] - between) ** 2).sum(axis=1)).max()
        if found <= tolerance:
            return sampled_orbit(t, r, None, 7, "TEME", start, EARTH, float(found))
        # Of an orbit that is not smooth, as one of wrong elements, it does not fall.
        stalled = stalled + 1 if not found < STALLED * last else 0
        pieces, last = 2 * pieces, found
    raise ValueError(
        f"{len(t)} samples of SGP4 leave an error of {found:.3g} m, and error is {tolerance:g}; give a larger one, a "
        "shorter t_span, or elements of a satellite in orbit"
    )


def _days(fraction: float) -> timedelta:
    return timedelta(microseconds=round(fraction * DAY * 1e6))


def read_lines(lines: Any) -> tuple[str, str]:
    """Validate two lines of elements, perhaps behind a name."""
    advice = "give the two lines of elements, each with 69 characters"
    if isinstance(lines, str):
        lines = lines.splitlines()
    try:
        rows = [line.rstrip() for line in lines if line.strip()]
    except (TypeError, AttributeError):
        raise TypeError(f"lines is {short(lines)}; {advice}") from None
    if len(rows) not in (2, 3):
        raise ValueError(f"lines has {len(rows)} lines; {advice}, with or without a name before")
    first, second = rows[-2:]
    for number, row in (("1", first), ("2", second)):
        if len(row) != LENGTH or not row.isascii() or row[:2] != f"{number} ":
            raise ValueError(f"line {number} of the elements is {short(row)}; {advice}, the first ones 1 and 2")
        # The sum of the digits, in which a minus counts as one.
        total = sum(int(c) if c.isdigit() else c == "-" for c in row[:-1]) % 10
        if row[-1] != str(total):
            raise ValueError(
                f"line {number} of the elements ends with {row[-1]!r}, and its checksum is {total}; copy it"
            )
    for (begin, end), (row, name, pattern) in FIELDS.items():
        field = (first, second)[row][begin:end]
        if not re.fullmatch(pattern, field):
            raise ValueError(f"the {name} in line {row + 1} of the elements is {field!r}, which is none; copy the line")
    if first[2:7] != second[2:7]:
        raise ValueError(f"the lines are those of two satellites, {first[2:7]} and {second[2:7]}; give those of one")
    return first, second
