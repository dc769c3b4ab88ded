"""The free rigid body, the gyrostat, and the class of bodies whose states begin with their angular momentum."""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.short_repr import short
from coadjoint.systems.bodies.body_systems import read_states
from coadjoint.systems.bodies.inertia import (
    axis_of_symmetry,
    inverse_of,
    momentum_along,
    principal,
    read_inertia,
    read_vector,
    warn_unphysical_inertia,
)
from coadjoint.systems.bodies.mass_properties import InertiaLike
from coadjoint.systems.closed_forms.closed_form import move_state_and_element
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution, fixed_axis
from coadjoint.systems.energy_derivatives import gradients_at
from coadjoint.systems.forces.angular_velocity import velocity_map
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_numbers

Floats = npt.NDArray[np.float64]


class ClassicalBody(LiePoissonSystem):
    """One body with its angular momentum as the first three coordinates, and an energy quadratic in it."""

    bodies: tuple[int, ...] = ()

    @property
    def _kind(self) -> type[LiePoissonSystem]:
        return LiePoissonSystem  # it only adds functions of the state

    def angular_momentum(self, x: npt.ArrayLike) -> Floats:
        """Return the angular momentum in the body frame: the first part of the state.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., 3)
        """
        return read_states(self, x)[..., :3]

    def angular_velocity(self, x: npt.ArrayLike) -> Floats:
        """Return the angular velocity in the body frame, the derivative of the energy by the momentum.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., 3)
            In radians per time.
        """
        states = read_states(self, x)
        gradients = gradients_at(self, states.reshape(1, -1, self.dim), np.zeros(1))
        return np.asarray(gradients[0, :, :3].reshape(*states.shape[:-1], 3))

    def momentum(self, angular_velocity: npt.ArrayLike) -> Floats:
        """Return the angular momentum in the body frame for an angular velocity in the body frame.

        Parameters
        ----------
        angular_velocity : (..., 3)
            In radians per time.

        Returns
        -------
        ndarray, of the same shape

        Raises
        ------
        TypeError
            The angular velocity also depends on other coordinates, as in a fluid.
        ValueError
            The wrong shape.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.gyrostat((1.0, 2.0, 2.5), rotors=(0.0, 0.0, 2.0))
        >>> body.momentum((1.0, 0.5, -0.4)).round(12)
        array([1., 1., 1.])
        """
        omega = read_numbers(angular_velocity, "angular_velocity")
        if omega.shape[-1:] != (3,):
            raise ValueError(f"angular_velocity has shape {omega.shape}; give (..., 3)")
        W, at_rest = velocity_map(self)
        if W[:, 3:].any():
            raise TypeError(
                f"the angular velocity of {self.name} depends on all coordinates, not on the angular momentum alone; "
                "give momenta in the state itself"
            )
        return np.asarray(np.einsum("ij,...j->...i", np.linalg.inv(W[:, :3]), omega - at_rest))


ON_ONE_SPHERE = Picture(
    "directions",
    vectors={"x": (0, 1, 2)},
    axes_named=("$x_1$", "$x_2$", "$x_3$"),
    title="motions on the sphere of one momentum",
    view=(35.0, 22.0),
)


def _energy(inertia: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (inverse_of(inertia, "inertia"),)


Kind = TypeVar("Kind", bound=LiePoissonSystem)


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=(0.01, 1.0, 0.01),
        t_span=(0.0, 90.0),
        step=0.05,
        caption="A body that spins about its middle axis flips periodically: left, the component along that axis "
        "changes its sign after equal times; middle, the momentum moves between the poles of its sphere along the "
        "separatrix; right, the axis itself in space.",
        pictures=(
            Picture("coadjoint orbit"),
            Picture("body axis", axis=1, up=(0, 1, 2), vertical="momentum"),
        ),
        components=Picture("components", flips=1),
        attitude=True,
        quantity="angular momentum",
    ),
)
def rigid_body(inertia: InertiaLike = (1.0, 2.0, 3.0)) -> ClassicalBody:
    """Return the free rigid body, ``x' = x cross (I^-1 x)``, with its exact solution.

    The standard body equations: x is the angular momentum in the body frame, ``Omega = I^-1 x`` the angular velocity,
    and the attitude A, from the body to space, satisfies ``A' = A hat(Omega)``, so that ``A x`` is constant. The
    algebra is so(3) with sign -1, and ``H = x . I^-1 x / 2``. For the convention of Reich (1993) use
    `paper_rigid_body`.

    Parameters
    ----------
    inertia : (3,), (3, 3) or co.bodies.MassProperties
        Principal moments of inertia, or the symmetric positive definite inertia tensor (mass times length squared).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        With ``exact(x0, t, attitude=False)`` in closed form.

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body. For another quadratic form
        on so(3) use ``LiePoissonSystem(algebras.so(3), Quadratic(M), sign=-1)``.

    Examples
    --------
    >>> s = rigid_body(inertia=(1.0, 2.0, 2.5))
    >>> s.vector_field([1.0, 2.0, 5.0])
    array([-1.,  3., -1.])
    >>> s.exact([1.0, 2.0, 4.0], 0.0)
    array([1., 2., 4.])
    """
    moments = read_inertia(inertia)
    energy = _energy(moments)
    warn_unphysical_inertia(moments)
    return so3_body(ClassicalBody, *energy, sign=-1, name="rigid_body", parameters={"inertia": as_tuples(moments)})


def so3_body(kind: type[Kind], M: npt.NDArray[np.float64], *, sign: int, name: str, parameters: dict[str, Any]) -> Kind:
    """Return the system on so(3) with ``H = x . M x / 2``, M (3,) or (3, 3), and its closed form."""
    # Sign -1 gives the body equations, +1 the convention of Reich (1993).
    exact = partial(exact_solution, M, sign)
    return kind(rotations(3), Quadratic(M), sign=sign, name=name, parameters=parameters, exact=exact)


rotations = lru_cache(maxsize=8)(catalogue.so)  # one object for all bodies, also if none is in use


def _energy_with_rotors(
    inertia: npt.NDArray[Any], rotors: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Any]:
    M = inverse_of(inertia, "inertia")
    rate = (M * rotors).sum(axis=1) if M.ndim == 2 else M * rotors
    return M, -rate, 0.5 * (rotors * rate).sum()


@ready_made(
    energy=_energy_with_rotors,
    symmetric=("inertia",),
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 16),
        t_span=(0.0, 60.0),
        step=0.05,
        caption="Sixteen motions with the same length of the momentum. Without rotors their curves would be symmetric "
        "about the planes of the principal axes. The rotors shift the equilibria, and there are fewer of them.",
        pictures=(ON_ONE_SPHERE,),
        components=Picture("components", chosen=(1,)),
        quantity="angular momentum",
    ),
)
def gyrostat(inertia: InertiaLike = (1.0, 2.0, 3.0), rotors: npt.ArrayLike = (0.25, 0.5, 0.75)) -> ClassicalBody:
    """Return a body that carries rotors, ``x' = x cross Omega`` with ``Omega = I^-1 (x - k)``.

    x is the angular momentum of body and rotors together, in the body frame. That of the rotors relative to the
    body, k, is constant. The attitude A, from the body to space, satisfies ``A' = A hat(Omega)``, so that ``A x`` is
    constant. The algebra is so(3) with the body sign, -1, and ``H = (x - k) . I^-1 (x - k) / 2``. Without rotors use
    `rigid_body`.

    Parameters
    ----------
    inertia : (3,), (3, 3) or co.bodies.MassProperties
        Principal moments, or the symmetric positive definite tensor (mass times length squared): with the rotors locked
        if motors keep their speed relative to the body; without the moments of the rotors about their own axes if they
        spin freely and so keep their own momentum.
    rotors : (3,)
        Angular momentum k of the rotors (mass times length squared over time).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        Casimir ``|x|^2``. If two principal moments are equal and k lies along the third axis, or if all three are
        equal, the momentum along the axis of symmetry, such as ``"x3"``, is an integral, and
        ``exact(x0, t, attitude=False)`` is known in closed form.

    Raises
    ------
    ValueError
        `inertia` has another shape, or is not finite, symmetric and positive; `rotors` is not three finite numbers.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Notes
    -----
    Volterra, "Sur la theorie des variations des latitudes", Acta Mathematica 22 (1899); Wittenburg, "Dynamics of
    Multibody Systems" (2008).

    Examples
    --------
    >>> s = gyrostat(inertia=(1.0, 2.0, 2.5), rotors=(0.0, 0.0, 2.5))
    >>> s.vector_field([1.0, 2.0, 5.0])
    array([-3.,  4., -1.])
    >>> s.energy([0.0, 0.0, 2.5])
    0.0
    """
    moments, k = read_inertia(inertia), read_vector(rotors, "rotors")
    with np.errstate(over="ignore", invalid="ignore"):
        M, linear, constant = _energy_with_rotors(moments, k)
    warn_unphysical_inertia(moments)
    if not math.isfinite(constant):
        raise ValueError(
            f"the energy of the rotors, {short(k.tolist())}, leaves the range of float64; take other units"
        )
    H = Quadratic(M, linear, float(constant))
    axis, m = axis_of_symmetry(M, k), principal(M)
    return ClassicalBody(
        rotations(3),
        H,
        sign=-1,
        name="gyrostat",
        parameters={"inertia": as_tuples(moments), "rotors": tuple(k.tolist())},
        exact=None
        if axis is None or m is None
        else partial(move_state_and_element, 3, 3, partial(_symmetric, m, k, axis)),
        integrals=momentum_along(axis, "x", 3),
    )


def _symmetric(m: Floats, k: Floats, axis: Floats, start: Floats, times: Floats) -> tuple[Floats, Floats]:
    """Return the momenta of a symmetric gyrostat, and its attitudes from the identity."""
    # ``Omega = n x + s axis`` with n the inverse moment across the axis and a constant s. So x rotates about the axis
    # by ``-s t``, and ``A(t) = A(0) exp(n t hat(x(0))) exp(s t hat(axis))``.
    n = float(m[np.argmin(np.abs(axis))])
    spin = float((axis * ((m - n) * start - m * k)).sum()) * axis
    rotation = fixed_axis(spin, times)
    return start @ rotation, fixed_axis(n * start, times) @ rotation
