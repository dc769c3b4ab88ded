"""Kovalevskaya's top: I1 = I2 = 2 I3, with the centre of mass in the equatorial plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.classical_body import ClassicalBody
from coadjoint.systems.bodies.heavy_top import energy_under_gravity, top_under_gravity
from coadjoint.systems.bodies.inertia import read_moment, read_vector
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import ready_made


def _energy(equatorial: Any, lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return energy_under_gravity(1.0 / equatorial / np.array((1.0, 1.0, 0.5)), np.array([lever[0], lever[1], 0.0]))


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.5, 1.5, 0.6, 0.0, 0.8),
        t_span=(0.0, 60.0),
        step=0.02,
        caption="An integrable top: the motion is quasi-periodic on a torus of two dimensions, which the "
        "paths of the third axis in space (middle) and of the vertical, seen from the body (right), begin to fill.",
        pictures=(
            Picture("body axis", axis=2, up=(3, 4, 5), vertical="vertical"),
            Picture("directions", vectors={r"vertical $\gamma$": (3, 4, 5)}, title="the vertical, seen from the body"),
        ),
        components=Picture("components", chosen=(0, 1, 2), quantity="angular momentum"),
        attitude=True,
        coordinates=("m1", "m2", "m3", "gamma1", "gamma2", "gamma3"),
        quantity="momentum and vertical",
    ),
)
def kovalevskaya_top(equatorial: float = 2.0, lever: npt.ArrayLike = (1.0, 0.0)) -> ClassicalBody:
    """Return Kovalevskaya's top: a heavy top with ``I1 = I2 = 2 I3``, the centre of mass in the plane of axes 1, 2.

    State, sign -1, Casimirs and group element are those of `heavy_top`. It is the third and last integrable heavy top,
    with the integral ``K = |(m1 + i m2)^2 / (2 I1) - (l1 + i l2)(gamma1 + i gamma2)|^2``. For other axes use
    `heavy_top`.

    Parameters
    ----------
    equatorial : float
        Moment of inertia I1 = I2 about the fixed point (mass times length squared), positive; I3 is half of it.
    lever : (2,)
        Weight times the position of the centre of mass along the axes 1 and 2 (an energy).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With the integral ``"K"`` (energy squared).

    Raises
    ------
    ValueError
        The moment is not positive, or `lever` is not two finite numbers.

    Notes
    -----
    Kowalevski, "Sur le probleme de la rotation d'un corps solide autour d'un point fixe", Acta Mathematica 12 (1889).

    Examples
    --------
    >>> top = kovalevskaya_top(equatorial=2.0, lever=(1.0, 0.0))
    >>> top.vector_field([2.0, 4.0, 3.0, 1.0, 3.0, 4.0])
    array([ 6.,  1., -3.,  1.,  1., -1.])
    >>> top.integrals["K"]([2.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    1.0
    """
    moment = read_moment(equatorial, "equatorial", 0.5)
    u, v = read_vector(lever, "lever", 2).tolist()
    parameters = {"equatorial": moment, "lever": (u, v)}
    return top_under_gravity(_energy(**parameters), "kovalevskaya_top", parameters)
