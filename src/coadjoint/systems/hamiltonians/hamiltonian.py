"""The interface of Hamiltonians, and Hamiltonians given by Python functions, polynomials or user-defined classes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, Self, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.formula_tree import names_in, read_dimension
from coadjoint.algebra.polynomials.formulas import NotPolynomial, parse_polynomial
from coadjoint.algebra.polynomials.monomials import Coefficient, check_names, coordinate_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, Summable, check_variables
from coadjoint.systems.hamiltonians.terms import FunctionTerm, Term
from coadjoint.systems.hamiltonians.traced_function import (
    TracingError,
    picklable_state,
    restore_state,
    traced_with_arrays,
)
from coadjoint.systems.hamiltonians.user_hamiltonian import (
    REQUIRED_ATTRIBUTES,
    JaxFunction,
    ParsedFunction,
    check_traceable,
    check_user_hamiltonian,
    is_array_of_jax,
    is_user_defined,
)
from coadjoint.systems.user_functions import (
    SumOfShares,
    all_take_time,
    at_constants,
    check_derivative,
    multiple_of,
    numbers_at_samples,
    without_multiples,
)
from coadjoint.validation import is_of_torch, read_integer

MAX_CACHED_MONOMIALS = 64  # monomials of cached polynomials


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


@suggest_keywords
class Hamiltonian(Summable):
    """A Hamiltonian given by Python functions.

    Use it if H is neither quadratic, polynomial nor separable; a system makes it of a plain function or the text of a
    `formula`. Schemes that need no splitting support it. Splittings do if the recorded operations of `value` are a sum
    of functions of commuting coordinates; for a function that cannot be recorded, give this sum as a `Separable` or
    `SplitHamiltonian`.

    Parameters
    ----------
    value : callable
        Pure function of ``(x)`` or ``(x, t)``, x of shape (n,); returns a number.
    gradient : callable, optional
        Function of the same arguments that returns shape (n,). Checked against the central difference of `value`.
        Without it both derivatives are derived from `value`; see Notes.
    hessian : callable, optional
        Function of the same arguments that returns shape (n, n). Needed for exact tangents.

    Raises
    ------
    TypeError
        Not functions, or functions of different arguments. In `bind`: no derivatives can be derived.
    ValueError
        In `bind`: a shape is wrong, or a derivative disagrees with a finite difference at a sample point.

    Notes
    -----
    Derivatives are derived in `bind`, for the dimension of the system, exactly:

    - If `value` returns an array of JAX, it is a function of JAX, such as a neural network, and is differentiated by
      ``jax.grad`` and ``jax.hessian``. The loops call it in Python, 10 to 50 us for each gradient. Numbers must be of
      float64, which JAX has with ``jax.config.update("jax_enable_x64", True)``.
    - Otherwise its operations are recorded and differentiated one by one: arithmetic, and functions of NumPy with a
      derivative everywhere in their domains. The results are compiled by Numba like functions that are given. A
      function with comparisons, absolute values or more than 2000 operations is refused.

    The representation of a bound Hamiltonian names which of them was used.

    Examples
    --------
    >>> H = Hamiltonian(lambda x: np.cosh(x[0]) + x[1] ** 2, lambda x: np.array([np.sinh(x[0]), 2 * x[1]]))
    >>> H.bind(2).gradient([0.0, 3.0])
    array([0., 6.])
    >>> derived = Hamiltonian(lambda x: np.cosh(x[0]) + x[1] ** 2).bind(2)
    >>> derived.gradient([0.0, 3.0])
    array([0., 6.])
    >>> derived
    Hamiltonian(<lambda>, derivatives of recorded operations)
    """

    def __init__(
        self,
        value: Callable[..., Any],
        gradient: Callable[..., Any] | None = None,
        hessian: Callable[..., Any] | None = None,
    ) -> None:
        if isinstance(value, str):
            raise TypeError(f"value is the text {short(value)}; give co.formula(text, dim), or the text to the system")
        if gradient is None and hessian is not None:
            raise TypeError("hessian was given without gradient; give both, or neither to derive them from value")
        self.timed = all_take_time({"value": value, "gradient": gradient, "hessian": hessian})
        self.dim: int | None = None
        self._value, self._gradient, self._hessian = value, gradient, hessian
        self._loop_value, self._derived_by = value, ""

    def bind(self, n: int) -> Hamiltonian:
        """Return this Hamiltonian bound to dimension `n`, after checking its functions at sample points."""
        n = read_integer(n, "the dimension")
        if self.dim is not None and self.dim != n:
            raise ValueError(f"the Hamiltonian is bound to dimension {self.dim}, not {short(n)}; make a new one")
        if self.dim == n:
            return self
        if self._gradient is None:
            return self._derived(n).bind(n)
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
        bound = copy.copy(self)
        bound.dim = n
        return bound

    def _derived(self, n: int) -> Self:
        """Return this Hamiltonian with derivatives derived from its value."""
        result = copy.copy(self)
        values = numbers_at_samples(self._value, n, self.timed)
        if getattr(self._value, "of_jax", False) or any(map(is_array_of_jax, values)):
            check_traceable(self._value, n, self.timed)
            functions: tuple[Any, ...] = tuple(JaxFunction(self._value, order, self.timed) for order in range(3))
            result._derived_by = "derivatives by JAX"
        else:
            try:
                functions = traced_with_arrays(self._value, n, self.timed).derivatives()
            except TracingError as reason:
                raise TypeError(
                    f"the gradient cannot be derived from the Hamiltonian alone: {reason}; give gradient=, or "
                    "write the function with jax.numpy, or of PyTorch as co.torch.energy(function, params)"
                ) from reason
            result._derived_by = "derivatives of recorded operations"
        result._loop_value, result._gradient, result._hessian = functions
        return result

    __getstate__, __setstate__ = picklable_state, restore_state

    def __copy__(self) -> Self:
        result = object.__new__(type(self))
        vars(result).update(vars(self))
        return result

    def times(self, factor: Coefficient) -> Self:
        result = copy.copy(self)
        result._value, result._loop_value = (
            multiple_of(function, factor, scalar=True) for function in (self._value, self._loop_value)
        )
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
        if self._gradient is None:
            return self.bind(np.size(x)).gradient(x, t)
        return np.asarray(self._call(self._gradient, x, t)[0])

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        if self._gradient is None:
            return self.bind(np.size(x)).hessian(x, t)
        if self._hessian is None:
            raise TypeError("this Hamiltonian has no second derivatives; give hessian=")
        return np.asarray(self._call(self._hessian, x, t)[0])

    def terms(self) -> tuple[Term, ...]:
        """Return the single `FunctionTerm`, of all coordinates; the Hamiltonian must be bound."""
        if self.dim is None:
            raise TypeError("this Hamiltonian has no dimension yet; call bind(n) first")
        coordinates, gradient = np.arange(self.dim, dtype=np.int64), cast("Callable[..., Any]", self._gradient)
        return (FunctionTerm(coordinates, self._loop_value, gradient, self._hessian, timed=self.timed),)

    @property
    def _written_names(self) -> tuple[str, ...] | None:
        """Names of the coordinates in the text of a formula; None for other functions."""
        found = formula_of(self)
        return None if found is None else found[0].names

    def __repr__(self) -> str:
        functions = (self._value,) if self._derived_by else (self._value, self._gradient, self._hessian)
        names = [getattr(f, "__name__", short(f)) for f in functions if f is not None]
        return f"Hamiltonian({', '.join([*names, *filter(None, [self._derived_by])])})"


class FunctionOfConstants(NamedTuple):
    """value(y, c) of y = x[coordinates] and constants c (k,), with its derivatives by y, analytic in both."""

    # If there are several `shares`, value(y, c, number) and gradient(y, c, number) are those of one.

    coordinates: npt.NDArray[np.int64]
    constants: npt.NDArray[Any]
    value: Callable[..., Any]
    gradient: Callable[..., Any]
    hessian: Callable[..., Any]
    shares: int = 1

    def hamiltonian(self) -> Hamiltonian:
        """Return the function of y, bound without a check of the derivatives, which takes minutes for 200 bodies."""
        c, value, gradient = self.constants, self.value, self.gradient
        functions = [at_constants(function, c) for function in (value, gradient, self.hessian)]
        if self.shares > 1:
            shares = (lambda y, k: value(y, c, k)), (lambda y, k: gradient(y, c, k))
            functions[:2] = (SumOfShares(share, self.shares) for share in shares)
        energy = Hamiltonian(*functions)
        energy.dim = len(self.coordinates)
        return energy


# Members of an ensemble share Casimirs, so the conversion is cached. Polynomials of floats and of integers can compare
# equal, so the number types are part of the key, as are the names.
@lru_cache(maxsize=64)
def _quadratic(polynomial: Polynomial, key: tuple[Any, ...]) -> Quadratic:
    return Quadratic.from_polynomial(polynomial)


def formula(
    text: str,
    dim: int | None = None,
    basis: Sequence[str] | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> Polynomial | Hamiltonian:
    """Return the energy, or any other function of the coordinates, of a formula.

    Use it for an energy as text with parameters, or with functions such as ``cos``. Without parameters the text itself
    can be given as the Hamiltonian of a system.

    Parameters
    ----------
    text : str
        Sums, products, quotients and powers (``^`` or ``**``) of numbers, coordinates and parameters, brackets, and
        the functions sin, cos, tan, atan, exp, log, sqrt, sinh, cosh and tanh. ``pi`` is a number.
    dim : int, optional
        Number of coordinates x1, x2, ...; required without `basis`.
    basis : sequence of str, optional
        Names of the coordinates, in their order, in place of x1, x2, ..., such as ``algebra.basis``.
    parameters : mapping, optional
        Name to number; a name may not be that of a coordinate.

    Returns
    -------
    Polynomial or Hamiltonian
        A polynomial if the formula is one, with exact coefficients where its numbers are whole; otherwise a Hamiltonian
        whose derivatives are derived, and which is stored and pickled as its text.

    Raises
    ------
    ValueError
        The text is no formula, an unknown name, an undefined number, or a formula that is too large.
    TypeError
        An argument of the wrong type.

    Examples
    --------
    >>> formula("(x1 + x2)^2/2", dim=3)
    (1/2)*x1^2 + x1*x2 + (1/2)*x2^2
    >>> H = formula("a*m1^2/2 + cos(m2)", basis=("m1", "m2", "m3"), parameters={"a": 3.0})
    >>> H.value([2.0, 0.0, 1.0])
    7.0
    """
    if not isinstance(text, str):
        raise TypeError(f"the formula is {short(text)}; give a text such as 'x1^2/2 + cos(x2)'")
    count = read_dimension(text, dim, basis)
    names = coordinate_names(count) if basis is None else tuple(basis)
    try:
        return Polynomial(text, dim, basis, parameters)
    except NotPolynomial:
        return Hamiltonian(ParsedFunction(text, count, names, parameters)).bind(count)


def formula_in(
    text: str, dim: int, names: Sequence[str] | None, parameters: Mapping[str, Any] | None = None
) -> Polynomial | Hamiltonian:
    """Return the function of a formula in the coordinates of these names, or x1, x2, ... where these are no others."""
    written = names_in(text, dim, names)
    try:
        return parse_polynomial(text, dim, written, parameters)
    except NotPolynomial:
        return Hamiltonian(ParsedFunction(text, dim, written, parameters)).bind(dim)


def formula_of(H: Any) -> tuple[ParsedFunction, tuple[Coefficient, ...]] | None:
    """Return the formula of a Hamiltonian and the factors that multiply it, in their order; None if it has none."""
    function, multiples = without_multiples(getattr(H, "_value", None))
    return (function, tuple(one.factor for one in multiples)) if isinstance(function, ParsedFunction) else None


def as_hamiltonian(H: Any, n: int, owner: str = "the system", names: Sequence[str] | None = None) -> HamiltonianLike:
    """Convert `H` of any accepted type to a Hamiltonian bound to dimension `n`; `owner` names its owner in messages."""
    if isinstance(H, str):
        try:
            H = formula_in(H, n, names)
        except ValueError as reason:
            raise ValueError(f"the Hamiltonian {reason}") from None
    elif names is not None:
        check_names(H, names, "the Hamiltonian")
    if isinstance(H, Polynomial):
        check_variables(H, n, owner)
        if H.degree > 2:
            return PolynomialHamiltonian(H)
        if len(H.monomials) > MAX_CACHED_MONOMIALS:
            return Quadratic.from_polynomial(H)
        return _quadratic(H, (H._written_names, *map(type, H.monomials.values())))
    # A Quadratic is one, and the test of a protocol takes much of the time to make a small system.
    is_class = isinstance(H, type)
    if is_class or not (type(H) is Quadratic or isinstance(H, HamiltonianLike)):
        missing = [name for name in REQUIRED_ATTRIBUTES if not hasattr(H, name)]
        if is_plain_function(H):
            if is_of_torch(H):
                raise TypeError("the Hamiltonian is a module of PyTorch; give co.torch.energy(module)")
            return Hamiltonian(H).bind(n)
        what = f"the class {H.__name__}" if is_class else f"a {type(H).__name__}"
        is_incomplete = not is_class and 0 < len(missing) < len(REQUIRED_ATTRIBUTES) - 1
        hint = f" (as a user-defined Hamiltonian it lacks {', '.join(missing)})" if is_incomplete else ""
        raise TypeError(
            f"the Hamiltonian is {what}; give a Quadratic, Polynomial, Separable, SplitHamiltonian or Hamiltonian, "
            f"a function of x, or the text of a formula{hint}"
        )
    if isinstance(H, Quadratic):
        H.check_dimension(n, owner)
    bound = H.bind(n)
    if is_user_defined(H):
        check_user_hamiltonian(bound, n)
    return bound


def is_plain_function(H: Any) -> bool:
    """Return whether it is a function of the state, not a Hamiltonian of any type, complete or not."""
    return callable(H) and not isinstance(H, type) and not any(hasattr(H, name) for name in REQUIRED_ATTRIBUTES)
