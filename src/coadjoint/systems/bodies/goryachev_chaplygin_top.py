"""The Goryachev-Chaplygin top: I1 = I2 = 4 I3, with the centre of mass in the equatorial plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.bodies.classical_body import ClassicalBody
from coadjoint.systems.bodies.heavy_top import energy_under_gravity, top_under_gravity
from coadjoint.systems.bodies.inertia import read_moment, read_vector
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import ready_made


def _energy(equatorial: Any, lever: Any) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    return energy_under_gravity(1.0 / equatorial / np.array((1.0, 1.0, 0.25)), np.array([lever[0], lever[1], 0.0]))


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(0.0, 4.0, 3.0, 0.6, -0.48, 0.64),
        t_span=(0.0, 60.0),
        step=0.02,
        caption="Without angular momentum about the vertical the top is integrable: the vertical, seen from the body "
        "(right), moves within a band of its sphere.",
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
def goryachev_chaplygin_top(equatorial: float = 4.0, lever: npt.ArrayLike = (1.0, 0.0)) -> ClassicalBody:
    """Return the Goryachev-Chaplygin top: ``I1 = I2 = 4 I3``, the centre of mass in the plane of axes 1 and 2.

    State, sign -1, Casimirs and group element are those of `heavy_top`. It is integrable only if the vertical momentum
    m . gamma is zero. Its additional integral is therefore not in ``integrals``, which hold for all states:
    `goryachev_chaplygin_integral` returns it, for ``observe``.

    Parameters
    ----------
    equatorial : float
        Moment of inertia I1 = I2 about the fixed point (mass times length squared), positive; I3 is a quarter of it.
    lever : (2,)
        Weight times the position of the centre of mass along the axes 1 and 2 (an energy).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.

    Raises
    ------
    ValueError
        The moment is not positive, or `lever` is not two finite numbers.

    Notes
    -----
    Goryachev, Mat. Sbornik 21 (1900); Chaplygin, Trudy Otd. Fiz. Nauk 12 (1904); Audin, "Spinning Tops" (1996).

    Examples
    --------
    >>> top = goryachev_chaplygin_top(equatorial=4.0, lever=(1.0, 0.0))
    >>> top.vector_field([4.0, 8.0, 3.0, 1.0, 3.0, 4.0])
    array([18., -5., -3.,  1.,  1., -1.])
    """
    size = read_moment(equatorial, "equatorial", 0.25)
    u, v = read_vector(lever, "lever", 2).tolist()
    parameters = {"equatorial": size, "lever": (u, v)}
    return top_under_gravity(_energy(**parameters), "goryachev_chaplygin_top", parameters)


def goryachev_chaplygin_integral(equatorial: float = 4.0, lever: npt.ArrayLike = (1.0, 0.0)) -> Polynomial:
    """Return ``m3 (m1^2 + m2^2) / I1 - gamma3 (l1 m1 + l2 m2)``, an integral of the top if m . gamma is zero.

    Otherwise it changes at the rate ``(l2 m1 - l1 m2)(m . gamma) / I1``.

    Parameters
    ----------
    equatorial : float
        As for `goryachev_chaplygin_top`.
    lever : (2,)
        As for `goryachev_chaplygin_top`.

    Returns
    -------
    Polynomial
        In six coordinates.

    Raises
    ------
    ValueError
        As for `goryachev_chaplygin_top`.

    Examples
    --------
    >>> goryachev_chaplygin_integral()
    -x1*x6 + 0.25*x1^2*x3 + 0.25*x2^2*x3
    """
    size = read_moment(equatorial, "equatorial", 0.25)
    u, v = read_vector(lever, "lever", 2).tolist()
    m1, m2, m3, gamma3 = (Polynomial.variable(i, 6) for i in (0, 1, 2, 5))
    return 1.0 / size * (m3 * (m1**2 + m2**2)) - gamma3 * (u * m1 + v * m2)
