"""Circles and ellipses about a planet, whose plane, pericentre and mean anomaly may drift by its oblateness."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.forces.body_torque import cross
from coadjoint.systems.orbits.epochs import rotation
from coadjoint.systems.orbits.kepler_equation import eccentric_anomaly
from coadjoint.systems.orbits.orbit import EARTH, Orbit, Planet, read_epoch, read_frame, read_planet
from coadjoint.validation import read_bool, read_number, read_positive

OfTime = Callable[..., Any]


@suggest_keywords
def circular(
    radius: float,
    inclination: float = 0.0,
    node: float = 0.0,
    argument: float = 0.0,
    *,
    planet: Planet = EARTH,
    drift: bool = False,
    degrees: bool = False,
    epoch: Any = None,
    time_system: str = "UTC",
    frame: str = "",
) -> Orbit:
    """Return a circular orbit.

    Choose it for studies of a mission before there is a satellite; for a satellite that flies take `from_tle`, and for
    an ellipse `kepler`.

    Parameters
    ----------
    radius : float
        Distance from the centre, not the height: metres for the Earth.
    inclination, node, argument : float
        Inclination to the equator, right ascension of the ascending node, and angle from the node at t = 0.
    planet : Planet
        The body in the centre; the Earth in SI units by default.
    drift : bool
        Whether the node and the angle drift at their mean rates by J2 of the planet.
    degrees : bool
        Whether angles are in degrees; radians by default.
    epoch : str, datetime.datetime or Epoch, optional
        Date at t = 0, which the direction of the sun and the field of the Earth need.
    time_system : {"UTC", "UT1", "TAI", "GPS", "TT", "TDB"}
        Of the epoch.
    frame : str
        Name of the inertial frame, such as "J2000" or "TEME"; needed as the epoch is.

    Returns
    -------
    Orbit

    Raises
    ------
    ValueError, TypeError
        A radius below that of the planet, as one in kilometres, or arguments of other types.

    Examples
    --------
    >>> import coadjoint as co
    >>> orbit = co.orbits.circular(6.878e6, inclination=97.4, degrees=True)
    >>> bool(abs(np.linalg.norm(orbit.position(1000.0)) - 6.878e6) < 1e-6)
    True
    """
    return _orbit(radius, 0.0, inclination, node, 0.0, argument, planet, drift, degrees, epoch, time_system, frame)


@suggest_keywords
def kepler(
    semi_major_axis: float,
    eccentricity: float = 0.0,
    inclination: float = 0.0,
    node: float = 0.0,
    pericentre: float = 0.0,
    mean_anomaly: float = 0.0,
    *,
    planet: Planet = EARTH,
    drift: bool = False,
    degrees: bool = False,
    epoch: Any = None,
    time_system: str = "UTC",
    frame: str = "",
) -> Orbit:
    """Return an elliptic orbit from its elements at t = 0.

    Choose it for ellipses about a point, and with ``drift=True`` for the secular motion of orbits about an oblate
    planet, such as sun-synchronous ones. Periodic terms of J2 (some kilometres for the Earth), drag and other bodies
    are left out.

    Parameters
    ----------
    semi_major_axis : float
        Length, metres for the Earth.
    eccentricity : float
        From 0 to less than 1.
    inclination, node, pericentre, mean_anomaly : float
        Inclination to the equator, right ascension of the ascending node, argument of the pericentre, mean anomaly.
    planet : Planet
        The body in the centre; the Earth in SI units by default.
    drift : bool
        Whether node, pericentre and mean anomaly drift at their mean rates by J2 of the planet. Elements are mean ones.
    degrees : bool
        Whether angles are in degrees; radians by default.
    epoch : str, datetime.datetime or Epoch, optional
        Date at t = 0, which the direction of the sun and the field of the Earth need.
    time_system : {"UTC", "UT1", "TAI", "GPS", "TT", "TDB"}
        Of the epoch.
    frame : str
        Name of the inertial frame, such as "J2000" or "TEME"; needed as the epoch is.

    Returns
    -------
    Orbit

    Raises
    ------
    ValueError, TypeError
        Elements out of range, or an ellipse that enters the planet, as one in kilometres.

    Notes
    -----
    With ``n = sqrt(mu/a^3)``, ``p = a (1 - e^2)`` and ``k = n J2 (R/p)^2`` the rates are ``-1.5 k cos i`` of the node,
    ``0.75 k (5 cos^2 i - 1)`` of the pericentre and ``n + 0.75 k sqrt(1 - e^2) (3 cos^2 i - 1)`` of the mean anomaly.
    D. A. Vallado, Fundamentals of Astrodynamics and Applications (2013), chapter 9.

    Examples
    --------
    The plane of a sun-synchronous orbit turns once a year:

    >>> import coadjoint as co
    >>> orbit = co.orbits.kepler(7.078e6, 0.001, 98.19, drift=True, degrees=True)
    >>> normals = [orbit.local_frame()(t)[:2, 2] for t in (0.0, 86400.0)]
    >>> a, b = (np.arctan2(x, -y) for x, y in normals)
    >>> round(float(np.degrees(b - a)), 2)
    0.98
    """
    return _orbit(
        semi_major_axis,
        eccentricity,
        inclination,
        node,
        pericentre,
        mean_anomaly,
        planet,
        drift,
        degrees,
        epoch,
        time_system,
        frame,
    )


def _orbit(
    size: Any,
    eccentricity: Any,
    inclination: Any,
    node: Any,
    pericentre: Any,
    anomaly: Any,
    planet: Any,
    drift: Any,
    degrees: Any,
    epoch: Any,
    time_system: Any,
    frame: Any,
) -> Orbit:
    """Return the orbit of elements; see `kepler`."""
    a, e = read_positive(size, "the size of an orbit"), read_number(eccentricity, "eccentricity")
    if not 0.0 <= e < 1.0:
        raise ValueError(
            f"eccentricity is {e:g}; give a number from 0 to less than 1, and for a flyby samples to "
            "co.orbits.from_samples"
        )
    body, unit = read_planet(planet), pi / 180.0 if read_bool(degrees, "degrees") else 1.0
    if not a * (1.0 - e) > body.radius:
        raise ValueError(
            f"the least distance of the orbit is {a * (1.0 - e):g}, and the radius of the planet {body.radius:g} in "
            "its units, metres for the Earth; give the distance from the centre in these, or another planet="
        )
    given = {"inclination": inclination, "node": node, "pericentre": pericentre, "mean anomaly": anomaly}
    angles = [unit * read_number(value, name) for name, value in given.items()]
    position, velocity, acceleration = (_drifting if read_bool(drift, "drift") else _at_rest)(body, a, e, *angles)
    return Orbit(
        position,
        velocity,
        acceleration,
        frame=read_frame(frame),
        epoch=read_epoch(epoch, time_system),
        planet=body,
    )


def _plane(i: float, node: float, pericentre: float) -> Any:
    """Return the axes of an ellipse, the first one toward the pericentre, as rows."""
    return rotation(2, pericentre) @ rotation(0, i) @ rotation(2, node)


def _anomaly(e: float) -> OfTime:
    """Return the eccentric anomaly as a function of the mean one."""
    return (lambda M: eccentric_anomaly(M, e)) if e else (lambda M: M)


def _at_rest(
    body: Planet, a: float, e: float, i: float, node: float, pericentre: float, M0: float
) -> tuple[OfTime, OfTime, None]:
    P, Q, _ = _plane(i, node, pericentre)
    rate, shape, anomaly = sqrt(body.mu / a) / a, sqrt((1.0 - e) * (1.0 + e)), _anomaly(e)

    def position(t: Any) -> Any:
        E = anomaly(M0 + rate * t)
        return (a * (np.cos(E) - e)) * P + (a * shape * np.sin(E)) * Q

    def velocity(t: Any) -> Any:
        E = anomaly(M0 + rate * t)
        c, s = np.cos(E), np.sin(E)
        speed = a * rate / (1.0 - e * c)
        return (-speed * s) * P + (speed * shape * c) * Q

    return position, velocity, None


def drift_rates(body: Planet, a: float, e: float, i: float) -> tuple[float, float, float]:
    """Return the rates of node, pericentre and mean anomaly by J2."""
    n = sqrt(body.mu / a) / a
    k = n * body.j2 * (body.radius / (a * (1.0 - e) * (1.0 + e))) ** 2
    shape = sqrt((1.0 - e) * (1.0 + e))
    return -1.5 * k * cos(i), 0.75 * k * (5.0 * cos(i) ** 2 - 1.0), n + 0.75 * k * shape * (3.0 * cos(i) ** 2 - 1.0)


def _drifting(
    body: Planet, a: float, e: float, i: float, node0: float, pericentre0: float, M0: float
) -> tuple[OfTime, OfTime, OfTime]:
    if not body.j2 or not body.radius:
        raise ValueError(f"drift is True, and the planet has no j2 or no radius: {body}; give both, or drift=False")
    of_node, of_pericentre, rate = drift_rates(body, a, e, i)
    shape, anomaly, ci, si = sqrt((1.0 - e) * (1.0 + e)), _anomaly(e), cos(i), sin(i)
    both = of_node * of_pericentre

    def axes(t: Any) -> Any:
        """Return the axes toward the pericentre and normal to the plane."""
        w, W = pericentre0 + of_pericentre * t, node0 + of_node * t
        cw, sw, cW, sW = np.cos(w), np.sin(w), np.cos(W), np.sin(W)
        P, Z = np.zeros(3), np.zeros(3)
        P[0], P[1], P[2] = cw * cW - sw * ci * sW, cw * sW + sw * ci * cW, sw * si
        Z[0], Z[1], Z[2] = si * sW, -si * cW, ci
        return P, Z

    def position(t: Any) -> Any:
        E = anomaly(M0 + rate * t)
        P, Z = axes(t)
        return (a * (np.cos(E) - e)) * P + (a * shape * np.sin(E)) * cross(Z, P)

    def turned(r: Any, Z: Any) -> Any:
        """Return the velocity of a point at rest in the axes of the ellipse."""
        result = of_pericentre * cross(Z, r)
        result[0] -= of_node * r[1]
        result[1] += of_node * r[0]
        return result

    def velocity(t: Any) -> Any:
        E = anomaly(M0 + rate * t)
        P, Z = axes(t)
        Q, c, s = cross(Z, P), np.cos(E), np.sin(E)
        speed = a * rate / (1.0 - e * c)
        return (-speed * s) * P + (speed * shape * c) * Q + turned((a * (c - e)) * P + (a * shape * s) * Q, Z)

    def acceleration(t: Any) -> Any:
        E = anomaly(M0 + rate * t)
        P, Z = axes(t)
        Q, c, s = cross(Z, P), np.cos(E), np.sin(E)
        speed = a * rate / (1.0 - e * c)
        r, v = (a * (c - e)) * P + (a * shape * s) * Q, (-speed * s) * P + (speed * shape * c) * Q
        # The change of the angular velocity is that of Z, which turns with the node.
        change = np.zeros(3)
        change[0], change[1] = -both * Z[1], both * Z[0]
        radius = a * (1.0 - e * c)
        inward = -(rate * rate) * (a / radius) ** 3 * r
        return inward + 2.0 * turned(v, Z) + turned(turned(r, Z), Z) + cross(change, r)

    return position, velocity, acceleration
