"""Orbit ephemeris messages of CCSDS."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

from coadjoint.files.ccsds import (
    ascending,
    dated,
    elapsed,
    lines_of,
    messages_of,
    required,
    segment_of,
    table_of,
    time_system_of,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.systems.orbits.orbit import EARTH, Orbit, read_frame, read_planet
from coadjoint.systems.orbits.samples import check_velocities, sampled_orbit
from coadjoint.systems.orbits.spline import DEGREES

KILOMETRE = 1000.0


@suggest_keywords
def read_oem(path: Any, *, segment: int | None = None, epoch: Any = None, degree: int = 7, planet: Any = None) -> Orbit:
    """Return the orbit in an orbit ephemeris message of CCSDS (OEM 1.0 to 3.0, in keywords and values).

    Choose it for the ephemeris of an operator. Between its lines it is as `from_samples` with velocities.

    Parameters
    ----------
    path : str or pathlib.Path
        The file. Lengths in it are in kilometres, as the standard says, and in metres in the orbit.
    segment : int, optional
        Number of the segment, from 0 on, of a file with several, between which there may be manoeuvres.
    epoch : str, datetime.datetime or Epoch, optional
        Date at t = 0, in the time system of the file; by default the first line, or the useable start.
    degree : {3, 7, 11}
        Of the polynomials; the INTERPOLATION of the file is a recommendation, and not followed.
    planet : Planet, optional
        The body in the centre, if CENTER_NAME is not EARTH.

    Returns
    -------
    Orbit
        In the REF_FRAME of the file, known between the useable times.

    Raises
    ------
    ValueError, TypeError
        A file that is no OEM, with the line that is wrong; a frame that turns; several segments and no number; another
        centre than the Earth without a planet.

    Notes
    -----
    CCSDS 502.0-B-3, Orbit Data Messages (2023).

    Examples
    --------
    >>> import coadjoint as co
    >>> orbit = co.orbits.read_oem("ephemeris.oem")  # doctest: +SKIP
    >>> pull = co.forces.GravityGradient(orbit.planet.mu, orbit.position)  # doctest: +SKIP
    """
    file, lines = lines_of(path)
    _, segments = messages_of(file, lines, "OEM")
    chosen = segment_of(file, segments, segment)
    centre, frame, first = required(file, chosen, "CENTER_NAME", "REF_FRAME", "START_TIME")
    system = time_system_of(file, chosen)
    if planet is None and centre.upper() != "EARTH":
        raise ValueError(f"{file}: CENTER_NAME is {short(centre)}; give planet=co.orbits.Planet(mu, radius, j2)")
    body = EARTH if planet is None else read_planet(planet)
    if type(degree) is not int or degree not in DEGREES:
        raise ValueError(f"degree is {degree!r}; give one of {', '.join(map(str, DEGREES))}")
    begin = chosen.metadata.get("USEABLE_START_TIME", first)
    if epoch is None:
        date, fraction = dated(begin, f"{file}: the start")
        start = Epoch(date + timedelta(seconds=fraction), system)
    else:
        start = Epoch.read(epoch, "epoch", system)
        if start.system != system:
            raise ValueError(f"epoch is in {start.system}, and {file} in {system}; give it in this")
    t, numbers = table_of(file, chosen.data, start, (6, 9))
    ascending(t, lambda k: f"{file}, line {chosen.data[k].number}")
    if len(t) < 2:
        raise ValueError(f"{file} has one line of data; an orbit needs two")
    r, v = KILOMETRE * numbers[:, :3], KILOMETRE * numbers[:, 3:6]
    try:
        check_velocities(t, r, v)
        orbit = sampled_orbit(t, r, v, degree, read_frame(frame), start, body)
    except ValueError as reason:
        raise ValueError(f"{file}: {reason}") from None
    ends = [
        elapsed(chosen.metadata[name], start, f"{file}: {name}") if name in chosen.metadata else known
        for name, known in (("USEABLE_START_TIME", t[0]), ("USEABLE_STOP_TIME", t[-1]))
    ]
    return orbit.within((max(ends[0], float(t[0])), min(ends[1], float(t[-1]))))
