"""Values and arithmetic of Hamiltonians: base class with ``H(x)``, ``H1 + H2``, ``2 * H``, ``H / 2``, ``-H``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from fractions import Fraction
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient, read_coefficient
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import vectorized_over_states
from coadjoint.validation import is_real, to_array


class Summable(ABC):
    """Base class of Hamiltonians: they are called, added to Hamiltonians and numbers, and multiplied by numbers."""

    # Prevents NumPy arrays from broadcasting over it.
    __array_ufunc__ = None

    @abstractmethod
    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian, of the same type, multiplied by a finite int, float or Fraction."""

    has_linear = False
    """Whether a sum takes its linear term from this summand."""

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
