"""A separable Hamiltonian of non-polynomial functions of one coordinate, on any algebra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra import catalogue
from coadjoint.algebra.invariants.invariant import COSH, HOLD, SINH, SINH_SQUARED, Forms
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import GalleryEntry, Picture, points_on_sphere
from coadjoint.systems.hamiltonians.split_hamiltonian import Separable
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite, read_positive


@ready_made(
    gallery_entry=GalleryEntry(
        x0=partial(points_on_sphere, 16, 3.0),
        t_span=(0.0, 12.0),
        step=0.01,
        caption="Sixteen motions with the same length of the momentum, as for a rigid body. The energy grows "
        "exponentially with the components, so the curves around the axes are squares with round corners.",
        pictures=(
            Picture(
                "directions",
                vectors={"x": (0, 1, 2)},
                axes_named=("$x_1$", "$x_2$", "$x_3$"),
                title="motions on the sphere of one momentum",
                view=(35.0, 22.0),
            ),
        ),
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
