"""Systems of Reich (1993): the two examples, a separable Hamiltonian, and the Riccati equation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.invariants.invariant import COSH, HOLD, SINH, SINH_SQUARED, Forms
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import read_vector
from coadjoint.systems.bodies.rigid_body import ON_ONE_SPHERE, so3_body
from coadjoint.systems.closed_forms.closed_form import move_state_and_element
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import Separable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite, read_number, read_positive


def _energy(masses: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    return (masses,)


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 1.0, 1.0),
        t_span=(0.0, 20.0),
        step=0.01,
        caption="Every orbit spirals on the surface of its Casimir from one equilibrium on the third axis to the "
        "other: the third component decreases, and the other two grow and decay.",
        pictures=(Picture("coadjoint orbit"),),
        quantity="state",
    ),
)
def paper_a37(a: float = 2.0, masses: npt.ArrayLike = (1.0, 2.0, 0.01)) -> LiePoissonSystem:
    """Return example 5.1 of the paper: the algebra A3,7 with a diagonal quadratic Hamiltonian.

    ``[e1, e3] = a e1 - e2``, ``[e2, e3] = e1 + a e2`` and ``x' = J(x) M x``. Not unimodular; its Casimir,
    ``log(x1^2 + x2^2) - 2 a theta``, is multivalued. Every orbit goes from one equilibrium on the axis of x3 to the
    other, so long runs are not informative: [0, 20] from (1, 1, 1) shows the motion.

    Parameters
    ----------
    a : float
        Parameter of the algebra; any real number.
    masses : (3,)
        Diagonal of M.

    Returns
    -------
    LiePoissonSystem

    Raises
    ------
    ValueError
        Not three finite numbers.

    Notes
    -----
    Section 5.1 of Reich, "Numerical integration of the generalized Euler equations" (1993). The paper requires a > 1,
    which is not necessary, and states neither initial state nor time.

    Examples
    --------
    >>> paper_a37().vector_field([1.0, 1.0, 1.0])
    array([ 0.01,  0.03, -7.  ])
    """
    values, parameter = read_vector(masses, "masses"), read_number(a, "a")
    return LiePoissonSystem(
        catalogue.get("A3,7", a=parameter),
        Quadratic(*_energy(values)),
        name="paper_a37",
        parameters={"a": parameter, "masses": tuple(values.tolist())},
    )


@ready_made(
    energy=_energy,
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 18),
        t_span=(0.0, 40.0),
        step=0.05,
        caption="Eighteen motions on the sphere of the momentum: closed curves around the axes of the largest and of "
        "the smallest moment of inertia, and between them the separatrix through the middle axis, which is "
        "unstable.",
        pictures=(Picture("error"), ON_ONE_SPHERE),
        components=Picture("components", chosen=(1,)),
        quantity="angular momentum",
    ),
)
def paper_rigid_body(masses: npt.ArrayLike = (1.0, 0.5, 1.0 / 3.0)) -> LiePoissonSystem:
    """Return example 5.2 of the paper: the rigid body, ``x' = (M x) cross x``, with its exact solution.

    The paper's convention (sign +1) is the body equations backward in time; the attitude satisfies
    ``A' = -A hat(M x)`` and ``A x`` is constant. For the standard body equations use `rigid_body`.

    Parameters
    ----------
    masses : (3,)
        Diagonal of M: the *inverse* moments of inertia, which the paper calls the inertia tensor.

    Returns
    -------
    LiePoissonSystem
        With ``exact(x0, t, attitude=False)`` in closed form.

    Raises
    ------
    ValueError
        Not three finite numbers.

    Notes
    -----
    Section 5.2 of Reich (1993); the paper starts from x = (1, 10, 1) and A the unit matrix, with step 0.1.

    Examples
    --------
    >>> paper_rigid_body((1.0, 0.5, 0.25)).vector_field([1.0, 2.0, 4.0])
    array([ 2., -3.,  1.])
    """
    values = read_vector(masses, "masses")
    parameters = {"masses": tuple(values.tolist())}
    return so3_body(LiePoissonSystem, *_energy(values), sign=+1, name="paper_rigid_body", parameters=parameters)


@ready_made(
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 16, 3.0),
        t_span=(0.0, 12.0),
        step=0.01,
        caption="Sixteen motions with the same length of the momentum, as for a rigid body. The energy grows "
        "exponentially with the components, so the curves around the axes are squares with round corners.",
        pictures=(ON_ONE_SPHERE,),
        components=Picture("components", chosen=(1,)),
    )
)
def separable_cosh(
    algebra: str = "so(3)",
    masses: npt.ArrayLike = (1.0, 0.5, 0.25),
    stiffness: float = 1.0,
    constants: Mapping[str, float] | None = None,
) -> LiePoissonSystem:
    """Return ``H = sum of masses_i (cosh(stiffness x_i) - 1) / stiffness^2`` on an algebra of the catalogue.

    The generalized Euler equations with a separable, non-quadratic energy; for small momenta it is ``sum of
    masses_i x_i^2 / 2``. A splitting still has exact flows of single coordinates. Sign +1.

    Parameters
    ----------
    algebra : str
        A name for ``co.algebras.get``.
    masses : (n,)
        Coefficients (inverse inertia, energy per momentum squared) of any sign; zero for coordinates not in H.
    stiffness : float
        Positive (1/momentum).
    constants : mapping, optional
        Parameters of the algebra by name, if it has any: ``{"a": 2.0}`` for A3,7.

    Returns
    -------
    LiePoissonSystem
        Casimirs and representation are those of the algebra. No further integrals and no closed form are known.

    Raises
    ------
    ValueError, TypeError
        Unknown algebra or parameters of it, masses of another length or all zero, a stiffness that is not positive, or
        numbers so large that H'' leaves the range of float64.

    Notes
    -----
    Section 7 of Reich (1993): in the flows of section 4, m_ii x_i is replaced by H_i'(x_i).

    Examples
    --------
    >>> system = separable_cosh(stiffness=2.0)
    >>> x = np.array([1.0, 2.0, 0.5])
    >>> slope = np.array([1.0, 0.5, 0.25]) * np.sinh(2.0 * x) / 2.0
    >>> bool(np.allclose(system.vector_field(x), np.cross(slope, x), rtol=1e-14))
    True
    """
    if not isinstance(constants, Mapping | None) or not all(isinstance(key, str) for key in constants or ()):
        raise TypeError(f"constants is {short(constants)}; give a mapping from the algebra's parameters to numbers")
    g = catalogue.get(algebra, **(constants or {}))
    values = read_finite(masses, "masses")
    if values.shape != (g.dim,):
        raise ValueError(f"masses has shape {values.shape}; give {g.dim} numbers, one for each coordinate of {algebra}")
    if not values.any():
        raise ValueError("masses are all zero, so nothing moves; give at least one nonzero mass")
    kappa = read_positive(stiffness, "stiffness")
    parameters: dict[str, Any] = {"algebra": algebra, "masses": tuple(values.tolist()), "stiffness": kappa}
    if constants:
        parameters["constants"] = dict(constants)
    functions = {i: _functions(mass, kappa) for i, mass in enumerate(values.tolist()) if mass}
    return LiePoissonSystem(g, Separable(functions), name="separable_cosh", parameters=parameters)


def _functions(mass: float, kappa: float) -> tuple[Callable[[Any], Any], ...]:
    """Return H_i and its derivatives with tables, which the kernels evaluate bit-identically with every C library."""

    def value(y: Any) -> Any:
        return 2.0 * mass * (np.sinh(0.5 * kappa * y) / kappa) ** 2  # (cosh - 1)/kappa^2 without its cancellation

    def slope(y: Any) -> Any:
        return mass * np.sinh(kappa * y) / kappa

    def curvature(y: Any) -> Any:
        return mass * np.cosh(kappa * y)

    return (
        _with_forms(value, SINH_SQUARED, 2.0 * mass, 0.5 * kappa, kappa),
        _with_forms(slope, SINH, mass, kappa, kappa),
        _with_forms(curvature, COSH, mass, kappa, 1.0),
    )


def _with_forms(function: Any, role: int, weight: float, rate: float, divisor: float) -> Callable[[Any], Any]:
    """Return a function to which its table is added: a multiple of a function of (rate x), over a divisor."""

    def integers(*numbers: int) -> npt.NDArray[np.int64]:
        return np.array(numbers, dtype=np.int64)

    weights, coefficients = np.array([0.0, weight]), np.array([divisor, rate])
    function.kernel_forms = Forms(
        2, integers(HOLD, role), weights, integers(0, 1, 2), coefficients, integers(0, 0, 1), integers(0)
    )
    return function  # type: ignore[no-any-return]


Floats = npt.NDArray[np.float64]


def _root(sign: float, x: Any) -> Any:
    """Return a root of x1 w^2 - 2 x2 w - x3 = 0, or NaN if it is beyond 6 or not real."""
    with np.errstate(all="ignore"):
        w = (x[..., 1] + sign * np.sqrt(x[..., 1] ** 2 + x[..., 0] * x[..., 2])) / x[..., 0]
        return np.where(np.abs(w) < 6.0, w, np.nan)


def _riccati_energy(constant: Any, linear: Any, quadratic: Any) -> tuple[Floats, npt.NDArray[Any]]:
    return np.zeros(3), np.array([-constant, -linear, quadratic])


@ready_made(
    energy=_riccati_energy,
    gallery_entry=GalleryEntry(
        x0=(1.0, 0.5, 0.0),
        t_span=(0.0, 8.0),
        step=0.02,
        caption="The two roots w of the quadratic equation follow w' = 1 + w^2 and go through infinity (left), while "
        "the state moves smoothly on a closed curve of its hyperboloid (right).",
        pictures=(Picture("error"), Picture("coadjoint orbit", view=(-150.0, 25.0))),
        components=Picture(
            "components", functions={"v": partial(_root, -1.0), "w": partial(_root, 1.0)}, quantity="roots"
        ),
        quantity="state",
    ),
)
def riccati(constant: float = 1.0, linear: float = 0.0, quadratic: float = 1.0) -> LiePoissonSystem:
    """Return the Riccati equation ``w' = constant + linear w + quadratic w^2``, regularized at its poles.

    Both roots of ``x1 w^2 - 2 x2 w - x3 = 0`` satisfy the equation as x moves on the dual of sl(2), A3,8, with sign +1
    and ``H = -constant x1 - linear x2 + quadratic x3``. Two solutions v, w correspond to any multiple of the state
    ``(1, (v + w)/2, -v w)``. When w passes through infinity, x1 passes through zero, and x stays smooth. Roots that are
    not real move in the complex plane.

    Parameters
    ----------
    constant, linear, quadratic : float
        Coefficients, in units of w per time, 1 per time, and 1 per w and time.

    Returns
    -------
    LiePoissonSystem
        Casimir: the discriminant, ``x1 x3 + x2^2``. ``exact(x0, t, attitude=False)`` in closed form. The group element
        g, 2 x 2, is the flow of the equation: ``w(t) = (g11 w(0) + g21) / (g12 w(0) + g22)``.

    Raises
    ------
    TypeError, ValueError
        A coefficient is not a finite number.

    Notes
    -----
    Section 7 of Reich, "Numerical integration of the generalized Euler equations" (1993).

    Examples
    --------
    >>> tangent = riccati()  # w' = 1 + w^2, from the roots 0 and 1
    >>> x1, x2, x3 = tangent.exact([1.0, 0.5, 0.0], 0.25)
    >>> np.sort(np.roots([x1, -2 * x2, -x3])), np.tan([0.25, 0.25 + np.pi / 4])
    (array([0.25534192, 1.68579642]), array([0.25534192, 1.68579642]))
    """
    q = [read_number(value, name) for value, name in ((constant, "constant"), (linear, "linear"))]
    q.append(read_number(quadratic, "quadratic"))
    M, u = _riccati_energy(*q)
    return LiePoissonSystem(
        catalogue.get("sl(2)"),
        Quadratic(M, u),
        casimirs={"discriminant": Polynomial({(1, 0, 1): 1, (0, 2, 0): 1})},
        name="riccati",
        parameters={"constant": q[0], "linear": q[1], "quadratic": q[2]},
        exact=partial(move_state_and_element, 3, 2, partial(_riccati_motion, u)),
    )


def _riccati_motion(u: Floats, start: Floats, times: Floats) -> tuple[Floats, Floats]:
    """Return ``exp(t D_u) x0`` and ``exp(-t rho(u))``."""
    # D_u^3 = d D_u and rho(u)^2 = d/4, with the discriminant d, so that sines and cosines of t sqrt(d)/2 suffice.
    p, q, r = u.tolist()
    D = np.array([[q, -2.0 * r, 0.0], [-p, 0.0, r], [0.0, 2.0 * p, -q]])
    rho = np.array([[0.5 * q, r], [p, -0.5 * q]])
    rate = np.sqrt(complex(0.25 * q * q + p * r))
    angle = rate * times
    even = np.cosh(angle).real
    odd = times + 0.0 if rate == 0 else (np.sinh(angle) / rate).real
    Dx = D @ start
    x = start + (even * odd)[:, None] * Dx + (0.5 * odd**2)[:, None] * (D @ Dx)
    return x, even[:, None, None] * np.eye(2) - odd[:, None, None] * rho
