"""The interface of Hamiltonians, and Hamiltonians given by Python functions, polynomials or user-defined classes."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm, Term
from coadjoint.systems.user_functions import (
    SAMPLE_TIME,
    all_take_time,
    check_derivative,
    evaluate,
    multiple_of,
    sample_points,
)
from coadjoint.validation import read_integer

MAX_CACHED_MONOMIALS = 64  # monomials of cached polynomials
BYTES_PER_COORDINATE = 200  # at the sample points


@runtime_checkable
class HamiltonianLike(Protocol):
    """The interface of Hamiltonians; x has shape (n,) and contains floats, complex numbers or objects."""

    @property
    def dim(self) -> int | None:
        """Number of coordinates; None until bound."""

    @property
    def timed(self) -> bool:
        """Whether it depends on the time."""

    def bind(self, n: int) -> HamiltonianLike:
        """Return the same Hamiltonian, checked and bound to dimension n."""

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t)."""

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""

    def terms(self) -> tuple[Term, ...]:
        """Return the terms of the sum; the Hamiltonian must be bound."""


class Hamiltonian(Summable):
    """A Hamiltonian given by Python functions.

    Use it if H is neither quadratic, polynomial nor separable. Schemes that need no splitting support it. For explicit
    splitting, describe the structure of H by `Separable` or `SplitHamiltonian`.

    Parameters
    ----------
    value : callable
        Pure function of ``(x)`` or ``(x, t)``, x of shape (n,); returns a number.
    gradient : callable
        Function of the same arguments that returns shape (n,). Checked against the central difference of `value`.
    hessian : callable, optional
        Function of the same arguments that returns shape (n, n). Needed for exact tangents.

    Raises
    ------
    TypeError
        Not functions, or functions of different arguments.
    ValueError
        In `bind`: a shape is wrong, or a derivative disagrees with a finite difference at a sample point.

    Examples
    --------
    >>> H = Hamiltonian(lambda x: np.cosh(x[0]) + x[1] ** 2, lambda x: np.array([np.sinh(x[0]), 2 * x[1]]))
    >>> H.bind(2).gradient([0.0, 3.0])
    array([0., 6.])
    """

    def __init__(
        self, value: Callable[..., Any], gradient: Callable[..., Any], hessian: Callable[..., Any] | None = None
    ) -> None:
        self.timed = all_take_time({"value": value, "gradient": gradient, "hessian": hessian})
        self.dim: int | None = None
        self._value, self._gradient, self._hessian = value, gradient, hessian

    def bind(self, n: int) -> Hamiltonian:
        """Return this Hamiltonian bound to dimension `n`, after checking its functions at sample points.

        Parameters
        ----------
        n : int
            Number of coordinates.

        Returns
        -------
        Hamiltonian

        Raises
        ------
        ValueError
            A shape is wrong, or a derivative disagrees with a finite difference.
        """
        n = read_integer(n, "the dimension")
        if self.dim is not None and self.dim != n:
            raise ValueError(f"the Hamiltonian is bound to dimension {self.dim}, not {short(n)}; make a new one")
        if self.dim == n:
            return self
        check_available_memory(
            BYTES_PER_COORDINATE * n, f"a Hamiltonian of {short(n)} coordinates, checked at sample points,"
        )
        functions, derivatives = [("value", self._value), ("gradient", self._gradient)], [("gradient", self._gradient)]
        if self._hessian is not None:
            derivatives.append(("hessian", self._hessian))
        shapes: list[tuple[int, ...]] = [(), (n,), (n, n)]
        for level, (name, derivative) in enumerate(derivatives):
            check_derivative(
                functions[level][1],
                derivative,
                names=(functions[level][0], name),
                shapes=(shapes[level], shapes[level + 1]),
                n=n,
                timed=self.timed,
            )
        bound = Hamiltonian(self._value, self._gradient, self._hessian)
        bound.dim = n
        return bound

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor.

        Parameters
        ----------
        factor : int, float or Fraction
            Finite.

        Returns
        -------
        Hamiltonian
        """
        result = copy.copy(self)
        result._value = multiple_of(self._value, factor, scalar=True)
        result._gradient, result._hessian = (
            multiple_of(function, factor, scalar=False) for function in (self._gradient, self._hessian)
        )
        return result

    def _call(self, function: Callable[..., Any], x: npt.ArrayLike, t: float) -> tuple[Any, bool]:
        y = read_point(x, self.dim)
        return (function(y, t) if self.timed else function(y)), y.dtype == np.float64

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return H(x, t), a number."""
        result, real = self._call(self._value, x, t)
        return float(result) if real else result

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        return np.asarray(self._call(self._gradient, x, t)[0])

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        if self._hessian is None:
            raise TypeError("this Hamiltonian has no second derivatives; give hessian=")
        return np.asarray(self._call(self._hessian, x, t)[0])

    def terms(self) -> tuple[Term, ...]:
        """Return the single `FunctionTerm`, of all coordinates; the Hamiltonian must be bound."""
        if self.dim is None:
            raise TypeError("this Hamiltonian has no dimension yet; call bind(n) first")
        coordinates = np.arange(self.dim, dtype=np.int64)
        return (FunctionTerm(coordinates, self._value, self._gradient, self._hessian, timed=self.timed),)

    def __repr__(self) -> str:
        functions = (self._value, self._gradient, self._hessian)
        names = [getattr(f, "__name__", short(f)) for f in functions if f is not None]
        return f"Hamiltonian({', '.join(names)})"


class PolynomialHamiltonian(Summable):
    """A `Polynomial` as a Hamiltonian; `as_hamiltonian` makes it for degree three and higher."""

    timed = False

    def __init__(self, polynomial: Polynomial) -> None:
        self.polynomial = polynomial
        self.dim: int | None = polynomial.dim

    def bind(self, n: int) -> PolynomialHamiltonian:
        """Return itself; raise ValueError if n is not the number of variables."""
        _check_variables(self.polynomial, n)
        return self

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        return type(self)(factor * self.polynomial)

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return the value of the polynomial at x."""
        return self.polynomial(read_point(x, self.dim))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        return self.polynomial.gradient(read_point(x, self.dim))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        return self.polynomial.hessian(read_point(x, self.dim))

    def terms(self) -> tuple[Term, ...]:
        """Return the single `PolynomialTerm`."""
        return (PolynomialTerm(self.polynomial),)

    def __repr__(self) -> str:
        return f"PolynomialHamiltonian({self.polynomial!r})"


def _check_variables(polynomial: Polynomial, n: int, owner: str = "the system") -> None:
    if polynomial.dim != n:
        raise ValueError(f"the polynomial has {polynomial.dim} variables but {owner} has dimension {n}; give {n}")


# Members of an ensemble share Casimirs, so the conversion is cached. Polynomials of floats and of integers can compare
# equal, so the number types are part of the key.
@lru_cache(maxsize=64)
def _quadratic(polynomial: Polynomial, kinds: tuple[type, ...]) -> Quadratic:
    return Quadratic.from_polynomial(polynomial)


def as_hamiltonian(H: Any, n: int, owner: str = "the system") -> HamiltonianLike:
    """Convert `H` of any accepted type to a Hamiltonian bound to dimension `n`; `owner` names its owner in messages.

    A polynomial of degree at most two becomes a `Quadratic`. User-defined types are checked at sample points. Raises
    TypeError for other types, ValueError for a different dimension.
    """
    if isinstance(H, Polynomial):
        _check_variables(H, n, owner)
        if H.degree > 2:
            return PolynomialHamiltonian(H)
        monomials = H.monomials
        if len(monomials) > MAX_CACHED_MONOMIALS:
            return Quadratic.from_polynomial(H)
        return _quadratic(H, tuple(map(type, monomials.values())))
    if isinstance(H, type) or not isinstance(H, HamiltonianLike):
        missing = [name for name in REQUIRED_ATTRIBUTES if not hasattr(H, name)]
        what = f"the class {H.__name__}" if isinstance(H, type) else f"a {type(H).__name__}"
        is_incomplete = not isinstance(H, type) and 0 < len(missing) < len(REQUIRED_ATTRIBUTES) - 1
        hint = f" (as a user-defined Hamiltonian it lacks {', '.join(missing)})" if is_incomplete else ""
        if isinstance(H, str):
            raise TypeError(
                f"the Hamiltonian is the text {short(H)}; give co.Polynomial(text, {n}) if its coordinates are x1, x2, "
                "..., or co.Polynomial(text, basis=algebra.basis) if they are names of the basis"
            )
        raise TypeError(
            f"the Hamiltonian is {what}; give a Quadratic, Polynomial, Separable, SplitHamiltonian or Hamiltonian{hint}"
        )
    if isinstance(H, Quadratic):
        H.check_dimension(n, owner)
    bound = H.bind(n)
    if type(H).__module__.partition(".")[0] != __name__.partition(".")[0]:
        check_user_hamiltonian(bound, n)
    return bound


REQUIRED_ATTRIBUTES = ("dim", "timed", "bind", "value", "gradient", "hessian", "terms")


def check_user_hamiltonian(H: Any, n: int) -> None:
    """Raise an error if value, gradient, second derivatives and terms of a bound user-defined Hamiltonian disagree.

    Compiled loops use the terms; Python code uses the functions.
    """
    kind = type(H).__name__
    if getattr(H, "dim", None) != n:
        raise ValueError(f"bind({n}) of {kind} returned a Hamiltonian of dimension {short(getattr(H, 'dim', None))}")
    terms = H.terms()
    for term in terms:
        if not hasattr(term, "describe_to"):
            raise TypeError(
                f"{kind}.terms() holds {short(term)}; a term is a QuadraticTerm, PolynomialTerm or FunctionTerm"
            )
    value, gradient = (f"{kind}.{name}" for name in ("value", "gradient"))
    check_derivative(H.value, H.gradient, names=(value, gradient), shapes=((), (n,)), n=n, timed=H.timed)
    if not isinstance(evaluate(H.hessian, sample_points(n)[0], H.timed), TypeError):
        names = (gradient, f"{kind}.hessian")
        check_derivative(H.gradient, H.hessian, names=names, shapes=((n,), (n, n)), n=n, timed=H.timed)
    for x in sample_points(n):
        declared = evaluate(H.gradient, x, H.timed)
        if isinstance(declared, Exception):
            continue
        term_gradient = _Gradient(x)
        for term in terms:
            term.describe_to(term_gradient)
        total, size = term_gradient.total, term_gradient.size
        if not np.all(np.abs(total - declared) <= 2.0**10 * UNIT_ROUNDOFF * (size + np.abs(declared))):
            k = int(np.argmax(np.abs(total - declared)))
            raise ValueError(
                f"{kind}.terms() contradict {gradient}: component {k} is {total[k]:.6g} by the terms and "
                f"{float(declared[k]):.6g} by the gradient at a sample point; correct the one that is wrong"
            )


class _Gradient:
    """The gradient of a sum of terms at a sample point, and the sum of absolute values for tolerances."""

    def __init__(self, x: npt.NDArray[np.float64]) -> None:
        self.x, self.total, self.size = x, np.zeros(len(x)), 0.0

    def _add(self, part: npt.NDArray[np.float64]) -> None:
        self.total += part
        self.size += float(np.max(np.abs(part), initial=0.0))

    def quadratic(self, term: QuadraticTerm) -> None:
        part = term.linear.astype(np.float64)
        np.add.at(part, term.rows, term.values * self.x[term.indices])
        self.size += float(np.max(np.abs(term.values), initial=0.0) * np.abs(self.x).sum())
        self._add(part)

    def polynomial(self, term: PolynomialTerm) -> None:
        self._add(np.asarray(term.polynomial.gradient(self.x), dtype=np.float64))

    def function(self, term: FunctionTerm) -> None:
        y, part = self.x[term.coordinates], np.zeros(len(self.x))
        values = term.gradient(y[0] if term.scalar else y, *((SAMPLE_TIME,) if term.timed else ()))
        np.add.at(part, term.coordinates, np.asarray(values, dtype=np.float64).reshape(len(y)))
        self._add(part)
