"""Monomials: validation, vectorized sums of products in any number type, and their text: plain, LaTeX, SymPy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from itertools import combinations_with_replacement, pairwise
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number, exact_numbers, is_finite
from coadjoint.errors import in_one_line
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import MAX_TITLE_LENGTH, is_integer, is_real, read_integer, read_list, read_title

Coefficient = int | float | Fraction
Exponents = tuple[int, ...]
Monomials = Mapping[Exponents, Coefficient]

MAX_NUMBERS = 2**18
"""Number of products evaluated at once for many points; more do not fit the cache."""

MAX_DIGITS = 6  # of numbers that are shown, as of format "g"
MAX_SHOWN = 30  # monomials printed individually
MAX_SHOWN_NAMES = 120  # letters of names in a message


def read_exponents(argument: Any) -> Exponents:
    """Validate exponents and return them as Python integers."""
    if not isinstance(argument, tuple | list):
        raise TypeError(f"exponents must be a tuple of whole numbers, one for each coordinate, not {short(argument)}")
    if set(map(type, argument)) <= {int} and min(argument, default=0) >= 0:  # fast path for many coordinates
        return tuple(argument)
    for exponent in argument:
        if not is_integer(exponent):
            raise TypeError(f"exponents {short(argument)} must be whole numbers; {short(exponent)} is not")
        if exponent < 0:
            raise ValueError(f"exponents {short(argument)} must not be negative")
    return tuple(map(int, argument))


def exponents_of(factors: Iterable[int], dim: int) -> Exponents:
    """Return the exponents of a product of coordinates, given by their indices."""
    exponents = [0] * dim
    for i in factors:
        exponents[i] += 1
    return tuple(exponents)


def exponents_of_degree(dim: int, degree: int) -> Iterator[Exponents]:
    """Yield the exponents of all products of `degree` coordinates."""
    return (exponents_of(factors, dim) for factors in combinations_with_replacement(range(dim), degree))


def factors_of(exponents: Exponents) -> list[int]:
    """Return the coordinates in a monomial with multiplicity; fast for low degrees and many coordinates."""
    factors: list[int] = []
    for degree in range(1, max(exponents) + 1):
        coordinate = -1
        for _ in range(exponents.count(degree)):
            coordinate = exponents.index(degree, coordinate + 1)
            factors += [coordinate] * degree
    return sorted(factors)


def read_coefficient(value: Any, what: str, *of: Any) -> Coefficient:
    """Validate a coefficient and return it as int, float or Fraction; messages name it by `what` and what it is of."""
    if not (is_real(value) and isinstance(value, Rational | float | np.floating)):
        raise TypeError(f"{' '.join([what, *map(short, of)])} must be an int, float or Fraction, not {short(value)}")
    number: Coefficient = exact_number(value) if isinstance(value, Rational) else float(value)
    if not is_finite(number):
        raise ValueError(f"{' '.join([what, *map(short, of)])} is {short(value)}; it must be finite and within float64")
    return number


def read_monomials(monomials: Any, dim: Any) -> tuple[dict[Exponents, Coefficient], int]:
    """Validate the monomials of a polynomial, and its dimension; without one, it is the number of exponents."""
    if not isinstance(monomials, Mapping):
        raise TypeError(
            "monomials must be a mapping {exponents: coefficient}, or a text such as '0.5*x1^2 - x2*x3', not "
            f"{type(monomials).__name__}"
        )
    if dim is not None:
        dim = read_integer(dim, "dim of a Polynomial")
    if not monomials and dim is None:
        raise ValueError("dim must be given for a Polynomial without monomials")
    collected: dict[Exponents, Coefficient] = {}
    for key, value in monomials.items():
        exponents = read_exponents(key)
        if dim is None:
            dim = len(exponents)
        if len(exponents) != dim:
            raise ValueError(
                f"exponents {short(key)} have length {len(exponents)}; this Polynomial has dimension {short(dim)}"
            )
        collected[exponents] = read_coefficient(value, "the coefficient of", key)
    if dim is None or dim < 1:
        raise ValueError("a Polynomial needs at least one coordinate; its exponents are empty")
    return collected, int(dim)


def differentiated(
    terms: Iterable[tuple[int, Coefficient, dict[int, int]]], dim: int
) -> list[tuple[int, Coefficient, dict[int, int]]]:
    """Differentiate products by each of their coordinates; target t maps to t * dim + i."""
    result: list[tuple[int, Coefficient, dict[int, int]]] = []
    for target, value, factors in terms:
        for i, e in factors.items():
            left = {j: f - (j == i) for j, f in factors.items() if j != i or f > 1}
            result.append((target * dim + i, e * value, left))
    return result


class ProductSum:
    """Sums of terms (target, coefficient, {coordinate: exponent}), added to entry `target` of a result of `size`."""

    def __init__(self, terms: Iterable[tuple[int, Coefficient, dict[int, int]]], size: int) -> None:
        rows = sorted(terms, key=lambda term: not term[2])  # constants last, since they have no product
        self._size = size
        self._targets = np.array([target for target, _, _ in rows], dtype=np.int64)
        try:
            self._exact = exact_numbers(value for _, value, _ in rows)
            self._coefficients = np.array([float(value) for _, value, _ in rows])
        except OverflowError:
            raise ValueError(
                "a coefficient of a polynomial, or of its derivatives, leaves the range of float64"
            ) from None
        sizes = [len(factors) for _, _, factors in rows if factors]
        self._starts = (
            np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if sizes else np.zeros(0, dtype=np.int64)
        )
        self._index = np.array([i for _, _, factors in rows for i in factors], dtype=np.int64)
        self._power = np.array([e for _, _, factors in rows for e in factors.values()], dtype=np.int64)

    def __call__(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums at the point x, in its number type."""
        result = np.zeros(self._size, dtype=x.dtype)
        terms = (self._exact if x.dtype == object else self._coefficients.astype(x.dtype)).copy()
        if self._starts.size:
            power = self._power.astype(object) if x.dtype == object else self._power
            terms[: self._starts.size] *= np.multiply.reduceat(x[self._index] ** power, self._starts)
        np.add.at(result, self._targets, terms)
        return result

    def along(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return sums at points (..., n), shape (..., size): faster than point by point, and equal up to rounding."""
        points = x.reshape(-1, x.shape[-1])
        result = np.zeros((len(points), self._size), dtype=x.dtype)
        if len(self._targets):
            _, targets, _ = self._by_target
            count, _, _ = self._distinct_products
            chunk = max(1, MAX_NUMBERS // (len(self._targets) + count))
            for first in range(0, len(points), chunk):
                rows = slice(first, first + chunk)
                result[rows, targets] = self._nonconstant_sums(np.ascontiguousarray(points[rows].T)).T
        return result.reshape(*x.shape[:-1], self._size)

    def _nonconstant_sums(self, x: NDArray[Any]) -> NDArray[Any]:
        """Return the sums that have terms at points (n, k), shape (targets with terms, k)."""
        (order, _, starts), (count, factors, product) = self._by_target, self._distinct_products
        powers = [x]
        while len(powers) < int(self._power.max(initial=1)):
            powers.append(powers[-1] * x)
        table = np.stack(powers)
        products = np.ones((count, x.shape[1]), dtype=x.dtype)
        for row, index, power in factors:
            products[row] = products[row] * table[power - 1, index]
        coefficients = self._exact if x.dtype == object else self._coefficients.astype(x.dtype)
        return np.add.reduceat(products[product[order]] * coefficients[order][:, None], starts, axis=0)

    @cached_property
    def _by_target(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The terms in order of target, the targets, and the first term of each."""
        order = np.argsort(self._targets, kind="stable")
        return order, *np.unique(self._targets[order], return_index=True)

    @cached_property
    def _distinct_products(self) -> tuple[int, list[tuple[NDArray[np.int64], ...]], NDArray[np.int64]]:
        """The number of distinct products, their first, second and further factors, and the product of each term."""
        of_rows: list[tuple[tuple[int, int], ...]] = [()] * len(self._targets)
        ends = np.append(self._starts, len(self._index))
        for row, (first, last) in enumerate(pairwise(ends.tolist())):
            of_rows[row] = tuple(
                sorted(zip(self._index[first:last].tolist(), self._power[first:last].tolist(), strict=True))
            )
        product_index = {factors: k for k, factors in enumerate(dict.fromkeys(of_rows))}
        steps: list[list[tuple[int, int, int]]] = [[] for _ in range(max(map(len, product_index), default=0))]
        for factors, k in product_index.items():
            for step, (i, e) in zip(steps, factors, strict=False):
                step.append((k, i, e))
        columns = [tuple(np.array(step, dtype=np.int64).T) for step in steps]
        return len(product_index), columns, np.array([product_index[factors] for factors in of_rows], dtype=np.int64)


def coordinate_names(dim: int) -> list[str]:
    """Return the names x1, ..., xn."""
    return [f"x{i}" for i in range(1, dim + 1)]


def names_of_basis(basis: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the coordinates for those of the basis elements; e1, e2, ... become x1, x2, ..."""
    names = tuple(re.sub(r"^e(?=\d)", "x", name) for name in basis)
    return names if len(set(names)) == len(names) else tuple(basis)  # e1 beside x1


def names_clash(first: Sequence[str], second: Sequence[str]) -> bool:
    """Return whether a name is that of two different coordinates."""
    numbers = {name: k for k, name in enumerate(first)}
    return any(numbers.get(name, k) != k for k, name in enumerate(second))


def numbers_by_name(names: Sequence[str], numbered: bool = True) -> dict[str, int]:
    """Return the number of a coordinate by its name, or that of its basis element; `numbered`, also by x1, x2, ..."""
    # Names of a kind of which one is that of another coordinate are left out.
    elements = [re.sub(r"^x(?=\d)", "e", name) for name in names]
    known: dict[str, int] = {}
    for kind in (names, names_of_basis(names), elements, coordinate_names(len(names)) if numbered else ()):
        if all(known.get(name, k) == k for k, name in enumerate(kind)):
            known.update((name, k) for k, name in enumerate(kind))
    return known


def check_names(function: Any, names: Sequence[str], what: str) -> None:
    """Raise ValueError if a function is written in names of which the system uses one for another coordinate."""
    for part in getattr(function, "summands", (function,)):
        written = getattr(part, "_written_names", None)
        if written is not None and names_clash(names_of_basis(written), names_of_basis(names)):
            given, right = (in_one_line(", ".join(each), MAX_SHOWN_NAMES) for each in (written, names))
            raise ValueError(f"{what} is written in {given}; the coordinates are {right}: write it in these, by basis=")


def joined_names(functions: Iterable[Any]) -> tuple[str, ...] | None:
    """Return the names that a sum or product of functions is written in; raise ValueError if they contradict."""
    found: tuple[str, ...] | None = None
    for function in functions:
        check_names(function, found or (), "a summand")
        found = getattr(function, "_written_names", None) or found
    return found


def read_names(names: Any, dim: int) -> tuple[str, ...]:
    """Validate names of the coordinates of a polynomial."""
    given = read_list(names, "names", "give one name for each coordinate")
    if len(given) != dim:
        raise ValueError(f"names has {len(given)} entries; this Polynomial has {dim} coordinates")
    # Each Casimir gets the names of all spins, which are tested together.
    if not (
        set(map(type, given)) <= {str}
        and all(given)
        and "".join(given).isprintable()
        and max(map(len, given)) <= MAX_TITLE_LENGTH
    ):
        for name in given:
            read_title(name, "a name of a coordinate")
    return given


def special_names(names: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return names of coordinates; None if they are x1, ..., xn."""
    return None if all(name == f"x{i}" for i, name in enumerate(names, 1)) else names


def plain(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial in the notation that `Polynomial` parses."""
    return _format_sum(monomials, names, "{0}^{1}", "*", "({0}/{1})", str)


def latex(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial as LaTeX, without dollar signs."""
    factors = [latex_name(name) for name in names]
    braced = [f"{{{factor}}}" if "^" in factor else factor for factor in factors]
    return _format_sum(monomials, braced, "{0}^{{{1}}}", " ", r"\frac{{{0}}}{{{1}}}", _latex_number)


GREEK = ("alpha", "beta", "gamma", "theta", "phi", "psi", "omega", "mu", "rho", "sigma")


def latex_name(name: str) -> str:
    """Format the name of a coordinate or symbol: x12 as x_{12}, m1_2 as m_{1,2}; other forms of names are unchanged."""
    match = re.fullmatch(r"([A-Za-z]+?)_?(\d[\d_,]*)?(\[\d+\])?", name)
    if match is None:
        return name
    letters = rf"\{match[1]}" if match[1] in GREEK else match[1]
    subscript = f"_{{{match[2].replace('_', ',')}}}" if match[2] else ""
    superscript = f"^{{{match[3]}}}" if match[3] else ""
    return f"{letters}{subscript}{superscript}"


def sympy_of(monomials: Monomials, names: Sequence[str]) -> Any:
    """Return a SymPy expression in symbols of the given names; fractions stay exact."""
    require_packages("an expression of SymPy", "sympy")
    import sympy

    symbols = [sympy.Symbol(name) for name in names]  # sympy.symbols would split names with commas or brackets
    total = sympy.Integer(0)
    for exponents, value in monomials.items():
        exact = Fraction(value)
        number = sympy.Float(value) if isinstance(value, float) else sympy.Rational(exact.numerator, exact.denominator)
        total += sympy.Mul(number, *(symbol**power for symbol, power in zip(symbols, exponents, strict=True) if power))
    return total


def readable(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial on one line with short coefficients; only a count if it has many monomials."""
    if len(monomials) > MAX_SHOWN:
        return f"<{len(monomials)} monomials of degree {max(map(sum, monomials))} and less>"
    return plain(rounded_if_long(monomials), names)


def readable_latex(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial as LaTeX with short coefficients, without dollar signs."""
    if len(monomials) > MAX_SHOWN:
        return rf"\text{{{len(monomials)} monomials}}"
    return latex(rounded_if_long(monomials), names)


def rounded_if_long(monomials: Monomials) -> dict[tuple[int, ...], Coefficient]:
    """Round coefficients with more than six digits to six; keep short fractions."""
    return {exponents: _readable(value) for exponents, value in monomials.items()}


def _readable(value: Coefficient) -> Coefficient:
    if isinstance(value, float) or max(abs(Fraction(value).numerator), Fraction(value).denominator) >= 10**MAX_DIGITS:
        return float(f"{float(value):.{MAX_DIGITS}g}")
    return value


def _format_sum(
    monomials: Monomials,
    names: Sequence[str],
    power: str,
    separator: str,
    quotient: str,
    number: Callable[[Coefficient], str],
) -> str:
    text = ""
    for exponents, value in monomials.items():
        factors = [name if e == 1 else power.format(name, e) for name, e in zip(names, exponents, strict=True) if e]
        size: Any = abs(value)
        if size != 1 or not factors:
            is_quotient = isinstance(size, Fraction) and size.denominator != 1
            factors.insert(0, quotient.format(size.numerator, size.denominator) if is_quotient else number(size))
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        text += sign + separator.join(factors)
    return text or "0"


def _latex_number(size: Coefficient) -> str:
    digits, _, exponent = f"{size}".partition("e")
    return rf"{digits} \times 10^{{{int(exponent)}}}" if exponent else digits
