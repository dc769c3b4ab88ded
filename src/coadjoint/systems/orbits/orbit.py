"""Orbits: position and velocity as functions of the time, and what follows from them: local axes, sunlight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.body_torque import cross, read_prescribed
from coadjoint.systems.orbits.epochs import DAY, EARTH_FIXED, Epoch, is_of_date
from coadjoint.systems.time_spans import ALWAYS, Span, limited, time_span_of
from coadjoint.validation import read_bool, read_finite, read_nonnegative, read_numbers, read_positive, set_fields

Floats = npt.NDArray[np.float64]
OfTime = Callable[..., Any]

SUN_RADIUS = 0.004652
"""Angular radius of the sun seen from the Earth, in radians."""


@suggest_keywords
@dataclass(frozen=True)
class Planet:
    """What orbits need to know of the body that they go about, in SI units or in units of your own.

    Parameters
    ----------
    mu : float
        Gravitational constant times the mass (length cubed over time squared).
    radius : float
        Equatorial radius (length): of shadows, of the J2 term, and the least distance of an orbit; 0 is a point.
    j2 : float
        Coefficient of the oblateness, without unit.

    Raises
    ------
    ValueError, TypeError
        Numbers that are negative or not finite.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.orbits.circular(1.0, planet=co.orbits.Planet(mu=1.0)).position(0.0)
    array([1., 0., 0.])
    """

    mu: float
    radius: float = 0.0
    j2: float = 0.0

    def __post_init__(self) -> None:
        set_fields(
            self,
            mu=read_positive(self.mu, "mu of a planet"),
            radius=read_nonnegative(self.radius, "radius of a planet"),
            j2=read_nonnegative(self.j2, "j2 of a planet"),
        )


EARTH = Planet(3.986004418e14, 6378137.0, 1.08262668e-3)
"""The Earth in SI units: WGS 84, and J2 of EGM96."""


class OrbitStates(NamedTuple):
    """Positions and velocities at times.

    Attributes
    ----------
    position : ndarray, shape (3,) or (k, 3)
        From the centre, along the axes of the frame of the orbit.
    velocity : ndarray, shape (3,) or (k, 3)
        Their derivatives.
    """

    position: Floats
    velocity: Floats


@suggest_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Orbit:
    """An orbit: functions of the time, in seconds or the unit of the planet, that forces on satellites take.

    `circular`, `kepler`, `from_tle`, `from_samples` and `read_oem` make it; ``Orbit(position, velocity)`` is one of
    functions of your own. All functions are compiled by Numba where a
    force calls them, and other orbits of the same kind are run by the same machine code. Vectors have components along
    the axes of `frame`.

    Attributes
    ----------
    position, velocity : callable
        Functions of the time that return three numbers. The velocity is the derivative of the position.
    t_span : (float, float)
        Where the orbit is known; infinite for formulas. Runs beyond are refused before the first step, and calls raise
        a ValueError.
    frame : str
        Name of the inertial frame, such as "TEME" or "J2000"; "" if none was given.
    epoch : Epoch or None
        Date at t = 0.
    planet : Planet or None
        The body in the centre.
    acceleration : callable or None
        The derivative of the velocity; None if the acceleration is in the plane of position and velocity.
    sampling_error : float
        Of sampled orbits, an estimate of the largest error of the position between samples; 0 for formulas.

    Examples
    --------
    >>> import coadjoint as co
    >>> orbit = co.orbits.circular(7.0e6, inclination=98.0, degrees=True)
    >>> pull = co.forces.GravityGradient(orbit.planet.mu, orbit.position)
    >>> point = co.forces.Pointing(0.01, 0.5, orbit.local_frame(), rate=orbit.local_rate)
    >>> sat = co.systems.body((4.0, 5.0, 6.0)).with_forces(pull, point)
    >>> x0 = sat.state(orbit.local_frame()(0.0), angular_velocity=orbit.local_rate(0.0), frame="space")
    >>> sol = co.integrate(sat, x0, (0, 600), 1.0)
    """

    position: OfTime
    velocity: OfTime
    acceleration: OfTime | None = field(default=None)
    t_span: Span = ALWAYS
    frame: str = ""
    epoch: Epoch | None = None
    planet: Planet | None = None
    sampling_error: float = 0.0

    def __post_init__(self) -> None:
        first, last = read_numbers(self.t_span, "t_span of an orbit").tolist()
        if not first < last:
            raise ValueError(f"t_span of an orbit is {short(self.t_span)}; give the start and the end, which is later")
        named = ("position", "velocity", *([] if self.acceleration is None else ["acceleration"]))
        for name in named:
            function = getattr(self, name)
            if not callable(function):
                raise TypeError(f"{name} of an orbit is {short(function)}; give a function of the time t")
            span = time_span_of(function)
            wanted = max(first, span[0]), min(last, span[1])
            if wanted != span:
                function = limited(function, wanted)
            set_fields(self, **{name: read_prescribed(function, f"{name} of an orbit")})
        set_fields(
            self,
            t_span=time_span_of(self.position),
            frame=read_frame(self.frame),
            epoch=None if self.epoch is None else Epoch.read(self.epoch, "epoch of an orbit"),
            planet=None if self.planet is None else read_planet(self.planet),
            sampling_error=float(self.sampling_error),
        )

    def __repr__(self) -> str:
        known = "" if self.t_span == ALWAYS else f" from t = {self.t_span[0]:g} to {self.t_span[1]:g}"
        frame = f" in {self.frame}" if self.frame else ""
        return f"<orbit{frame}{known}{f', t = 0 at {self.epoch}' if self.epoch else ''}>"

    @property
    def time_span(self) -> Span:
        """The span of functions that call those of the orbit."""
        return self.t_span

    def within(self, t_span: Any) -> Orbit:
        """Return the orbit with a shorter span, outside of which it is refused.

        Parameters
        ----------
        t_span : (float, float)
            Start and end, within the span of the orbit.

        Returns
        -------
        Orbit

        Raises
        ------
        ValueError
            A span that does not lie within that of the orbit.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.orbits.circular(7.0e6).within((0, 100))
        <orbit from t = 0 to 100>
        """
        span = read_finite(t_span, "t_span")
        first, last = self.t_span
        if span.shape != (2,) or not first <= span[0] < span[1] <= last:
            raise ValueError(f"t_span is {short(t_span)}; give the start and the end, within {first:g} and {last:g}")
        ends = float(span[0]), float(span[1])
        if ends == self.t_span:
            return self
        return replace(self, t_span=ends)

    def at(self, t: npt.ArrayLike) -> OrbitStates:
        """Return positions and velocities at times.

        Parameters
        ----------
        t : array_like
            Times, a number or (k,).

        Returns
        -------
        OrbitStates

        Raises
        ------
        ValueError
            A time at which the orbit is not known.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.orbits.circular(7.0e6).at([0.0, 10.0]).position.shape
        (2, 3)
        """
        times = read_finite(t, "t")
        rows = [(self.position(one), self.velocity(one)) for one in times.ravel().tolist()]
        both = np.array(rows, dtype=np.float64).reshape(*times.shape, 2, 3)
        return OrbitStates(both[..., 0, :], both[..., 1, :])

    def local_frame(self, down: bool = False) -> OfTime:
        """Return the axes of the local vertical as a function of the time, an attitude that `Pointing` takes.

        Parameters
        ----------
        down : bool
            If False, the axes are X outward along the radius, Y along the orbit and Z normal to it, as those of
            `co.systems.satellite_on_orbit`. If True, X is along the orbit, Y against the normal and Z down (LVLH).

        Returns
        -------
        callable
            A function of the time that returns a rotation, (3, 3), whose columns are the axes in the frame of the
            orbit: the attitude of a body that is at rest in the local frame.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.orbits.circular(7.0e6).local_frame(down=True)(0.0).round(12) + 0.0
        array([[ 0.,  0., -1.],
               [ 1.,  0.,  0.],
               [ 0., -1.,  0.]])
        """
        return self._local_frames[read_bool(down, "down")]

    @cached_property
    def _local_frames(self) -> tuple[OfTime, OfTime]:
        position, velocity = self.position, self.velocity

        def axes(t: Any) -> Any:
            r, v = position(t), velocity(t)
            h, result = cross(r, v), np.zeros((3, 3))
            X = r / np.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
            Z = h / np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
            Y = cross(Z, X)
            for i in range(3):
                result[i, 0], result[i, 1], result[i, 2] = X[i], Y[i], Z[i]
            return result

        def axes_down(t: Any) -> Any:
            A = axes(t)
            result = np.zeros((3, 3))
            for i in range(3):
                result[i, 0], result[i, 1], result[i, 2] = A[i, 1], -A[i, 2], -A[i, 0]
            return result

        return axes, axes_down

    @cached_property
    def local_rate(self) -> OfTime:
        """Angular velocity of the local frame, along the axes of the frame of the orbit: a `rate` of `Pointing`."""
        position, velocity, acceleration = self.position, self.velocity, self.acceleration

        def planar(t: Any) -> Any:
            r, v = position(t), velocity(t)
            return cross(r, v) / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2])

        if acceleration is None:
            return planar

        def rate(t: Any) -> Any:
            r, v, a = position(t), velocity(t), acceleration(t)
            h = cross(r, v)
            across = (a[0] * h[0] + a[1] * h[1] + a[2] * h[2]) / (h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
            return h / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) + across * r

        return rate

    @cached_property
    def sun(self) -> OfTime:
        """Direction toward the sun from the Earth, a unit vector: the `sun` of `co.forces.SolarPressure`.

        It is that of the Astronomical Almanac, within 0.02 degrees from 1950 to 2050, in the frame of the orbit, which
        has an epoch and one of the frames "J2000", "EME2000", "GCRF", "ICRF", "TEME", "MOD", "TOD"; of the orbits about
        other planets it is refused.
        """
        return sun_direction(self)

    @cached_property
    def sunlight(self) -> OfTime:
        """The direction `sun` times the visible share of its disk: zero in the shadow of the Earth, which is round."""
        position, sun = self.position, self.sun
        planet = self.planet or EARTH
        radius, a = planet.radius, SUN_RADIUS

        def light(t: Any) -> Any:
            s, r = sun(t), position(t)
            distance = np.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
            b = np.arcsin(min(1.0, radius / distance))
            c = np.arccos(min(1.0, max(-1.0, -(r[0] * s[0] + r[1] * s[1] + r[2] * s[2]) / distance)))
            if c >= a + b:
                return s
            if c <= b - a:
                return 0.0 * s
            if c <= a - b:
                return (1.0 - (b / a) ** 2) * s
            # The disks of radius a and b, at the angle c, overlap (Montenbruck and Gill, Satellite Orbits, 3.4.2).
            x = (c * c + a * a - b * b) / (2.0 * c)
            y = np.sqrt(max(0.0, a * a - x * x))
            first, second = max(-1.0, min(1.0, x / a)), max(-1.0, min(1.0, (c - x) / b))
            hidden = a * a * np.arccos(first) + b * b * np.arccos(second) - c * y
            return (1.0 - hidden / (np.pi * a * a)) * s

        return light


def check_earth(orbit: Orbit, what: str) -> Epoch:
    """Return the epoch of an orbit about the Earth; ValueError for another planet, or without an epoch."""
    if orbit.planet is not None and orbit.planet != EARTH:
        raise ValueError(f"{what} is that of the Earth, and the planet of the orbit is {orbit.planet}")
    if orbit.epoch is None:
        raise ValueError(
            f"{what} needs a date, and the orbit has no epoch; give epoch='2024-03-20T03:06:00' and frame="
        )
    return orbit.epoch


def sun_direction(orbit: Orbit) -> OfTime:
    """Return the direction of the sun as a function of the time of an orbit, in its frame."""
    epoch = check_earth(orbit, "the direction of the sun")
    of_date = is_of_date(orbit.frame, "the direction of the sun")
    first, degree, day = epoch.dynamical_days, np.pi / 180.0, DAY
    # General precession and the change of the obliquity, which axes at rest do not take part in.
    precession, tilting = (0.0, -3.56e-7) if of_date else (3.82472e-5, 0.0)

    def sun(t: Any) -> Any:
        n = first + t / day
        g = degree * (357.528 + 0.9856003 * n)
        along = degree * (280.460 + (0.9856474 - precession) * n + 1.915 * np.sin(g) + 0.020 * np.sin(2.0 * g))
        tilt, result = degree * (23.4393 + tilting * n), np.zeros(3)
        result[0] = np.cos(along)
        result[1], result[2] = np.cos(tilt) * np.sin(along), np.sin(tilt) * np.sin(along)
        return result

    return sun


def read_frame(value: Any) -> str:
    """Validate the name of an inertial frame, or none."""
    if not isinstance(value, str):
        raise TypeError(f"frame is {short(value)}; give the name of an inertial frame, such as 'J2000'")
    if value.upper().startswith(EARTH_FIXED):
        raise ValueError(
            f"frame is {short(value)}, which turns with the Earth; give samples in an inertial frame, such as 'J2000'"
        )
    return value


def read_epoch(value: Any, time_system: Any) -> Epoch | None:
    """Validate a date in a time system, or none."""
    return None if value is None else Epoch.read(value, "epoch", time_system)


def read_planet(value: Any) -> Planet:
    """Validate a planet."""
    if not isinstance(value, Planet):
        raise TypeError(f"planet is {short(value)}; give co.orbits.EARTH, or co.orbits.Planet(mu, radius, j2)")
    return value
