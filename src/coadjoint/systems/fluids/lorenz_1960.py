"""Lorenz's maximum simplification of the dynamic equations of the atmosphere."""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.free_rigid_body import rigid_body_equivalent
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_positive


def _states(count: int) -> npt.NDArray[np.float64]:
    """Return states of equal enstrophy, A^2 + F^2 + 2 G^2 = 1."""
    return points_on_sphere(count) * (1.0, 1.0, 0.5**0.5)


@ready_made(
    gallery_entry=GalleryEntry(
        x0=partial(_states, 14),
        t_span=(0.0, 30.0),
        step=0.02,
        caption="Fourteen motions with one enstrophy, on its ellipsoid: the zonal current A and the waves F and G "
        "exchange their vorticity, around the current, which is stable for k > l, or around the wave G.",
        pictures=(Picture("coadjoint orbit"),),
        components=Picture("components", chosen=(0,)),
        coordinates=("A", "F", "G"),
        quantity="vorticity",
    )
)
def lorenz_1960(k: float = 2.0, l: float = 1.0) -> LiePoissonSystem:
    """Return the three equations of Lorenz (1960) for a zonal current and waves, equivalent to a rigid body.

    The vorticity ``A cos(l y) + F cos(k x) + 2 G sin(l y) sin(k x)`` of an ideal fluid, truncated to these waves:
    ``A' = -(1/k^2 - 1/(k^2 + l^2)) k l F G``, ``F' = (1/l^2 - 1/(k^2 + l^2)) k l A G``,
    ``G' = -(1/l^2 - 1/k^2) k l A F / 2``. The algebra is so(3) with brackets k l, k l, 2 k l, sign -1, and H is the
    mean kinetic energy ``A^2/(4 l^2) + F^2/(4 k^2) + G^2/(2 (k^2 + l^2))``. In coordinates (A, F, sqrt(2) G) it is the
    rigid body with inverse moments 1/(2 l^2), 1/(2 k^2), 1/(2 (k^2 + l^2)), sqrt(2) k l times as fast.

    Parameters
    ----------
    k, l : float
        Wave numbers along x and y (1/length), positive. The current A can be unstable only if k < l.

    Returns
    -------
    LiePoissonSystem
        State (A, F, G), vorticities, per unit of time. Casimir: the mean enstrophy, ``(A^2 + F^2 + 2 G^2) / 4``.
        ``exact(x0, t)`` in closed form. There is no representation, because a group element has no meaning for the
        fluid.

    Raises
    ------
    ValueError
        k or l is not positive, or its square leaves the range of float64.

    Notes
    -----
    Lorenz, "Maximum simplification of the dynamic equations", Tellus 12, 243 (1960).

    Examples
    --------
    >>> lorenz_1960(k=2.0, l=1.0).vector_field([1.0, 1.0, 1.0])
    array([-0.1 ,  1.6 , -0.75])
    """
    k, l = read_positive(k, "k"), read_positive(l, "l")
    k2, l2 = Fraction(k) ** 2, Fraction(l) ** 2
    try:
        masses = tuple(float(1 / (2 * square)) for square in (l2, k2, (k2 + l2) / 2))
        c = float(Fraction(k) * Fraction(l))
        out_of_range = 0.0 in (*masses, c) or 2.0 * c == float("inf")
    except OverflowError:
        out_of_range = True
    if out_of_range:
        raise ValueError(f"the squares of k = {k:g} and l = {l:g} leave the range of float64; take other units")
    quarter = Fraction(1, 4)
    return rigid_body_equivalent(
        (c, c, 2.0 * c),
        (masses[0], masses[1], masses[2]),
        {"enstrophy": Polynomial({(2, 0, 0): quarter, (0, 2, 0): quarter, (0, 0, 2): 2 * quarter})},
        "lorenz_1960",
        {"k": k, "l": l},
    )
