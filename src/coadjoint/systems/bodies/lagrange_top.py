"""Lagrange's top: symmetric, with the centre of mass on its axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.classical_body import ClassicalBody
from coadjoint.systems.bodies.heavy_top import energy_under_gravity, top_under_gravity
from coadjoint.systems.bodies.inertia import read_moment, warn_unphysical_inertia
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_number


def _energy(equatorial: Any, axial: Any, lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    moments = np.array([equatorial, equatorial, axial])
    return energy_under_gravity(1.0 / moments, np.array([0.0, 0.0, lever]))


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(0.0, 0.0, 3.0, 0.8660254037844386, 0.0, 0.5),
        t_span=(0.0, 24.0),
        step=0.02,
        caption="Released with its axis at rest, inclined by 60 degrees: the axis nutates between cusps, in which "
        "it is at rest, and precesses about the vertical.",
        pictures=(
            Picture("nutation", axis=2, up=(3, 4, 5)),
            Picture("body axis", axis=2, up=(3, 4, 5), vertical="vertical"),
        ),
        components=Picture("components", chosen=(0, 1, 2), quantity="angular momentum"),
        attitude=True,
        coordinates=("m1", "m2", "m3", "gamma1", "gamma2", "gamma3"),
        quantity="momentum and vertical",
    ),
)
def lagrange_top(equatorial: float = 1.0, axial: float = 0.5, lever: float = 1.0) -> ClassicalBody:
    """Return Lagrange's top: a heavy top with ``I1 = I2`` and the centre of mass on the third axis.

    State, sign -1, Casimirs and group element are those of `heavy_top`. The momentum along the axis, m3, is an
    integral, so the motion is integrable. The upright position is stable (a sleeping top) if
    ``m3^2 > 4 equatorial lever``. For other axes use `heavy_top`.

    Parameters
    ----------
    equatorial, axial : float
        Moments of inertia about the fixed point (mass times length squared): across the axis and about it. Positive.
    lever : float
        Weight times the distance of the centre of mass along the axis (an energy); negative if the centre of mass is
        below the fixed point when the axis points up.

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With the integral ``"m3"``.

    Raises
    ------
    ValueError
        A moment is not positive, or a number not finite.

    Warns
    -----
    UserWarning
        The axial moment exceeds twice the equatorial one, which is impossible for a body.

    Notes
    -----
    Lagrange, "Mechanique analitique" (1788); Audin, "Spinning Tops" (1996), chapter II.

    Examples
    --------
    >>> top = lagrange_top(equatorial=1.0, axial=0.5, lever=2.0)
    >>> top.energy([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    3.5
    >>> top.integrals
    {'m3': m3}
    """
    parameters = {
        "equatorial": read_moment(equatorial, "equatorial"),
        "axial": read_moment(axial, "axial"),
        "lever": read_number(lever, "lever"),
    }
    across, along = parameters["equatorial"], parameters["axial"]
    warn_unphysical_inertia((across, across, along), "e(3)", "axial")
    return top_under_gravity(_energy(**parameters), "lagrange_top", parameters)
