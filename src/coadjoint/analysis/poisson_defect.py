"""Poisson defect of a step: P J(x) P^T - J(step(x)), with the exact tangent P."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.integrate import integrate
from coadjoint.runs.start import momenta_of
from coadjoint.runs.stepper import Stepper
from coadjoint.short_repr import short
from coadjoint.validation import read_finite, read_integer


class PoissonDefect(NamedTuple):
    """Distance of a map from a Poisson map at a point.

    Parameters
    ----------
    defect : float
        Frobenius norm of P J(x) P^T - J(step(x)).
    bound : float
        Bound on the effect of round-off: 64 u times the number of operations times ``|P|^2 |J(x)|``.
    """

    defect: float
    bound: float

    @property
    def poisson(self) -> bool:
        """Whether the defect is within the bound on round-off."""
        return self.defect <= self.bound


@suggest_keywords
def defect_of_tangent(
    P: npt.ArrayLike, before: npt.ArrayLike, after: npt.ArrayLike, *, operations: int
) -> PoissonDefect:
    """Return the Poisson defect of a map from its tangent.

    Parameters
    ----------
    P : array_like, shape (n, n)
        Derivative of the map at x.
    before, after : array_like, shape (n, n)
        J(x), and J at the image of x.
    operations : int
        Number of roundings in an entry of P.

    Returns
    -------
    PoissonDefect

    Notes
    -----
    The paper (section 2) prints the transpose on the other side, ``P^T J P``, which the exact motion does not satisfy.

    Examples
    --------
    >>> J = np.array([[0.0, 1.0], [-1.0, 0.0]])
    >>> defect_of_tangent([[2.0, 0.0], [0.0, 0.5]], J, J, operations=1).poisson
    True
    """
    tangent, J, image = read_finite(P, "P"), read_finite(before, "before"), read_finite(after, "after")
    operations = read_integer(operations, "operations", 0, 2**53)
    if tangent.ndim != 2 or not tangent.shape == J.shape == image.shape or tangent.shape[0] != tangent.shape[1]:
        raise ValueError(
            f"P, before and after have the shapes {tangent.shape}, {J.shape} and {image.shape}; they must all be (n, n)"
        )
    defect = float(np.linalg.norm(tangent @ J @ tangent.T - image))
    size = float(np.linalg.norm(tangent) ** 2 * np.linalg.norm(J))
    return PoissonDefect(defect, 64 * UNIT_ROUNDOFF * operations * size)


@suggest_keywords
def poisson_defect(step: Stepper, x: npt.ArrayLike, operations: int | None = None) -> PoissonDefect:
    """Return the Poisson defect of one step of a scheme at x.

    Parameters
    ----------
    step : Stepper
        From `coadjoint.stepper`; its tangent is exact, so the defect is not masked by finite differences.
    x : array_like, shape (n,)
        The state.
    operations : int, optional
        Number of roundings in an entry of the tangent. None is n for each elementary flow (or evaluation of the vector
        field) of a step, and 4 n for the products in the defect.

    Returns
    -------
    PoissonDefect

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> poisson_defect(co.stepper(body, co.Splitting(order=2), 0.1), [1.0, 0.2, 0.5]).poisson
    True
    >>> poisson_defect(co.stepper(body, co.GaussLegendre(1), 0.1), [1.0, 0.2, 0.5]).poisson
    False
    """
    if not isinstance(step, Stepper):
        raise TypeError(f"step is {short(step)}; it must be a Stepper, from co.stepper(system, method, h)")
    momenta, single = momenta_of(step.system, x)
    if not single:
        raise ValueError(f"x has the shape {np.shape(x)}; give one state")
    y = momenta[0]
    if step.system.shape != y.shape:
        step = Stepper(step.system.in_numbers, step.method, step.h)
    if operations is None:
        ends = (0.0, step.h)
        run = integrate(step.system, y, ends, abs(step.h), step.method, watch=False)
        operations = (run.stats.evaluations + 4) * y.size
    before, after = step.system.structure_matrix(y), step.system.structure_matrix(step(y))
    return defect_of_tangent(step.tangent(y), before, after, operations=operations)
