"""The Riccati equation with constant coefficients, as a linear motion on the dual of sl(2)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.closed_forms.closed_form import check_finite_states, initial_group_element, start_and_times
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_number

Floats = npt.NDArray[np.float64]


def _root(sign: float, x: Any) -> Any:
    """Return a root of x1 w^2 - 2 x2 w - x3 = 0, or NaN if it is beyond 6 or not real."""
    with np.errstate(all="ignore"):
        w = (x[..., 1] + sign * np.sqrt(x[..., 1] ** 2 + x[..., 0] * x[..., 2])) / x[..., 0]
        return np.where(np.abs(w) < 6.0, w, np.nan)


def _energy(constant: Any, linear: Any, quadratic: Any) -> tuple[Floats, npt.NDArray[Any]]:
    return np.zeros(3), np.array([-constant, -linear, quadratic])


@ready_made(
    energy=_energy,
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
    M, u = _energy(*q)
    return LiePoissonSystem(
        catalogue.get("sl(2)"),
        Quadratic(M, u),
        casimirs={"discriminant": Polynomial({(1, 0, 1): 1, (0, 2, 0): 1})},
        name="riccati",
        parameters={"constant": q[0], "linear": q[1], "quadratic": q[2]},
        exact=partial(_exact, u),
    )


def _exact(u: Floats, x0: Any, t: Any, attitude: Any = False) -> Any:
    """Return ``exp(t D_u) x0`` and ``g exp(-t rho(u))``."""
    # D_u^3 = d D_u and rho(u)^2 = d/4, with the discriminant d, so that sines and cosines of t sqrt(d)/2 suffice.
    start, times = start_and_times(x0, t, 3)
    first = initial_group_element(attitude, 2)
    p, q, r = u.tolist()
    D = np.array([[q, -2.0 * r, 0.0], [-p, 0.0, r], [0.0, 2.0 * p, -q]])
    rho = np.array([[0.5 * q, r], [p, -0.5 * q]])
    with np.errstate(all="ignore"):
        rate = np.sqrt(complex(0.25 * q * q + p * r))
        angle = rate * times
        even = np.cosh(angle).real
        odd = times + 0.0 if rate == 0 else (np.sinh(angle) / rate).real
        Dx = D @ start
        x = start + (even * odd)[..., None] * Dx + (0.5 * odd**2)[..., None] * (D @ Dx)
        g = first @ (even[..., None, None] * np.eye(2) - odd[..., None, None] * rho)
    check_finite_states(x, start, times)
    return x if isinstance(attitude, bool | np.bool_) and not attitude else (x, check_finite_states(g, start, times))
