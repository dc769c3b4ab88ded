"""Modified Hamiltonians of splittings: power series in the step, or values at points for functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials, SymbolicPolynomial
from coadjoint.algebra.polynomials.monomials import Exponents, factors_of, readable, readable_latex
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import unknown_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.optional_packages import require_packages
from coadjoint.program.logarithms import Coordinates, exact_sweeps
from coadjoint.program.modified_series import coordinates_of, modified_terms
from coadjoint.program.parts.part_polynomials import parts_at
from coadjoint.program.sweeps import Sweep
from coadjoint.program.table import FlowTable
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.hamiltonians.sum_of_hamiltonians import polynomial_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_one_system
from coadjoint.validation import (
    check_power,
    read_finite,
    read_integer,
    read_list,
    read_number,
    supports_arithmetic,
    to_array,
)

MAX_POWER = 12
"""Largest power of h: above it, the words in the free algebra alone take minutes."""

Term = Polynomial | SymbolicPolynomial


class ErrorTerm(NamedTuple):
    """The leading error term h^power * term of a scheme; no power if H has a single part, whose flow is a step."""

    power: int | None
    term: Term


@dataclass(frozen=True, eq=False)
class SchemeTerms:
    """Terms of the sweeps of a kernel and its processor `after`; `names`: exponents -> symbol (twice a square's)."""

    system: LiePoissonSystem
    flow_table: FlowTable
    sweeps: list[Sweep]
    after: list[Sweep]
    order: int
    polynomial: Polynomial
    names: Mapping[Exponents, str]

    def kernel(self) -> SchemeTerms:
        return replace(self, after=[])

    def below(self, order: int) -> tuple[dict[int, Term], float, float]:
        """Return the terms below h^order by power, their radius, and the bound on neglected coefficients."""
        terms, radius, neglected = self._terms(self._coordinates(order), range(2, order + 1))
        return {0: in_coordinates_of(self.system, self._hamiltonian()), **terms}, radius, neglected

    def error_term(self) -> ErrorTerm:
        """Return the term at the first power above h^0 that is non-zero for general systems."""
        zero = self._with_symbols(Polynomial({}, dim=self.polynomial.dim + len(self.names)))
        if len(self.flow_table.parts) > 1 or np.any(self.flow_table.frequency != 0):
            for highest in range(min(self.order + 1, MAX_POWER + 1), MAX_POWER + 2):
                coordinates = self._coordinates(highest)
                weight = coordinates.leading
                if weight is not None:
                    terms, _, _ = self._terms(coordinates, [weight])
                    return ErrorTerm(weight - 1, terms.get(weight - 1, zero))
        return ErrorTerm(None, zero)

    def _coordinates(self, highest: int) -> Coordinates:
        return coordinates_of(self.flow_table, self.sweeps, self.after, highest, self.order)

    def _terms(self, coordinates: Coordinates, weights: Iterable[int]) -> tuple[dict[int, Term], float, float]:
        ring = ExactPolynomials(self.system.algebra, tuple(self.values))
        # The polynomials in symbols that represent the coefficients.
        factors = {e: ring.symbol_elements[name] / _divisor(e) for e, name in self.names.items()}
        of_power, radius, neglected = modified_terms(
            ring, self.system, self.flow_table, coordinates, weights, self.polynomial, factors
        )
        terms = {power: in_coordinates_of(self.system, self._with_symbols(term)) for power, term in of_power.items()}
        return terms, radius, neglected

    @property
    def values(self) -> dict[str, Any]:
        return {name: self.polynomial.monomials[e] * _divisor(e) for e, name in self.names.items()}

    def _hamiltonian(self) -> Term:
        positions = {e: k for k, e in enumerate(self.names)}
        monomials: dict[Exponents, Any] = {}
        for e, value in self.polynomial.monomials.items():
            symbol_exponents = [0] * len(positions)
            if e in positions:
                symbol_exponents[positions[e]] = 1
                value = Fraction(1, _divisor(e)) if _divisor(e) > 1 else 1
            monomials[(*e, *symbol_exponents)] = value
        return self._with_symbols(Polynomial(monomials, dim=self.polynomial.dim + len(positions)))

    def _with_symbols(self, polynomial: Polynomial) -> Term:
        return SymbolicPolynomial(polynomial, tuple(self.names.values())) if self.names else polynomial


def symbols_of(H: Polynomial, requested: Any, flow_table: FlowTable) -> dict[Exponents, str]:
    """Return the names of all coefficients of a Hamiltonian (True), or the given ones, by exponents."""
    if flow_table.shift:
        raise ValueError(
            f"a multiple of the Casimir {flow_table.shift[0][0]!r} was subtracted from H, with a factor that depends "
            'on its coefficients; for symbols use parts="coordinates"'
        )
    names = names_of(H)
    if requested is not True:
        chosen = read_list(requested, "symbols", "give True, or names such as 'm1'")
        for name in chosen:
            if name not in names.values():
                raise unknown_name("symbol", name, list(names.values()))
        names = {e: name for e, name in names.items() if name in chosen}
    return names


def names_of(H: Polynomial) -> dict[Exponents, str]:
    """Return the names of the coefficients of a Hamiltonian, by the exponents of their monomials."""
    between = "_" if H.dim >= 10 else ""
    names = {}
    for exponents in H.monomials:
        if not any(exponents):
            continue
        factors = [str(i + 1) for i in factors_of(exponents)]
        kind = {1: "b", 2: "m"}.get(len(factors), "c")
        if len(factors) == 2 and factors[0] == factors[1]:
            factors = factors[:1]
        names[exponents] = kind + between.join(factors)
    return names


def _divisor(exponents: Exponents) -> int:
    """Return 2 for squares: m1 x1^2 / 2."""
    return 2 if sum(exponents) == 2 and 2 in exponents else 1


class ModifiedHamiltonian:
    """The function H + h^2 H2 + ... that a splitting preserves: a step is its flow over h, up to O(h^(order + 1)).

    `modified_hamiltonian` creates it. Call it as ``H(x, h)``, with h negative for backward runs. Along a run its value
    is constant to O(h^order).

    Attributes
    ----------
    terms : mapping of int to Polynomial
        Power of h -> its non-zero coefficient function; a `SymbolicPolynomial` if symbols were requested. Coefficients
        are fractions if those of the scheme are rational, else floats.
    order : int
        The terms are those below h^order.
    radius : float
        The largest relative error of a coefficient before rounding to float64; 0 if all are exact.
    neglected : float
        Bound on the coefficients that are set to zero, within the rounding of the scheme's coefficients.
    values : mapping of str to number
        Name of a symbol -> the coefficient of H that it represents; empty without symbols.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    >>> H = co.modified_hamiltonian(body, co.Splitting(parts="coordinates"), order=4)
    >>> H
    0.5*x1^2 + 0.25*x2^2 + 0.125*x3^2 + h^2*(-(1/384)*x1^2*x2^2 - (1/384)*x1^2*x3^2 + (1/192)*x2^2*x3^2)
    >>> H([1.0, 2.0, 3.0], 0.0), H.gradient([[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]], 0.1).shape
    (2.625, (2, 3))
    """

    def __init__(
        self,
        terms: Mapping[int, Term],
        order: int,
        *,
        radius: float = 0.0,
        neglected: float = 0.0,
        values: Mapping[str, Any] | None = None,
        source: SchemeTerms | None = None,
    ) -> None:
        self.terms: Mapping[int, Term] = MappingProxyType(dict(terms))
        self.order, self.radius, self.neglected = order, radius, neglected
        self.values: Mapping[str, Any] = MappingProxyType(dict(values or {}))
        self._source = source

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self.terms[0].dim

    @cached_property
    def error_term(self) -> ErrorTerm:
        """The leading term of the scheme, at the power of its order, even if that is not below `order`."""
        return self._scheme_terms().error_term()

    @cached_property
    def kernel(self) -> ModifiedHamiltonian:
        """The modified Hamiltonian of the kernel K of a processed scheme P K P^-1; unchanged for other schemes."""
        return _from_terms(self._scheme_terms().kernel(), self.order)

    def _scheme_terms(self) -> SchemeTerms:
        if self._source is None:
            raise TypeError("a modified Hamiltonian with values for its symbols has no scheme; use the symbolic one")
        return self._source

    def _numeric(self) -> Mapping[int, Polynomial]:
        if self.values:
            raise TypeError(f"the modified Hamiltonian has the symbols {', '.join(self.values)}; use with_values()")
        return self.terms  # type: ignore[return-value]

    def __call__(self, x: Any, h: Any) -> Any:
        """Return the values at states.

        Parameters
        ----------
        x : array_like, shape (n,), (k, n) or (k, members, n)
            States: floats, or objects such as ``mpmath.mpf`` and fractions, in whose arithmetic it is evaluated.
        h : number
            Step, negative for backward.

        Returns
        -------
        float or ndarray
            One value for each state.
        """
        states = to_array(x, "x", "iufc")
        return self._sum(lambda term: term(states), _read_step(h))

    def gradient(self, x: Any, h: Any) -> NDArray[Any]:
        """Return the gradients at states, in the shape of x; parameters as for a call."""
        states = to_array(x, "x", "iufc")
        return self._sum(lambda term: term.gradient(states), _read_step(h))

    def _sum(self, evaluate: Callable[[Polynomial], Any], h: Any) -> Any:
        terms = self._numeric()
        total: Any = 0  # small terms are added first
        try:
            for k in sorted(terms, reverse=True):
                total = total + h**k * evaluate(terms[k]) if k else total + evaluate(terms[k])
        except OverflowError:
            raise ValueError(
                f"the terms of the modified Hamiltonian at h = {short(h)} leave the range of float64 there"
            ) from None
        except TypeError:
            raise TypeError(
                f"h is {short(h)}, a {type(h).__name__}, which the numbers of x cannot be multiplied by; "
                "give both as the same type"
            ) from None
        return total

    def with_values(self, values: Mapping[str, Any] | None = None) -> ModifiedHamiltonian:
        """Return the function with numbers in place of the symbols.

        Parameters
        ----------
        values : mapping, optional
            Name -> number. Other symbols take the coefficients of the system's H.

        Returns
        -------
        ModifiedHamiltonian
        """
        if not isinstance(values, Mapping | None):
            raise TypeError(f"values is {short(values)}; it must map names of symbols to numbers")
        unknown = [name for name in values or {} if name not in self.values]
        if unknown:
            known = f"the symbols are {', '.join(self.values)}" if self.values else "there are no symbols"
            raise ValueError(f"values has {short(unknown[0])}; {known}")
        numbers = {**self.values, **(values or {})}
        # With symbols, all terms are symbolic.
        terms: Any = (
            {k: term.with_values(numbers) for k, term in cast(Any, self.terms).items()} if numbers else self.terms
        )
        return ModifiedHamiltonian(terms, self.order, radius=self.radius, neglected=self.neglected)

    def __repr__(self) -> str:
        return self._format(repr, lambda term: readable(term.monomials, term.names), "*")

    def to_latex(self) -> str:
        """Return the function as LaTeX without dollar signs, with all digits."""
        return self._format(lambda term: term.to_latex(), lambda term: term.to_latex(), r"\,", "h^{{{0}}}")

    def _repr_latex_(self) -> str:
        def numeric(term: Polynomial) -> str:
            return readable_latex(term.monomials, term.names)

        text = self._format(lambda term: term.to_latex(), numeric, r"\,", "h^{{{0}}}")
        return f"${text}$"

    def to_sympy(self) -> Any:
        """Return the function as a SymPy expression in h, the coordinates and the symbols; fractions stay exact."""
        require_packages("an expression of SymPy", "sympy")
        import sympy

        h = sympy.Symbol("h")
        return sum((h**k * term.to_sympy() for k, term in self.terms.items()), sympy.Integer(0))

    def _format(self, symbolic: Any, numeric: Any, times: str, power: str = "h^{0}") -> str:
        text = ""
        for k, term in self.terms.items():
            coefficient = symbolic(term) if self.values else numeric(term)
            step = "h" if k == 1 else power.format(k)
            text += f" + {step}{times}({coefficient})" if k else coefficient
        return text


def _read_step(h: Any) -> Any:
    if isinstance(h, bool) or not supports_arithmetic(h) or np.ndim(h):
        raise TypeError(f"the step h is {short(h)}; it must be a number")
    return h


@suggest_keywords
@long_operation("modified_hamiltonian")
def modified_hamiltonian(
    system: System, method: Method | str | Mapping[str, Any], order: int = 4, *, symbols: Any = False
) -> ModifiedHamiltonian | ModifiedEnergyAtPoints:
    """Return the modified Hamiltonian of a splitting or a composition: the terms below h^order.

    A step is the flow over h of H + h^2 H2 + h^4 H4 + ... (asymptotic in h). Choose it for the energy that a run
    preserves, and to compare schemes of the same order by their leading terms. A scheme that is no splitting has a
    `modified_field` instead.

    Parameters
    ----------
    system : LiePoissonSystem
        The system. Its Hamiltonian splits and does not depend on time.
    method : Method, str or mapping
        `Splitting` of any order, scheme and parts, a `Composition` of them, or a flow method of your own; or its name
        as in `integrate`.
    order : int
        From 1 to 12. Order 2 is H for a scheme of order 2, order 4 is H + h^2 H2, and so on.
    symbols : bool or sequence of str
        Coefficients of H that become symbols: m1 is the factor of x1^2/2, m12 that of x1 x2, b1 that of x1, c113 that
        of x1^2 x3 (from dimension 10 on m1_2 and so on). True for all of them, or a list of names. The coordinates
        are then called x1, x2, ..., also where the system has other names for them.

    Returns
    -------
    ModifiedHamiltonian
        Exact if the coefficients of the scheme are rational; floats in H are converted to rationals exactly. If H is
        not a polynomial, a `ModifiedEnergyAtPoints`, which can only be evaluated.

    Raises
    ------
    TypeError
        The scheme is not made of flows, or the system has no Lie algebra.
    ValueError
        The Hamiltonian depends on time or does not split; symbols were requested, but a Casimir was subtracted from H,
        squares were completed, or H is not a polynomial; or the terms are too large for this machine.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, 1993, section 6, by the
    Baker-Campbell-Hausdorff formula.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    >>> H = co.modified_hamiltonian(body, co.Splitting(parts="coordinates"), order=4)
    >>> H.terms[2]
    -(1/384)*x1^2*x2^2 - (1/384)*x1^2*x3^2 + (1/192)*x2^2*x3^2
    >>> run = co.integrate(body, (1.0, 2.0, 0.5), (0, 10), 0.1, co.Splitting(parts="coordinates"))
    >>> values = H(run.x, 0.1)
    >>> float(max(abs(values - values[0])) / run.drift()["energy"]) < 0.01
    True
    """
    system, scheme = check_system_and_scheme(system, method)
    order = read_integer(
        order, "order", 1, MAX_POWER, reason="the words in the free algebra double in number with each power"
    )
    try:
        flow_table = scheme.flow_table(system)
    except TypeError as reason:
        raise TypeError(f"{reason}, or take co.modified_field(system, method)") from None
    if system.hamiltonian.timed:
        raise ValueError(
            f"the Hamiltonian of {system.name} depends on time, so no function of x is conserved; "
            "a modified Hamiltonian needs an autonomous system"
        )
    sweeps, after = exact_sweeps(cast(FlowMethod, scheme.expanded))
    H = polynomial_of(system.hamiltonian)
    if H is None:
        if symbols is not False:
            raise ValueError(f"the Hamiltonian of {system.name} is not a polynomial; symbols need a polynomial one")
        if np.any(flow_table.frequency != 0):
            raise ValueError(
                f"the Hamiltonian of {system.name} is not a polynomial, and rational rotations are flows of unknown "
                'integrals of it; use rotation="exact"'
            )
        coordinates = coordinates_of(flow_table, sweeps, after, order, scheme.order)
        return ModifiedEnergyAtPoints(system, flow_table, coordinates, order)
    names = symbols_of(H, symbols, flow_table) if symbols is not False else {}
    return _from_terms(SchemeTerms(system, flow_table, sweeps, after, scheme.order, H, names), order)


def _from_terms(source: SchemeTerms, order: int) -> ModifiedHamiltonian:
    terms, radius, neglected = source.below(order)
    return ModifiedHamiltonian(terms, order, radius=radius, neglected=neglected, values=source.values, source=source)


def check_system_and_scheme(
    system: System, method: Any, what: str = "a modified Hamiltonian"
) -> tuple[LiePoissonSystem, Method]:
    """Validate system and scheme: one system on a Lie algebra, and a scheme."""
    scheme = read_method(method)
    if not isinstance(system, LiePoissonSystem):
        raise TypeError(f"the system is {short(system)}; {what} is for one LiePoissonSystem")
    check_one_system(system)
    return system, scheme


class ModifiedEnergyAtPoints:
    """The function H + h^2 H2 + ... of a Hamiltonian with Python functions, evaluated pointwise.

    At each point the parts are expanded in Taylor polynomials with exact brackets. Derivatives up to the second are
    those of the Hamiltonian, so H + h^2 H2 of a symmetric scheme has their accuracy. Higher derivatives come from
    values on circles in the complex plane, with about ten digits; fewer than six raise an error. A point takes
    milliseconds at order 4, and a second at order 6 in six dimensions. `modified_hamiltonian` creates it.

    Attributes
    ----------
    order : int
        The terms are those below h^order.

    Examples
    --------
    >>> import coadjoint as co
    >>> wave = (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))
    >>> H = co.Separable({0: wave, 1: wave, 2: wave})
    >>> system = co.LiePoissonSystem(co.algebras.so(3), H)
    >>> modified = co.modified_hamiltonian(system, co.Splitting(), order=4)
    >>> y = co.stepper(system, co.Splitting(), 0.1)([1.0, 0.5, 0.2])
    >>> x = [1.0, 0.5, 0.2]
    >>> abs(modified(y, 0.1) - modified(x, 0.1)) < 0.05 * abs(system.energy(y) - system.energy(x))
    True
    """

    def __init__(self, system: LiePoissonSystem, flow_table: FlowTable, coordinates: Coordinates, order: int) -> None:
        self.order = order
        self._system, self._program, self._coordinates = system, flow_table, coordinates
        self._weights = [w for w in range(2, order + 1) if coordinates.of_weight[w]]

    @property
    def dim(self) -> int:
        return self._system.dim

    def __call__(self, x: Any, h: Any) -> Any:
        """Return the values at states.

        Parameters
        ----------
        x : array_like, shape (n,), (k, n) or (k, members, n)
            States.
        h : float
            Step, negative for backward.

        Returns
        -------
        float or ndarray
            One value for each state.
        """
        states, step = read_finite(x, "x"), read_number(h, "h")
        if states.ndim == 0 or states.shape[-1] != self.dim:
            raise ValueError(f"x has the shape {states.shape}; it must be (..., {self.dim})")
        check_power(step, self.order, "h")
        check_power(float(np.max(np.abs(states), initial=0.0)), 2 * self.order, "the largest entry of x")
        values = np.array([self._at(point, step) for point in states.reshape(-1, self.dim)])
        return values.reshape(states.shape[:-1]) if states.ndim > 1 else float(values[0])

    def __repr__(self) -> str:
        return f"<modified Hamiltonian of {self._system.name}, of order {self.order}, evaluated point by point>"

    def _at(self, x: NDArray[np.float64], h: float) -> float:
        total = 0.0
        if self._weights:
            degree = self._weights[-1] - 1
            ring = ExactPolynomials(self._system.algebra, point=x.tolist(), degree=degree)
            flow_table = replace(self._program, parts=parts_at(self._program.parts, x, degree))
            terms, _, _ = modified_terms(ring, self._system, flow_table, self._coordinates, self._weights)
            for power in reversed(terms):
                total += h**power * float(terms[power].monomials.get((0,) * self.dim, 0))
        return total + float(self._system.energy(x))
