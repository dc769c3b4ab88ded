"""A quadratic Hamiltonian with a linear time-dependent drive, ``H(x) + sum of f_k(t) x_k``."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import FunctionTerm, Term
from coadjoint.systems.user_functions import takes_time


class Driven(Summable):
    """``H(x, t) = Q(x) - sum over sites s and axes a of f_sa(t) x_sa``, Q quadratic in ``sites * axes`` coordinates."""

    # Numba compiles `force`, of the time alone: (axes,), common to all sites, or (sites, axes). Axes commute over
    # sites.

    timed = True

    def __init__(self, quadratic: Quadratic, force: Callable[..., Any], sites: int, axes: int, what: str) -> None:
        self.dim: int | None = quadratic.dim
        self._quadratic, self._sites, self._axes = quadratic, sites, axes
        if isinstance(force, type) or takes_time(force, what):
            raise TypeError(f"{what} is {short(force)}; give a function of the time t alone")
        try:
            values = np.asarray(force(0.0), dtype=np.float64)
        except Exception as reason:
            raise TypeError(
                f"{what}(0.0) fails ({type(reason).__name__}: {short(str(reason))}); give numbers"
            ) from None
        if values.shape not in ((axes,), (sites, axes)):
            raise ValueError(f"{what}(t) has shape {values.shape}; it must return ({axes},) or ({sites}, {axes})")
        if not np.isfinite(values).all():
            raise ValueError(f"{what}(0.0) is not finite; give a function with finite values")
        self.uniform = values.ndim == 1
        self._force, self._factor = force, 1.0
        self._terms: tuple[Term, ...] | None = None

    def bind(self, n: int) -> Driven:
        """Return this Hamiltonian; raise an error if n is not its dimension."""
        self._quadratic.bind(n)
        return self

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        result = copy.copy(self)
        result._quadratic, result._factor, result._terms = factor * self._quadratic, factor * self._factor, None
        return result

    def _forces(self, t: float, like: npt.NDArray[Any]) -> npt.NDArray[Any]:
        values = np.asarray(self._force(t), dtype=None if like.dtype == object else np.float64)
        return self._factor * np.broadcast_to(values, (self._sites, self._axes)).ravel()

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t)."""
        y = read_point(x, self.dim)
        return self._quadratic.value(y, t) - self._forces(t, y) @ y

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        y = read_point(x, self.dim)
        return self._quadratic.gradient(y, t) - self._forces(t, y)

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the dense matrix of the quadratic part."""
        return self._quadratic.hessian(x, t)

    def terms(self) -> tuple[Term, ...]:
        """Return the quadratic term and one function term for each axis."""
        if self._terms is None:
            require_packages("a time-dependent field", "numba")
            import numba

            compiled = numba.njit(self._force) if inspect.isfunction(self._force) else self._force
            drive_terms = [
                _term(compiled, -self._factor, np.arange(axis, self.dim or 0, self._axes), axis, self.uniform)
                for axis in range(self._axes)
            ]
            self._terms = (*self._quadratic.terms(), *drive_terms)
        return self._terms

    def __repr__(self) -> str:
        return f"Driven({self._quadratic!r}, in time)"


def _term(
    force: Callable[..., Any], factor: float, coordinates: npt.NDArray[np.int64], axis: int, uniform: bool
) -> FunctionTerm:
    if uniform:

        def value(y: Any, t: Any) -> Any:
            return factor * force(t)[axis] * np.sum(y)

        def gradient(y: Any, t: Any) -> Any:
            return np.full(len(y), factor * force(t)[axis])

    else:

        def value(y: Any, t: Any) -> Any:
            forces, total = force(t), 0.0
            for site in range(len(y)):
                total += factor * forces[site][axis] * y[site]
            return total

        def gradient(y: Any, t: Any) -> Any:
            forces, result = force(t), np.zeros(len(y))
            for site in range(len(y)):
                result[site] = factor * forces[site][axis]
            return result

    def hessian(y: Any, t: Any) -> Any:
        return np.zeros((len(y), len(y)))

    return FunctionTerm(coordinates.astype(np.int64), value, gradient, hessian, timed=True)
