"""Point vortices on the sphere and in the plane."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.families.products import copies
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.closed_forms.closed_form import move_state, rotate_about
from coadjoint.systems.fluids.modified_bessel import k0, k1_over_argument
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.systems.user_functions import ALL_SHARES, bodies_of_shares, number_of_shares
from coadjoint.validation import read_choice, read_finite, read_positive

Floats = npt.NDArray[np.float64]

AXES = {"plane": 2, "sphere": 3}
"""Coordinates of a position on each surface."""
MAX_VORTICES = 682  # of which each has a recorded Casimir, the limit of `copies`
MAX_CIRCULATION = MAX_RADIUS = 1e100
LAYOUTS: dict[str, dict[str, tuple[str, str]]] = {
    "plane": {"x": ("position", "length"), "y": ("position", "length"), "z": ("constant", "1")},
    "sphere": {"x": ("direction", "1"), "y": ("direction", "1"), "z": ("direction", "1")},
}


class PointVortices(LiePoissonSystem):
    """Point vortices; `state` makes a state of their places, and `places` returns them."""

    @property
    def circulations(self) -> Floats:
        """The circulations, (vortices,)."""
        return np.array((self._parameters or {})["circulations"])

    @property
    def surface(self) -> str:
        """The surface, plane or sphere."""
        return str((self._parameters or {})["surface"])

    @property
    def radius(self) -> float | None:
        """The deformation radius of screened vortices, or None."""
        found: float | None = (self._parameters or {})["radius"]
        return found

    def state(self, places: Any) -> Floats:
        """Return the states of places.

        Parameters
        ----------
        places : (..., vortices, 2) or (..., vortices, 3) array
            In the plane x and y; on the sphere unit vectors, or latitude and longitude in radians.

        Returns
        -------
        (..., n) array

        Raises
        ------
        ValueError
            Places of another shape, or vectors that are not of length 1 to 1e-6.

        Examples
        --------
        >>> point_vortices((1.0, 2.0)).state([[0.5, 0.0], [-0.5, 0.0]])
        array([ 0.5,  0. , -0.5,  0. ,  1. ])
        >>> point_vortices((1.0, 2.0), "sphere").state([[0.0, 0.0], [np.pi / 2, 0.0]]).round(12)
        array([1., 0., 0., 0., 0., 1.])
        """
        given, count = read_finite(places, "places"), len(self.circulations)
        shapes = [(count, 2)] if self.surface == "plane" else [(count, 2), (count, 3)]
        if given.shape[-2:] not in shapes:
            raise ValueError(
                f"places has the shape {given.shape}; {count} vortices on the {self.surface} have places "
                f"(..., {count}, {' or '.join(str(shape[1]) for shape in shapes)})"
            )
        if self.surface == "plane":
            flat = given.reshape(*given.shape[:-2], 2 * count)
            return np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
        if given.shape[-1] == 2:
            latitude, longitude = given[..., 0], given[..., 1]
            if np.abs(latitude).max(initial=0.0) > pi / 2 + 1e-12:
                raise ValueError(
                    f"places has the latitude {short(float(latitude.flat[np.abs(latitude).argmax()]))}; give "
                    "latitudes in radians, from -pi/2 to pi/2, and longitudes"
                )
            horizontal = np.cos(latitude)
            vectors = [horizontal * np.cos(longitude), horizontal * np.sin(longitude), np.sin(latitude)]
            given = np.stack(vectors, axis=-1)
        lengths = np.linalg.norm(given, axis=-1, keepdims=True)
        if np.abs(lengths - 1.0).max(initial=0.0) > 1e-6:
            raise ValueError(
                f"places has a vector of length {lengths.flat[np.abs(lengths - 1.0).argmax()]:g}; give unit vectors"
            )
        return np.asarray((given / lengths).reshape(*given.shape[:-2], 3 * count))

    def places(self, x: Any) -> Floats:
        """Return the places of states (..., n): x and y in the plane, unit vectors on the sphere.

        Parameters
        ----------
        x : (..., n) array
            States, such as ``sol.x``.

        Returns
        -------
        (..., vortices, 2) or (..., vortices, 3) array
        """
        states, axes = read_finite(x, "x"), AXES[self.surface]
        count = len(self.circulations)
        if states.shape[-1:] != (self.dim,):
            raise ValueError(f"x has the shape {states.shape}; states are (..., {self.dim})")
        return np.asarray(states[..., : axes * count].reshape(*states.shape[:-1], count, axes))


def _logarithm() -> tuple[Callable[..., Any], ...]:
    """Return ``w log(s)`` of squared distances, twice its derivative, and four times the second one."""
    return (
        lambda w, s, c: w * np.log(s),
        lambda w, s, c: 2.0 * w / s,
        lambda w, s, c: -4.0 * w / (s * s),
    )


def _screened() -> tuple[Callable[..., Any], ...]:
    """Return ``-2 w K0(sqrt(s)/radius)``, which is `_logarithm` and a constant where it is small, and its derivatives.

    The radius is the last constant.
    """

    def value(w: Any, s: Any, c: Any) -> Any:
        per_square = 1.0 / (c[-1] * c[-1])
        return -2.0 * w * k0(s * per_square)

    def slope(w: Any, s: Any, c: Any) -> Any:
        per_square = 1.0 / (c[-1] * c[-1])
        return 2.0 * w * per_square * k1_over_argument(s * per_square)

    def curvature(w: Any, s: Any, c: Any) -> Any:
        per_square = 1.0 / (c[-1] * c[-1])
        u = s * per_square
        return -2.0 * w * per_square * (k0(u) + 2.0 * k1_over_argument(u)) / s

    return value, slope, curvature


@lru_cache(maxsize=32)
def _interaction(axes: int, count: int, screened: bool) -> tuple[Callable[..., Any], ...]:
    """Return ``-(1/4 pi) sum of c_i c_j log |r_i - r_j|^2`` over pairs, with its derivatives; c are circulations."""
    bodies_of, rate = bodies_of_shares(count), -1.0 / (4.0 * pi)
    value_of, slope_of, curvature_of = _screened() if screened else _logarithm()

    def squared_distance(y: Any, i: int, j: int) -> Any:
        square = 0.0 * y[0]
        for a in range(axes):
            d = y[axes * i + a] - y[axes * j + a]
            square += d * d
        return square

    def value(y: Any, c: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        total = 0.0 * y[0]
        for i in range(begin, count, step):
            for j in range(i):
                total += value_of(rate * c[i] * c[j], squared_distance(y, i, j), c)
        return total

    def gradient(y: Any, c: Any, share: Any = ALL_SHARES) -> Any:
        begin, step = bodies_of(share)
        result = 0.0 * y
        for i in range(begin, count, step):
            for j in range(i):
                factor = slope_of(rate * c[i] * c[j], squared_distance(y, i, j), c)
                for a in range(axes):
                    slope = factor * (y[axes * i + a] - y[axes * j + a])
                    result[axes * i + a] += slope
                    result[axes * j + a] -= slope
        return result

    def hessian(y: Any, c: Any) -> Any:
        result = np.outer(0.0 * y, y)
        for i in range(count):
            for j in range(i):
                weight, square = rate * c[i] * c[j], squared_distance(y, i, j)
                factor, change = slope_of(weight, square, c), curvature_of(weight, square, c)
                for a in range(axes):
                    for b in range(axes):
                        d = y[axes * i + a] - y[axes * j + a]
                        curvature = change * d * (y[axes * i + b] - y[axes * j + b])
                        if a == b:
                            curvature += factor
                        result[axes * i + a, axes * i + b] += curvature
                        result[axes * j + a, axes * j + b] += curvature
                        result[axes * i + a, axes * j + b] -= curvature
                        result[axes * j + a, axes * i + b] -= curvature
        return result

    return value, gradient, hessian


def _algebra(circulations: Floats, surface: str) -> LieAlgebra:
    """Return the algebra of positions: brackets over the circulation of each vortex."""
    count, axes = len(circulations), AXES[surface]
    names = tuple(f"{axis}{k + 1}" for k in range(count) for axis in "xyz"[:axes])
    title = f"positions of {count} vortices"
    if surface == "sphere":
        spins = copies(catalogue.so(3), count)
        i, j, k, c = spins.triples
        constants = Triples(i.copy(), j.copy(), k.copy(), c / circulations[i // 3])
        return LieAlgebra._from_valid(constants, 3 * count, names, title, None, dict(spins.casimirs_known))
    first, central = 2 * np.arange(count, dtype=np.int64), np.full(count, 2 * count, dtype=np.int64)
    constants = Triples(first, first + 1, central, 1.0 / circulations)
    z = {"z": Polynomial.variable(2 * count, 2 * count + 1)}
    return LieAlgebra._from_valid(constants, 2 * count + 1, (*names, "z"), title, None, z)


def _integrals(circulations: Floats, surface: str) -> dict[str, Quadratic]:
    """Return the components of the impulse, and in the plane the angular impulse."""
    count, axes = len(circulations), AXES[surface]
    dim = axes * count + (surface == "plane")
    found = {}
    for a in range(axes):
        linear = np.zeros(dim)
        linear[a : axes * count : axes] = circulations
        found[f"impulse {'xyz'[a]}"] = Quadratic(np.zeros(dim), linear=linear)
    if surface == "plane":
        found["angular impulse"] = Quadratic(np.append(np.repeat(2.0 * circulations, 2), 0.0))
    return found


def _pair_motion(circulations: Floats, surface: str, radius: float | None, start: Floats, times: Floats) -> Floats:
    """Return the motion of two vortices, whose distance is constant."""
    axes = AXES[surface]
    r = start[: 2 * axes].reshape(2, axes)
    apart = r[0] - r[1]
    square = apart @ apart
    rates = circulations / (2.0 * pi * square)
    if radius is not None:
        rates = rates * ((square / radius**2) * k1_over_argument(square / radius**2))
    if surface == "sphere":
        axis = np.broadcast_to(-(rates @ r), (len(times), 2, 3))
        return rotate_about(np.broadcast_to(r, axis.shape), axis, times[:, None]).reshape(len(times), 6)
    # About the centre with the sum of the rates; z is the value of the central coordinate. The chord of the angle is
    # regular where the circulations cancel and the centre is at infinity.
    angle = start[4] * rates.sum() * times
    across = np.array([-apart[1], apart[0]])
    chord = (
        times[:, None]
        * start[4]
        * (np.sinc(angle / pi)[:, None] * across - (np.sin(angle / 2) * np.sinc(angle / (2 * pi)))[:, None] * apart)
    )
    moved = [r[0] + rates[1] * chord, r[1] - rates[0] * chord, np.full((len(times), 1), start[4])]
    return np.concatenate(moved, axis=1)


def _two_pairs() -> Floats:
    """Return two pairs of opposite vortices, one inside the other."""
    return np.array([0.0, 1.0, 0.0, 0.4, 0.0, -1.0, 0.0, -0.4, 1.0])


def _coordinate(axis: int) -> Callable[[Any], Any]:
    """Return the function of states for a coordinate of all positions in the plane."""
    return lambda x: x[..., axis:-1:2]


def _pictures(system: Any) -> dict[str, Any]:
    """Return the pictures of a system on the sphere: paths on the globe."""
    if system.surface == "plane":
        return {}
    names = {f"vortex {k + 1}": (3 * k, 3 * k + 1, 3 * k + 2) for k in range(min(len(system.circulations), 6))}
    return {"pictures": (Picture("directions", vectors=names, axes_named=("$x$", "$y$", "$z$"), title="vortices"),)}


@ready_made(
    unit=("z", "|x|^2"),
    gallery_entry=GalleryEntry(
        x0=_two_pairs,
        t_span=(0.0, 30.0),
        step=0.05,
        caption="Two pairs of opposite vortices play leapfrog: each in turn becomes narrow, slips through the "
        "other one and widens. The energy and the impulse are constant.",
        pictures=(
            Picture(
                "phase portrait",
                across=_coordinate(0),
                up=_coordinate(1),
                labels=("$x$", "$y$"),
                equal=True,
                curves=lambda dim: [f"vortex {k + 1}" for k in range((dim - 1) // 2)],
                title="paths of the vortices",
            ),
        ),
        components=Picture("components", chosen=lambda dim: list(range(min(dim - 1, 4)))),
        parameters={"circulations": (1.0, 1.0, -1.0, -1.0)},
        quantity="position",
        variant=_pictures,
    ),
)
def point_vortices(
    circulations: npt.ArrayLike = (1.0, 1.0), surface: str = "plane", radius: float | None = None
) -> PointVortices:
    """Return point vortices in the plane or on the unit sphere, ``r_i' = sum of c_j e x (r_i - r_j)/(2 pi d_ij^2)``.

    Each vortex is carried by the velocity of the others: that of an ideal fluid whose vorticity is a sum of delta
    functions. e is the upward normal, at ``r_i``; on the sphere this is ``c_j (r_j x r_i)/(2 pi |r_i - r_j|^2)``, with
    a uniform vorticity between the vortices if their circulations do not add up to zero. Choose it for a few
    concentrated vortices; `sphere_euler` and `torus_euler` with ``blobs`` describe vortices with a size. The energy is
    ``-sum of c_i c_j log(d_ij)/(2 pi)`` over pairs, d the straight distance.

    With a deformation `radius` R they are screened, vortices of quasi-geostrophic flow of one layer (`torus_qg` with
    ``gamma = 1/R^2``): the energy is ``sum of c_i c_j K0(d_ij/R)/(2 pi)``, and the velocity at the distance d of one is
    ``c K1(d/R)/(2 pi R)``, which is that without a radius where d is small beside R, and falls as ``exp(-d/R)`` beyond.

    Parameters
    ----------
    circulations : (vortices,)
        c, the circulation of each vortex (length^2/time), positive counterclockwise seen from above or outside; not
        zero, from 1 to 682 of them. A tracer has a circulation that is small beside those of the others.
    surface : {"plane", "sphere"}
        The unbounded plane, or the unit sphere, at rest.
    radius : float, optional
        R, the deformation radius, a length from 1e-100 to 1e100, in the plane alone. Without it, or as it becomes
        large, the fluid is not stratified.

    Returns
    -------
    PointVortices
        State: in the plane ``(x_1, y_1, x_2, y_2, ..., 1)``, the last one the central coordinate z; on the sphere unit
        vectors ``(x_1, y_1, z_1, x_2, ...)``; ``state(places)`` makes both. Sign +1. Casimirs: z, or the squared
        length of each vector, which must be 1. Integrals: the components of the impulse, ``sum of c_i r_i``, and in the
        plane the angular impulse ``sum of c_i |r_i|^2``. ``exact(x0, t)`` for two vortices. There is no representation,
        because a group element has no meaning for the fluid.

    Raises
    ------
    TypeError, ValueError
        Circulations that are zero or no finite numbers, too many of them, another surface, a radius that is not
        positive, or one on the sphere.

    Notes
    -----
    The states are positions, so brackets are divided by circulations: for ``c_i r_i`` they are those of so(3) on the
    sphere. In the plane x and ``c y`` of a vortex are a canonical pair, and one central coordinate serves all: a
    Heisenberg algebra. Positions do not commute, so H has no splitting: `SphericalMidpoint` is
    a Poisson map on the sphere, and `GaussLegendre` in the plane. Close vortices turn about each other at the rate
    ``(c_i + c_j)/(2 pi d^2)``, screened ones at ``(c_i + c_j) K1(d/R)/(2 pi d R)``, which a step must resolve. K0 and
    K1 have relative errors below 1e-15 for d up to R, and below ``1e-15 + 1e-16 d/R`` beyond.

    P. K. Newton, The N-Vortex Problem (Springer, 2001); I. Vankerschaver, M. Leok, J. Nonlinear Sci. 24 (2014) 1.
    Screened: G. K. Morikawa, J. Meteorol. 17 (1960) 148.

    Examples
    --------
    Two equal vortices go around each other; a vortex and its opposite go straight ahead:

    >>> import coadjoint as co
    >>> s = point_vortices((1.0, 1.0))
    >>> x0 = s.state([[0.5, 0.0], [-0.5, 0.0]])
    >>> sol = co.integrate(s, x0, (0, np.pi**2), np.pi**2 / 50, co.GaussLegendre(3))  # half a turn
    >>> s.places(sol.x[-1]).round(6) + 0.0
    array([[-0.5,  0. ],
           [ 0.5,  0. ]])
    >>> pair = point_vortices((1.0, -1.0))
    >>> pair.places(pair.exact(x0, 2 * np.pi)).round(6) + 0.0
    array([[ 0.5, -1. ],
           [-0.5, -1. ]])

    At four deformation radii they go a twentieth of the way:

    >>> pair = point_vortices((1.0, -1.0), radius=0.25)
    >>> pair.places(pair.exact(x0, 2 * np.pi)).round(6) + 0.0
    array([[ 0.5     , -0.049934],
           [-0.5     , -0.049934]])
    """
    c = read_finite(circulations, "circulations")
    if c.ndim != 1 or not 0 < c.size <= MAX_VORTICES:
        raise ValueError(f"circulations has shape {c.shape}; give one number for each of up to {MAX_VORTICES} vortices")
    for k in np.flatnonzero((np.abs(c) < 1 / MAX_CIRCULATION) | (np.abs(c) > MAX_CIRCULATION))[:1].tolist():
        raise ValueError(
            f"circulations[{k}] is {c[k]:g}; their sizes are from {1 / MAX_CIRCULATION:g} to {MAX_CIRCULATION:g}; for "
            "a tracer give one that is small beside the others"
        )
    axes = AXES[read_choice(surface, "surface", AXES)]
    if radius is not None:
        radius = read_positive(radius, "radius")
        if surface == "sphere":
            raise ValueError(
                f"radius is {radius:g} and surface is 'sphere', where point vortices have none; take the plane, or "
                "co.systems.sphere_qg for vortices with a size"
            )
        if not 1 / MAX_RADIUS <= radius <= MAX_RADIUS:
            raise ValueError(f"radius is {radius:g}; it is from {1 / MAX_RADIUS:g} to {MAX_RADIUS:g}")
    algebra = _algebra(c, surface)
    value, gradient, hessian = _interaction(axes, len(c), radius is not None)
    constants = c if radius is None else np.append(c, radius)
    shares = number_of_shares(len(c))
    return PointVortices(
        algebra,
        FunctionOfConstants(np.arange(algebra.dim), constants, value, gradient, hessian, shares).hamiltonian(),
        sign=+1,
        name="point_vortices",
        parameters={"circulations": tuple(c.tolist()), "surface": surface, "radius": radius},
        exact=partial(move_state, "point_vortices", algebra.dim, partial(_pair_motion, c, surface, radius))
        if len(c) == 2
        else None,
        integrals=_integrals(c, surface),
        layout={"coordinates": LAYOUTS[surface]},
    )
