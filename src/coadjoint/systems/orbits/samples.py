"""Orbits from samples: splines through positions, and through velocities where they are known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.orbits.epochs import Epoch
from coadjoint.systems.orbits.orbit import EARTH, Orbit, Planet, read_epoch, read_frame, read_planet
from coadjoint.systems.orbits.spline import DEGREES, hermite_spline
from coadjoint.validation import read_finite

Floats = NDArray[np.float64]

LARGEST = 1e100
"""Size of positions and velocities beyond which their products leave the range of float64."""
CONTRADICTION = 0.5
"""Share of a step by which the one of the velocities may differ from that of the positions: beyond, units differ."""


@suggest_keywords
def from_samples(
    t: Any,
    position: Any,
    velocity: Any = None,
    *,
    degree: int = 7,
    planet: Planet = EARTH,
    epoch: Any = None,
    time_system: str = "UTC",
    frame: str = "",
) -> Orbit:
    """Return an orbit through samples of an ephemeris.

    Choose it for what another program has computed. Pieces between samples are polynomials through the samples around
    them, which take the velocities too, or without these those of polynomials through the positions; position and
    velocity are continuous. With steps of 60 s in a low orbit, degree 7 is accurate to a millimetre.

    Parameters
    ----------
    t : (k,)
        Times of the samples, ascending, in seconds or the unit of the planet; they need not be equidistant.
    position : (k, 3)
        From the centre, in an inertial frame: metres for the Earth.
    velocity : (k, 3), optional
        Derivatives of the positions.
    degree : {3, 7, 11}
        Of the polynomials. The error between samples falls by the power degree + 1 of their distance.
    planet : Planet
        The body in the centre; the Earth in SI units by default.
    epoch : str, datetime.datetime or Epoch, optional
        Date at t = 0, which the direction of the sun and the field of the Earth need.
    time_system : {"UTC", "UT1", "TAI", "GPS", "TT", "TDB"}
        Of the epoch.
    frame : str
        Name of the inertial frame, such as "J2000" or "TEME"; needed as the epoch is.

    Returns
    -------
    Orbit
        Known from the first to the last sample. Its `sampling_error` is that of a spline through every second sample
        at the others, an upper bound where samples resolve the motion.

    Raises
    ------
    ValueError, TypeError
        Wrong shapes, times that do not ascend, a frame that turns with the Earth, positions inside the planet (as in
        kilometres), or velocities that contradict the positions.

    Examples
    --------
    >>> import coadjoint as co
    >>> exact = co.orbits.kepler(7.0e6, 0.01, 51.6, degrees=True)
    >>> t = np.arange(0.0, 6001.0, 60.0)
    >>> orbit = co.orbits.from_samples(t, *exact.at(t))
    >>> bool(np.linalg.norm(orbit.position(1234.5) - exact.position(1234.5)) < 1e-3)
    True
    """
    times, r = read_finite(t, "t"), read_finite(position, "position")
    if times.ndim != 1 or r.shape != (len(times), 3):
        raise ValueError(f"t has the shape {times.shape} and position {r.shape}; give (k,) and (k, 3)")
    least = 2 if velocity is not None else 3
    if len(times) < least:
        raise ValueError(f"there are {len(times)} samples; give at least {least}, or one with velocity=")
    steps = np.diff(times)
    if not (steps > 0.0).all():
        k = int(np.argmin(steps))
        raise ValueError(f"t[{k + 1}] is {times[k + 1]:.10g}, after {times[k]:.10g}; times must ascend")
    if type(degree) is not int or degree not in DEGREES:
        raise ValueError(f"degree is {degree!r}; give one of {', '.join(map(str, DEGREES))}")
    body = read_planet(planet)
    v = None
    if velocity is not None:
        v = read_finite(velocity, "velocity")
        if v.shape != r.shape:
            raise ValueError(f"velocity has the shape {v.shape}; give that of position, {r.shape}")
    check_sizes(r)
    least_distance = float(np.sqrt((r * r).sum(axis=1)).min())
    if not least_distance > body.radius:
        raise ValueError(
            f"the least distance of a position is {least_distance:g}, and the radius of the planet {body.radius:g} in "
            "its units, metres for the Earth; give positions from the centre in these, or another planet="
        )
    if v is not None:
        check_velocities(times, r, v)
    return sampled_orbit(times, r, v, degree, read_frame(frame), read_epoch(epoch, time_system), body)


def check_sizes(*values: Floats) -> None:
    """Raise ValueError for numbers whose products overflow."""
    for array in values:
        if not np.abs(array).max() < LARGEST:
            raise ValueError(f"a position or velocity is {np.abs(array).max():.3g}; give numbers below {LARGEST:g}")


def check_velocities(t: Floats, r: Floats, v: Floats) -> None:
    """Raise ValueError for velocities that are not the derivatives of positions, as in other units."""
    check_sizes(r, v)
    chord = np.diff(r, axis=0)
    ahead = 0.5 * np.diff(t)[:, None] * (v[1:] + v[:-1])
    sizes = np.sqrt((chord * chord).sum(axis=1))
    off = np.sqrt(((ahead - chord) ** 2).sum(axis=1))
    if np.median(off) > CONTRADICTION * np.median(sizes):
        ratio = np.sqrt((ahead * ahead).sum(axis=1)).mean() / sizes.mean()
        raise ValueError(
            f"velocity contradicts position: it moves {ratio:.3g} times as far as the positions between samples; give "
            "both in one unit of length and the unit of t, or more samples, or positions alone"
        )


def sampled_orbit(
    t: Floats,
    r: Floats,
    v: Floats | None,
    degree: int,
    frame: str,
    epoch: Epoch | None,
    planet: Planet | None,
    error: float | None = None,
) -> Orbit:
    """Return the orbit of a spline; its error is estimated if none was measured."""
    spline = hermite_spline(t, r, v, degree)
    if error is None:
        error = _error_of_half(t, r, v, degree)
    return Orbit(*spline.functions(), spline.span, frame, epoch, planet, error)


def _error_of_half(t: Floats, r: Floats, v: Floats | None, degree: int) -> float:
    """Return the largest distance of the spline through every second sample from the others; infinite for few."""
    kept = np.unique(np.append(np.arange(0, len(t), 2), len(t) - 1))
    if len(kept) < 3:
        return float("inf")
    position, _, _ = hermite_spline(t[kept], r[kept], None if v is None else v[kept], degree).functions()
    others = np.setdiff1d(np.arange(len(t)), kept)
    # All of some thousand samples, some hundred of more.
    others = others[:: max(1, len(others) // 500)]
    return float(max((np.linalg.norm(position(t[k]) - r[k]) for k in others), default=0.0))
