"""The magnetic field of the Earth along an orbit: a tilted dipole, and the IGRF by the package ppigrf."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.orbits.epochs import Epoch, is_of_date, precession, sidereal_angle
from coadjoint.systems.orbits.orbit import Orbit, check_earth
from coadjoint.systems.orbits.spline import hermite_spline
from coadjoint.validation import read_finite, read_positive

Floats = NDArray[np.float64]
OfTime = Callable[..., Any]

DIPOLE = (-1410.3e-9, 4545.5e-9, -29350.0e-9)
"""Gauss coefficients g11, h11, g10 of IGRF-14 in 2025, in tesla."""
REFERENCE_RADIUS = 6371200.0  # of the IGRF, in metres
FIRST_YEAR, LAST_YEAR = 1900, 2030
"""Years of IGRF-14."""
SAMPLES_A_REVOLUTION = 64
MAX_SAMPLES = 1 << 18
DAYS_OF_MODEL = 30.0  # between dates at which the coefficients are evaluated; they are linear within five years
NANOTESLA = 1e-9


@suggest_keywords
def tilted_dipole(orbit: Orbit, coefficients: Any = DIPOLE) -> OfTime:
    """Return the field of the dipole of the Earth along an orbit, which turns with the Earth.

    Choose it for controllers and first studies: it has about nine tenths of the field. `igrf` has all of it.

    Parameters
    ----------
    orbit : Orbit
        About the Earth, in metres, with an epoch and a frame.
    coefficients : (3,)
        Gauss coefficients g11, h11, g10 in tesla; by default those of IGRF-14 in 2025.

    Returns
    -------
    callable
        B in tesla as a function of the time, in the frame of the orbit: the `B` of `co.forces.MagneticDipole`, `BDot`
        and `Magnetorquers`. Precession is that of the epoch, and nutation and polar motion are left out.

    Raises
    ------
    ValueError, TypeError
        No epoch, no frame or another one, another planet, or wrong coefficients.

    Examples
    --------
    >>> import coadjoint as co
    >>> orbit = co.orbits.circular(6.878e6, 97.4, degrees=True, epoch="2025-01-01", frame="J2000")
    >>> B = co.orbits.tilted_dipole(orbit)
    >>> bool(2e-5 < np.linalg.norm(B(0.0)) < 6e-5)
    True
    """
    epoch = _epoch_of(orbit)
    numbers = read_finite(coefficients, "coefficients")
    if numbers.shape != (3,):
        raise ValueError(f"coefficients has the shape {numbers.shape}; give g11, h11 and g10")
    (angle, rate), W, position = sidereal_angle(epoch), _from_date(orbit, epoch), orbit.position
    g11, h11, g10 = numbers.tolist()
    cube = REFERENCE_RADIUS**3

    def field(t: Any) -> Any:
        r = position(t)
        square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
        c, s = np.cos(angle + rate * t), np.sin(angle + rate * t)
        m = W[:, 0] * (c * g11 - s * h11) + W[:, 1] * (s * g11 + c * h11) + W[:, 2] * g10
        along = (m[0] * r[0] + m[1] * r[1] + m[2] * r[2]) / square
        return (cube / (square * np.sqrt(square))) * (3.0 * along * r - m)

    return field


@suggest_keywords
def igrf(orbit: Orbit, t_span: Any = None, *, error: float = 1e-9) -> OfTime:
    """Return the International Geomagnetic Reference Field along an orbit (package ppigrf), as a spline in time.

    Choose it where the size of the field matters: it is accurate to about 1e-7 tesla in quiet conditions.

    Parameters
    ----------
    orbit : Orbit
        About the Earth, in metres, with an epoch from 1900 to 2030 and a frame.
    t_span : (float, float), optional
        Where the field is to be known; by default that of the orbit, which must then be finite.
    error : float
        Largest error of the spline between samples, in tesla; samples are added until it is met.

    Returns
    -------
    callable
        B in tesla as a function of the time, in the frame of the orbit, as that of `tilted_dipole`.

    Raises
    ------
    MissingPackageError
        The package ppigrf is missing.
    ValueError, TypeError
        No epoch, no frame or another one, another planet, a date outside of the model, no span, or an error that is not
        met.

    Notes
    -----
    P. Alken et al., International Geomagnetic Reference Field: the thirteenth generation, Earth, Planets and Space 73
    (2021) 49; coefficients of the fourteenth, by ppigrf.

    Examples
    --------
    >>> import coadjoint as co
    >>> orbit = co.orbits.circular(6.878e6, 97.4, degrees=True, epoch="2025-01-01", frame="J2000")
    >>> B = co.orbits.igrf(orbit, (0, 600))
    >>> bool(np.linalg.norm(B(300.0) - co.orbits.tilted_dipole(orbit)(300.0)) < 1.5e-5)
    True
    """
    epoch, tolerance = _epoch_of(orbit), read_positive(error, "error")
    require_packages("the magnetic field of the Earth", "ppigrf")
    first, last = orbit.t_span if t_span is None else read_finite(t_span, "t_span").tolist()[:2]
    if not (np.isfinite([first, last]).all() and first < last):
        given = "was not given, and the orbit has no end" if t_span is None else f"is {short(t_span)}"
        raise ValueError(f"t_span {given}; give the start and the end of the field")
    known = [(datetime(year, 1, 1) - epoch.utc).total_seconds() for year in (FIRST_YEAR, LAST_YEAR)]
    if not (known[0] <= first and last <= known[1]):
        raise ValueError(
            f"the field is needed from t = {first:g} to {last:g} after {epoch}, and the model is known from "
            f"{FIRST_YEAR} to {LAST_YEAR}"
        )
    state = orbit.at(first)
    turn = 2.0 * np.pi * np.linalg.norm(state.position) / np.linalg.norm(state.velocity)
    pieces = max(8, int(np.ceil(SAMPLES_A_REVOLUTION * (last - first) / turn)))
    t = np.linspace(first, last, pieces + 1)
    B = _samples(orbit, epoch, t)
    while pieces <= MAX_SAMPLES:
        middles = 0.5 * (t[:-1] + t[1:])
        between = _samples(orbit, epoch, middles)
        spline = hermite_spline(t, B, None, 7)
        if np.abs(spline.coefficients[:, 0] - between).max() <= tolerance:
            return spline.functions()[0]
        both, order = np.concatenate([t, middles]), np.argsort(np.concatenate([t, middles]))
        t, B, pieces = both[order], np.concatenate([B, between])[order], 2 * pieces
    raise ValueError(f"error is {tolerance:g} T, and {MAX_SAMPLES} samples do not meet it; give a larger one")


def _samples(orbit: Orbit, epoch: Epoch, t: Floats) -> Floats:
    """Return the field of ppigrf at times, in the frame of the orbit, in tesla."""
    from ppigrf import igrf_gc

    W, (angle, rate) = _from_date(orbit, epoch), sidereal_angle(epoch)
    r, turned = orbit.at(t).position @ W, angle + rate * t
    distance = np.sqrt((r * r).sum(axis=1))
    colatitude, right_ascension = np.arccos(r[:, 2] / distance), np.arctan2(r[:, 1], r[:, 0])
    # The formulas of the package divide by the sine.
    colatitude = np.clip(colatitude, 1e-9, np.pi - 1e-9)
    east = np.degrees(right_ascension - turned)
    parts = np.zeros((3, len(t)))
    count = max(1, int(np.ceil((t[-1] - t[0]) / (86400.0 * DAYS_OF_MODEL))))
    edges = np.linspace(t[0], t[-1], count + 1)
    for k in range(count):
        inside = (t >= edges[k]) & (t <= edges[k + 1])
        dates = [epoch.utc + timedelta(seconds=float(edge)) for edge in edges[k : k + 2]]
        arguments = distance[inside] / 1000.0, np.degrees(colatitude[inside]), east[inside]
        ends = np.array([igrf_gc(*arguments, date) for date in dates])[:, :, 0]
        share = (t[inside] - edges[k]) / (edges[k + 1] - edges[k])
        parts[:, inside] = ends[0] + share * (ends[1] - ends[0])
    c, s = np.cos(colatitude), np.sin(colatitude)
    ca, sa = np.cos(right_ascension), np.sin(right_ascension)
    up, south, eastward = parts
    across = s * up + c * south
    of_date = np.stack([across * ca - eastward * sa, across * sa + eastward * ca, c * up - s * south], axis=1)
    return np.asarray(NANOTESLA * of_date @ W.T)


def _epoch_of(orbit: Any) -> Epoch:
    if not isinstance(orbit, Orbit):
        raise TypeError(f"orbit is {short(orbit)}; give one of co.orbits, such as co.orbits.from_tle(lines, t_span)")
    return check_earth(orbit, "the magnetic field")


def _from_date(orbit: Orbit, epoch: Epoch) -> Floats:
    """Return the rotation to the frame of an orbit from the mean equator and equinox of date."""
    return np.eye(3) if is_of_date(orbit.frame, "the magnetic field") else np.ascontiguousarray(precession(epoch).T)
