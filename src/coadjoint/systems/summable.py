"""Arithmetic with Hamiltonians, ``H1 + H2``, ``H1 - H2``, ``2 * H``, ``H / 2``, ``-H``, by a class to derive from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from fractions import Fraction
from typing import Any, Self

from coadjoint.algebra.monomials import read_coefficient
from coadjoint.algebra.product_sums import Coefficient
from coadjoint.given import is_real
from coadjoint.wording import short


class Summable(ABC):
    """What can be added to another Hamiltonian or to a number, and multiplied by a number."""

    # So that an array does not take it entry by entry.
    __array_ufunc__ = None

    @abstractmethod
    def times(self, factor: Coefficient) -> Self:
        """Return the multiple of this Hamiltonian.

        Parameters
        ----------
        factor : int, float or Fraction
            Finite.

        Returns
        -------
        Hamiltonian
            Of the same kind.
        """

    def __add__(self, other: Any) -> Any:
        from coadjoint.systems.sum_of_hamiltonians import sum_of

        return sum_of(self, other)

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __neg__(self) -> Self:
        return self.times(-1)

    def __sub__(self, other: Any) -> Any:
        # A Polynomial has its own minus sign, and so may have a kind of the user.
        if not hasattr(type(other), "__neg__"):
            raise TypeError(f"{short(other)} cannot be subtracted from a Hamiltonian: it has no negative")
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, factor: Any) -> Self:
        return self.times(_factor(factor))

    def __rmul__(self, factor: Any) -> Self:
        return self * factor

    def __truediv__(self, divisor: Any) -> Self:
        below = _factor(divisor)
        if below == 0:
            raise ValueError(f"a Hamiltonian can be divided by a number other than 0, not by {short(divisor)}")
        return self * (1.0 / below if isinstance(below, float) else Fraction(1, 1) / below)


def _factor(given: Any) -> Coefficient:
    if not is_real(given):
        raise TypeError(
            f"a Hamiltonian is multiplied by {short(given)}; the factor must be a number (products of coordinates are "
            "those of Polynomial)"
        )
    return read_coefficient(given, "the factor of a Hamiltonian")
