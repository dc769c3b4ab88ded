"""An ideal fluid in two dimensions truncated to three waves: a triad, and the equations of Lorenz (1960)."""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.closed_forms.free_rigid_body import rigid_body_equivalent
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_positive


def _waves(system: Any, X: Any, Y: Any) -> Any:
    """Return the three waves cos(k . r) at the points (X, Y)."""
    (a, b), (c, d) = system.parameters["first"], system.parameters["second"]
    return np.cos([a * X + b * Y, c * X + d * Y, (a + c) * X + (b + d) * Y])


def _two_waves(system: Any) -> float:
    """Return twice the longest wavelength."""
    (a, b), (c, d) = system.parameters["first"], system.parameters["second"]
    return 4.0 * math.pi / min(math.hypot(a, b), math.hypot(c, d), math.hypot(a + c, b + d))


@ready_made(
    gallery_entry=GalleryEntry(
        x0=(0.02, 1.0, 0.02),
        t_span=(0.0, 80.0),
        step=0.05,
        caption="The wave of middle length is unstable: its amplitude passes to the two others and comes back with "
        "the opposite sign. Middle, the vorticity at the start; right, when the waves have changed it most.",
        pictures=(
            Picture("field", modes=_waves, width=_two_waves, at=0.0, label="vorticity"),
            Picture("field", modes=_waves, width=_two_waves, at=0.275, label="vorticity"),
        ),
        components=Picture("components", flips=1),
        quantity="vorticity",
    )
)
def fluid_triad(first: npt.ArrayLike = (1.0, 0.0), second: npt.ArrayLike = (0.5, 1.5)) -> LiePoissonSystem:
    """Return a triad of waves of the two-dimensional Euler equations, equivalent to a rigid body.

    The vorticity ``sum of x_i cos(k_i . r)`` has three waves with k1 + k2 + k3 = 0, and the Euler equations are
    truncated to these: ``x1' = (S/2) (1/k3^2 - 1/k2^2) x2 x3`` and cyclic, S = k1 cross k2. The algebra is so(3) with
    brackets S, sign -1, and H is the mean kinetic energy ``sum of x_i^2 / (4 k_i^2)``. The wave of middle length is
    unstable, as the middle axis of a rigid body.

    Parameters
    ----------
    first, second : (2,)
        Wave vectors k1 and k2 (1/length), not parallel; ``k3 = -k1 - k2``.

    Returns
    -------
    LiePoissonSystem
        State: the amplitudes of vorticity (x1, x2, x3), per unit of time. Casimir: the mean enstrophy, ``(x1^2 + x2^2 +
        x3^2) / 4``. ``exact(x0, t)`` in closed form. There is no representation, because a group element has no
        meaning for the fluid.

    Raises
    ------
    ValueError
        Not two finite numbers each, parallel vectors (whose waves do not interact), or squares beyond float64.

    Notes
    -----
    Kraichnan, Phys. Fluids 10, 1417 (1967), for the triad; Waleffe, Phys. Fluids A 4, 350 (1992), for its instability.

    Examples
    --------
    >>> triad = fluid_triad(first=(1.0, 0.0), second=(0.0, 2.0))
    >>> triad.vector_field([1.0, 1.0, 1.0])
    array([-0.05,  0.8 , -0.75])
    """
    k1, k2 = _wave(first, "first"), _wave(second, "second")
    k3 = (-k1[0] - k2[0], -k1[1] - k2[1])
    area = k1[0] * k2[1] - k1[1] * k2[0]
    if area == 0:
        raise ValueError(f"first {short(first)} and second {short(second)} are parallel; give others that are not")
    try:
        S = float(area)
        masses = tuple(float(1 / (2 * (x * x + y * y))) for x, y in (k1, k2, k3))
    except OverflowError:
        S, masses = 0.0, ()
    if S == 0.0 or 0.0 in masses:
        raise ValueError(
            f"first {short(first)} and second {short(second)} leave the range of float64 when squared; take other units"
        )
    parameters = {"first": tuple(map(float, k1)), "second": tuple(map(float, k2))}
    return _truncated("fluid_triad", parameters, (S, S, S), masses, Fraction(1, 4))


def _wave(argument: npt.ArrayLike, name: str) -> tuple[Fraction, Fraction]:
    x, y = read_vector(argument, name, 2).tolist()
    return Fraction(x), Fraction(y)


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
    return _truncated("lorenz_1960", {"k": k, "l": l}, (c, c, 2.0 * c), masses, Fraction(1, 2))


def _truncated(
    name: str,
    parameters: dict[str, Any],
    brackets: tuple[float, float, float],
    masses: tuple[float, ...],
    third: Fraction,
) -> LiePoissonSystem:
    """Return three waves; the enstrophy has the coefficients 1/4, 1/4 and `third` of their squares."""
    quarter, (a, b, c) = Fraction(1, 4), masses
    enstrophy = Polynomial({(2, 0, 0): quarter, (0, 2, 0): quarter, (0, 0, 2): third})
    return rigid_body_equivalent(brackets, (a, b, c), {"enstrophy": enstrophy}, name, parameters)
