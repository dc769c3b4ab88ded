"""Base class of Hamiltonians with ``H(x)``, ``H1 + H2``, ``2 * H``, ``H / 2``, ``-H``, and polynomials as such."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient, read_coefficient
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import Abstract
from coadjoint.short_repr import MAX_SHOWN_LENGTH, short
from coadjoint.systems.evaluation import read_point, vectorized_over_states
from coadjoint.systems.hamiltonians.terms import PolynomialTerm, Term
from coadjoint.validation import is_real, to_array


class Summable(Abstract):
    """Base class of Hamiltonians: they are called, added to Hamiltonians and numbers, and multiplied by numbers."""

    # Prevents NumPy arrays from broadcasting over it.
    __array_ufunc__ = None

    @abstractmethod
    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian, of the same type, multiplied by a factor; fractions stay exact.

        Parameters
        ----------
        factor : int, float or Fraction
            Finite.

        Returns
        -------
        Hamiltonian
            Of the same type.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.Quadratic([1.0, 2.0]).times(0.5)
        Quadratic([0.5, 1.0])
        """

    has_linear = False
    """Whether a sum takes its linear term from this summand."""
    place_in_sum: int | None = None
    """Place among the summands of a sum, for those that are joined to one of them: polynomials, and sums of pieces."""

    def joined(self, other: Any) -> Any:
        """Return the sum with another Hamiltonian of the same place as one of them."""
        raise NotImplementedError

    def check_commuting(self, algebra: LieAlgebra) -> None:
        """Raise ValueError if pieces of the Hamiltonian have coordinates that do not commute; most have no pieces."""
        return

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return the coefficients of the linear term of the bound Hamiltonian."""
        raise no_linear_term(self)

    def with_linear(self, linear: npt.NDArray[np.float64]) -> Any:
        """Return the bound Hamiltonian with another linear term."""
        raise no_linear_term(self)

    def __call__(self, x: npt.ArrayLike, t: Any = 0.0) -> Any:
        """Return H(x, t) at a state (n,), or the values at states (..., n).

        The time is one number, or one for each entry of the first axis.
        """
        states = to_array(x, "x", "iufc")
        H = cast(Any, self)
        return _value(H.bind(states.shape[-1]) if H.dim is None and states.ndim > 1 else H, states, t)

    def __add__(self, other: Any) -> Any:
        from coadjoint.systems.hamiltonians.sum_of_hamiltonians import sum_of

        return sum_of(self, other)

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __neg__(self) -> Self:
        return self.times(-1)

    def __sub__(self, other: Any) -> Any:
        # Polynomials and user-defined types may have their own negation.
        if not hasattr(type(other), "__neg__"):
            raise TypeError(f"{short(other)} cannot be subtracted from a Hamiltonian: it has no __neg__")
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, factor: Any) -> Self:
        return self.times(_read_factor(factor))

    def __rmul__(self, factor: Any) -> Self:
        return self * factor

    def __truediv__(self, divisor: Any) -> Self:
        denominator = _read_factor(divisor)
        if denominator == 0:
            raise ValueError(f"a Hamiltonian can be divided by a number other than 0, not by {short(divisor)}")
        return self * (1.0 / denominator if isinstance(denominator, float) else Fraction(1, 1) / denominator)


def no_linear_term(H: Any) -> TypeError:
    """Return the error for a Hamiltonian that is one function of all coordinates, or of a user-defined type."""
    return TypeError(
        f"the Hamiltonian is a {type(H).__name__}, which has no linear term to replace; give a Quadratic, a "
        "Polynomial, a Separable or a SplitHamiltonian"
    )


@vectorized_over_states
def _value(H: Any, x: npt.NDArray[Any], t: float = 0.0) -> Any:
    return H.value(x, t)


def _read_factor(argument: Any) -> Coefficient:
    if not is_real(argument):
        raise TypeError(
            f"a Hamiltonian is multiplied by {short(argument)}; the factor must be a number (products of coordinates "
            "are those of Polynomial)"
        )
    return read_coefficient(argument, "the factor of a Hamiltonian")


class PolynomialHamiltonian(Summable):
    """A `Polynomial` as a Hamiltonian; `as_hamiltonian` makes it for degree three and higher."""

    timed = False

    def __init__(self, polynomial: Polynomial) -> None:
        self.polynomial = polynomial
        self.dim: int | None = polynomial.dim

    def bind(self, n: int) -> PolynomialHamiltonian:
        """Return itself; raise ValueError if n is not the number of variables."""
        check_variables(self.polynomial, n)
        return self

    def times(self, factor: Coefficient) -> Self:
        return type(self)(factor * self.polynomial)

    place_in_sum: int | None = 0

    def joined(self, other: Any) -> PolynomialHamiltonian:
        """Return the sum with a polynomial, or with a quadratic Hamiltonian."""
        bound = other if other.dim == self.dim else other.bind(self.polynomial.dim)
        return PolynomialHamiltonian(self.polynomial + bound.to_polynomial())

    def to_polynomial(self) -> Polynomial:
        return self.polynomial

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        return self.polynomial(read_point(x, self.dim))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        return self.polynomial.gradient(read_point(x, self.dim))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        return self.polynomial.hessian(read_point(x, self.dim))

    def gradient_and_size(self, x: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
        return self.polynomial.gradient_and_size(x)

    @property
    def _written_names(self) -> tuple[str, ...] | None:
        return self.polynomial._written_names

    def named(self, names: Sequence[str]) -> PolynomialHamiltonian:
        """Return it with these names of the coordinates in its text."""
        polynomial = self.polynomial.named(names)
        return self if polynomial is self.polynomial else PolynomialHamiltonian(polynomial)

    has_linear = True

    def linear_part(self) -> npt.NDArray[np.float64]:
        linear = np.zeros(self.polynomial.dim)
        for exponents, coefficient in self.polynomial.monomials.items():
            if sum(exponents) == 1:
                linear[exponents.index(1)] = float(coefficient)
        return linear

    def with_linear(self, linear: npt.NDArray[np.float64]) -> PolynomialHamiltonian:
        """Return the polynomial with another linear part."""
        monomials = {e: c for e, c in self.polynomial.monomials.items() if sum(e) != 1}
        n = self.polynomial.dim
        for k in np.flatnonzero(linear).tolist():
            monomials[tuple(int(i == k) for i in range(n))] = float(linear[k])
        return PolynomialHamiltonian(self.polynomial._with_monomials(monomials))

    def terms(self) -> tuple[Term, ...]:
        return (PolynomialTerm(self.polynomial),)

    def __repr__(self) -> str:
        text = repr(self.polynomial)
        if len(text) > MAX_SHOWN_LENGTH:
            text = f"{len(self.polynomial.monomials)} monomials in {self.dim} coordinates"
        return f"PolynomialHamiltonian({text})"


class SeparatePolynomial(PolynomialHamiltonian):
    """A polynomial that stays a summand of its own beside a quadratic form, whose sparse rows are faster."""

    place_in_sum = None
    has_linear = False


def check_variables(polynomial: Polynomial, n: int, owner: str = "the system") -> None:
    """Raise ValueError if the number of variables of a polynomial is not n, the dimension of its owner."""
    if polynomial.dim != n:
        raise ValueError(f"the polynomial has {polynomial.dim} variables but {owner} has dimension {n}; give {n}")
