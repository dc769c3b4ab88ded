"""Polynomials in the coordinates, in exact arithmetic: Hamiltonians, Casimirs, modified Hamiltonians."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import compress
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import is_finite, quotient
from coadjoint.algebra.polynomials.monomials import (
    Coefficient,
    Exponents,
    ProductSum,
    coordinate_names,
    differentiated,
    exponents_of,
    joined_names,
    latex,
    plain,
    read_coefficient,
    read_monomials,
    read_names,
    special_names,
    sympy_of,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import plain as plain_form
from coadjoint.short_repr import short
from coadjoint.validation import is_real, read_integer, to_array

# Values beyond float64 become infinite without a warning.
IGNORE_OVERFLOW = np.errstate(over="ignore", invalid="ignore")
MAX_DEGREE = 1024
BYTES_PER_EXPONENT = 30  # peak during construction of a monomial
TOO_HIGH = "beyond it even powers of 2 leave the range of float64"


@suggest_keywords
class Polynomial:
    """A polynomial in x_1 ... x_n: a mapping from exponents to coefficients.

    Integer and rational coefficients stay exact in every operation; floats stay floats. The object is immutable.

    Parameters
    ----------
    monomials : mapping or str
        ``{(2, 0, 0): 0.5, (0, 1, 1): -1}`` is x1^2/2 - x2 x3: exponents (one per coordinate) -> coefficient. Or a
        formula, such as ``"(x1 + x2)^2/2 - x2*x3"``, with `dim` or `basis`; it is multiplied out.
    dim : int, optional
        Number of coordinates; required for text, and if `monomials` is empty (the zero polynomial).
    basis : sequence of str, optional
        Names of the coordinates in the text, in their order, in place of x1, x2, ...; also used for printing.
    parameters : mapping, optional
        Numbers in the text by name.

    Raises
    ------
    TypeError
        An exponent is not a whole number, or a coefficient not int, float or Fraction.
    ValueError
        Exponents of different lengths or negative, a coefficient that is not finite, or an unknown dimension.

    Examples
    --------
    >>> p = Polynomial({(2, 0, 0): 0.5, (0, 1, 1): 1})
    >>> p
    0.5*x1^2 + x2*x3
    >>> p([2.0, 3.0, 4.0])
    14.0
    >>> p.derivative(2) * p.derivative(1)
    x2*x3
    >>> p == Polynomial("0.5*x1^2 + x2*x3", dim=3) == Polynomial("0.5*h^2 + e*f", basis=("h", "e", "f"))
    True
    """

    # Prevents NumPy arrays from multiplying a polynomial entry by entry.
    __array_ufunc__ = None
    _names: tuple[str, ...] | None = None
    _written_names: tuple[str, ...] | None = None
    """Names of the coordinates in the text that the polynomial was made of."""
    _renamed: Polynomial | None = None

    def __init__(
        self,
        monomials: Mapping[Exponents, Coefficient] | str,
        dim: int | None = None,
        basis: Sequence[str] | None = None,
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        if isinstance(monomials, str):
            from coadjoint.algebra.polynomials.formulas import read_polynomial

            monomials, dim = read_polynomial(monomials, dim, basis, parameters)
            self._written_names = tuple(coordinate_names(dim) if basis is None else basis)
            self._names = special_names(self._written_names)
        elif basis is not None or parameters is not None:
            name, meaning = ("basis", "coordinates") if basis is not None else ("parameters", "numbers")
            raise TypeError(f"{name} is given with exponents; it names the {meaning} of a text, so omit it")
        self._fill(*read_monomials(monomials, dim))

    def _fill(self, monomials: Mapping[Exponents, Coefficient], dim: int) -> None:
        order = sorted(monomials, key=lambda e: (sum(e), tuple(map(operator.neg, e))))
        if order and sum(order[-1]) > MAX_DEGREE:
            degree = short(sum(order[-1]))
            raise ValueError(f"a Polynomial has at most degree {MAX_DEGREE}, and this one has {degree}; {TOO_HIGH}")
        self._monomials = {e: monomials[e] for e in order if monomials[e] != 0}
        self._dim = dim

    @classmethod
    def _from_valid(cls, monomials: Mapping[Exponents, Coefficient], dim: int) -> Polynomial:
        """Construct from valid monomials; only overflow of a coefficient is checked."""
        for exponents, value in monomials.items():
            if not is_finite(value):
                raise ValueError(f"the coefficient of {short(exponents)} overflows; it must stay within float64")
        result = cls.__new__(cls)
        result._fill(monomials, dim)
        return result

    @classmethod
    def variable(cls, i: int, dim: int) -> Polynomial:
        """Return the coordinate x_i (index from 0) as a polynomial in `dim` coordinates.

        Examples
        --------
        >>> Polynomial.variable(1, 3)
        x2
        """
        dim = read_integer(dim, "dim of a Polynomial")
        i = read_integer(i, "the index of a coordinate", 0, dim - 1)
        check_available_memory(BYTES_PER_EXPONENT * dim, f"a coordinate among {short(dim)}")
        return cls._from_valid({exponents_of((i,), dim): 1}, dim)

    @property
    def dim(self) -> int:
        """Number of coordinates n."""
        return self._dim

    @property
    def monomials(self) -> Mapping[Exponents, Coefficient]:
        """Exponents -> coefficient, read-only; by degree, and x1 before x2 within a degree; no zeros."""
        return MappingProxyType(self._monomials)

    @property
    def degree(self) -> int:
        """The largest degree of a monomial; 0 for constants, and for the zero polynomial."""
        return sum(next(reversed(self._monomials))) if self._monomials else 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates in printed forms: x1, ..., xn, or those of a system; they do not affect equality."""
        return self._names or tuple(coordinate_names(self._dim))

    def named(self, names: Sequence[str]) -> Polynomial:
        """Return this polynomial with other names of the coordinates in its printed forms."""
        special = special_names(read_names(names, self._dim))
        if special == self._names:
            return self
        if self._renamed is None or self._renamed._names != special:
            renamed = Polynomial.__new__(Polynomial)
            renamed.__dict__.update(self.__dict__, _names=special, _written_names=None, _renamed=None)
            self._renamed = renamed
        return self._renamed

    def _transformed(self, change: Callable[[Polynomial], Polynomial], restricted: bool = False) -> Polynomial:
        """Return what `change` makes of it, the same function in other coordinates or `restricted` to a subspace."""
        return change(self)

    @property
    def _term_count(self) -> int:
        return len(self._monomials)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_renamed"}

    def _with_monomials(self, monomials: Mapping[Exponents, Coefficient], *others: Polynomial) -> Polynomial:
        """Return a result in the same coordinates, with the names of this or of another operand."""
        result = Polynomial._from_valid(monomials, self._dim)
        for p in (self, *others):
            result._names = result._names or p._names
        result._written_names = joined_names((self, *others))
        return result

    def __repr__(self) -> str:
        return plain(self._monomials, self.names)

    def to_latex(self) -> str:
        """Return the LaTeX form, without dollar signs.

        Returns
        -------
        str

        Examples
        --------
        >>> print(Polynomial({(2, 0): 0.5, (0, 1): -3}).to_latex())
        -3 x_{2} + 0.5 x_{1}^{2}
        """
        return latex(self._monomials, self.names)

    def _repr_latex_(self) -> str:
        return f"${self.to_latex()}$"

    def to_sympy(self) -> Any:
        """Return a SymPy expression in symbols called `names`; fractions stay exact.

        Returns
        -------
        sympy.Expr

        Raises
        ------
        MissingPackageError
            SymPy is not installed.
        """
        return sympy_of(self._monomials, self.names)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Polynomial):
            return NotImplemented
        return self._dim == other._dim and self._monomials == other._monomials

    def __hash__(self) -> int:
        return hash((self._dim, tuple(self._monomials.items())))

    def _operand(self, other: object) -> Polynomial | None:
        if isinstance(other, Polynomial):
            if other._dim != self._dim:
                raise ValueError(f"polynomials in {self._dim} and in {other._dim} coordinates cannot be combined")
            return other
        if is_real(other):
            return Polynomial({(0,) * self._dim: read_coefficient(other, "constant")})
        return None

    def __add__(self, other: Polynomial | Coefficient) -> Polynomial:
        operand = self._operand(other)
        if operand is None:
            return NotImplemented
        total = dict(self._monomials)
        for exponents, value in operand._monomials.items():
            total[exponents] = total[exponents] + value if exponents in total else value
        return self._with_monomials(total, operand)

    __radd__ = __add__

    def __neg__(self) -> Polynomial:
        return self._with_monomials({exponents: -value for exponents, value in self._monomials.items()})

    def __sub__(self, other: Polynomial | Coefficient) -> Polynomial:
        operand = self._operand(other)
        return NotImplemented if operand is None else self + -operand

    def __rsub__(self, other: Coefficient) -> Polynomial:
        return -self + other

    def __mul__(self, other: Polynomial | Coefficient) -> Polynomial:
        operand = self._operand(other)
        if operand is None:
            return NotImplemented
        total: dict[Exponents, Coefficient] = {}
        for left, value in self._monomials.items():
            for right, factor in operand._monomials.items():
                exponents = tuple(map(operator.add, left, right))
                total[exponents] = total[exponents] + value * factor if exponents in total else value * factor
        return self._with_monomials(total, operand)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Coefficient) -> Polynomial:
        if not is_real(divisor):
            return NotImplemented
        number = read_coefficient(divisor, "the divisor of a Polynomial")
        if number == 0:
            raise ValueError(f"a Polynomial can be divided by a number other than 0, not by {short(divisor)}")
        return self._with_monomials({e: quotient(value, number) for e, value in self._monomials.items()})

    def __pow__(self, power: int) -> Polynomial:
        exponent = read_integer(power, "the power of a Polynomial", 0, MAX_DEGREE, reason=TOO_HIGH)
        if self.degree * exponent > MAX_DEGREE:
            raise ValueError(f"a Polynomial has at most degree {MAX_DEGREE}, not {self.degree * exponent}; {TOO_HIGH}")
        result, square = self._with_monomials({(0,) * self._dim: 1}), self
        while exponent:
            if exponent & 1:
                result = result * square
            exponent >>= 1
            if exponent:
                square = square * square
        return result

    def derivative(self, i: int) -> Polynomial:
        """Return the derivative with respect to coordinate i.

        Parameters
        ----------
        i : int
            Index of the coordinate, from 0.

        Returns
        -------
        Polynomial

        Raises
        ------
        ValueError
            i is out of range.

        Examples
        --------
        >>> Polynomial({(3, 1): 2}).derivative(0)
        6*x1^2*x2
        """
        i = read_integer(i, "the index of a coordinate", 0, self._dim - 1)
        terms = {e[:i] + (e[i] - 1,) + e[i + 1 :]: e[i] * value for e, value in self._monomials.items() if e[i]}
        return self._with_monomials(terms)

    @cached_property
    def _factors(self) -> list[tuple[int, Coefficient, dict[int, int]]]:
        every = range(self._dim)
        return [(0, value, {i: x[i] for i in compress(every, x)}) for x, value in self._monomials.items()]

    @cached_property
    def _value_sum(self) -> ProductSum:
        return ProductSum(self._factors, 1)

    @cached_property
    def _gradient_sum(self) -> ProductSum:
        return ProductSum(differentiated(self._factors, self._dim), self._dim)

    @cached_property
    def _hessian_sum(self) -> ProductSum:
        twice = differentiated(differentiated(self._factors, self._dim), self._dim)
        return ProductSum(twice, self._dim**2)

    @staticmethod
    def side_by_side(polynomials: Sequence[Polynomial]) -> ProductSum:
        """Return a function that evaluates several polynomials in the same coordinates together, `ProductSum.along`."""
        terms = ((k, value, factors) for k, p in enumerate(polynomials) for _, value, factors in p._factors)
        return ProductSum(terms, len(polynomials))

    def _point(self, x: Any, several: bool = False) -> NDArray[Any]:
        point = to_array(x, "x", "iufc")
        if point.shape != (self._dim,) and not (several and point.shape[-1:] == (self._dim,)):
            shape = f"(..., {self._dim})" if several and point.ndim > 1 else f"({self._dim},)"
            raise ValueError(f"x must have shape {shape}, not {point.shape}")
        return point if point.dtype == object else point.astype(np.result_type(point.dtype, np.float64), copy=False)

    @IGNORE_OVERFLOW
    def __call__(self, x: Any) -> Any:
        """Return the value at x, shape (n,), or the values at states of shape (..., n).

        With dtype object (Fraction, mpmath) they are as exact as x is.
        """
        point = self._point(x, several=True)
        if point.ndim == 1:
            return self._value_sum(point).item(0)
        return self._value_sum.along(point)[..., 0]

    @IGNORE_OVERFLOW
    def gradient(self, x: Any) -> NDArray[Any]:
        """Return the gradient at x, both of shape (n,), or at states of shape (..., n); dtype object is allowed.

        Examples
        --------
        >>> Polynomial({(2, 1): 1}).gradient([3.0, 5.0])
        array([30.,  9.])
        """
        point = self._point(x, several=True)
        return self._gradient_sum(point) if point.ndim == 1 else self._gradient_sum.along(point)

    def gradient_and_size(self, x: Any) -> tuple[NDArray[Any], NDArray[Any], int]:
        """Return the gradient, the sums of its absolute products in each component, and a bound of their number."""
        monomials: dict[tuple[int, ...], Any] = {exponents: abs(c) for exponents, c in self.monomials.items()}
        absolute = Polynomial(monomials, dim=self.dim)
        return self.gradient(x), absolute.gradient(np.abs(x)), 64 + 2 * self.dim + len(self.monomials) + self.degree

    @IGNORE_OVERFLOW
    def hessian(self, x: Any) -> NDArray[Any]:
        """Return the second derivatives at x, shape (n, n); dtype object is allowed.

        Examples
        --------
        >>> Polynomial({(2, 1): 1}).hessian([3.0, 5.0])
        array([[10.,  6.],
               [ 6.,  0.]])
        """
        return self._hessian_sum(self._point(x)).reshape(self._dim, self._dim)


SparseKey = tuple[tuple[int, int], ...]
"""Coordinates of a monomial, ascending, with their exponents."""
SparseMonomials = dict[SparseKey, Any]


class SparsePolynomial(Polynomial):
    """A polynomial of few of many coordinates in each monomial, stored by coordinates with their exponents.

    Its `monomials`, with an exponent for each coordinate, are made when they are read.
    """

    def __init__(self, monomials: Mapping[SparseKey, Coefficient], dim: int) -> None:
        for factors, value in monomials.items():
            if not is_finite(value):
                raise ValueError(f"the coefficient of {short(factors)} overflows; it must stay within float64")

        def order(factors: SparseKey) -> Any:
            return sum(e for _, e in factors), [(i, -e) for i, e in factors]

        self._dim = dim
        self._factors = [(0, monomials[key], dict(key)) for key in sorted(monomials, key=order) if monomials[key] != 0]

    @cached_property
    def _monomials(self) -> dict[Exponents, Coefficient]:  # type: ignore[override]
        check_available_memory(BYTES_PER_EXPONENT * self._dim * len(self._factors), "exponents of all coordinates")
        return {tuple(factors.get(i, 0) for i in range(self._dim)): value for _, value, factors in self._factors}

    @property
    def degree(self) -> int:
        return sum(self._factors[-1][2].values()) if self._factors else 0

    @property
    def _term_count(self) -> int:
        return len(self._factors)


@plain_form.register(Polynomial)
def _(value: Polynomial) -> list[Any]:
    return [[float(coefficient), list(powers)] for powers, coefficient in value.monomials.items()]
