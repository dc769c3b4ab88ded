"""Modified vector field of a scheme: a power series in the step with polynomial terms, or values at points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.exact_polynomials import Exact
from coadjoint.algebra.polynomials.monomials import ProductSum, readable_latex
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.analysis.backward_error.field_at_points import Floats, ModifiedField
from coadjoint.analysis.backward_error.step_series import (
    ExactSystem,
    Field,
    Matrix,
    bracket_change,
    check_at_a_point,
    field_of_series,
    hamiltonian_of,
    scale_of_motion,
    size_of,
    skew_factor,
)
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.memory import InsufficientMemoryError
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.step_method import read_step
from coadjoint.optional_packages import require_packages
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import check_vector_states
from coadjoint.validation import read_choice, read_integer, read_number

MAX_ORDER = 64
MARGIN = 1000  # below the order of a scheme, terms within this many roundings of its coefficients are set to zero
WAYS = ("auto", "exact", "numerical")


@suggest_keywords
@long_operation("modified_field")
def modified_field(system: System, method: Any, order: int, *, way: str = "auto") -> ModifiedField:
    """Return the field X = f_0 + h f_1 + h^2 f_2 + ... whose flow over a time h is the step of a scheme (Lemma 6.1).

    A scheme of order p solves x' = X(x, h) far more accurately than x' = f(x): f_0 = f, f_1 = ... = f_(p-1) = 0, and
    f_p is its leading error. A scheme preserves an invariant if every f_k does; otherwise the first f_k that does not
    gives the power of h at which the invariant changes. Choose it to analyse a scheme on your own system. For
    splittings `coadjoint.modified_hamiltonian` gives more detail.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system; its Hamiltonian does not depend on time.
    method : Method, str, mapping or callable
        The scheme, its name as in `integrate`, or a step of your own as a function ``step(x, h)``.
    order : int
        The terms f_k h^k with k < order are computed.
    way : {"auto", "exact", "numerical"}
        ``"exact"``: polynomials with rational coefficients, from the step evaluated in power series. It supports
        Runge-Kutta, modified and splitting schemes, Taylor series, compositions of these, and steps of your own made of
        sums, products and quotients, on systems with a polynomial field. ``"numerical"``: the terms are computed
        pointwise from steps in multiprecision, for any step that accepts mpmath numbers. ``"auto"``: exact if possible;
        otherwise ``reason`` of the field gives the obstacle.

    Returns
    -------
    ModifiedField

    Raises
    ------
    TypeError, ValueError
        The Hamiltonian depends on time, the scheme does not apply to the system, or neither way is possible.

    References
    ----------
    S. Reich 1993, section 6, Lemma 6.1.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 1/2, 1/4]), sign=-1)
    >>> field = co.modified_field(body, co.GaussLegendre(1), order=4)
    >>> field.terms[2][0]
    (1/128)*x1^2*x2*x3 - (1/384)*x2^3*x3 + (1/256)*x2*x3^3
    >>> field.keeps("energy"), field.keeps("|x|^2"), field.first_error
    (None, None, 2)
    """
    require_packages("a modified field", "mpmath")
    check_vector_states(system, "a modified field is available for states that are vectors")
    order = read_integer(order, "order of a modified field", 1, MAX_ORDER)
    read_choice(way, "way to a modified field", WAYS)
    if system.hamiltonian.timed:
        raise ValueError(
            f"the Hamiltonian of {system.name} depends on time; a modified field needs an autonomous system"
        )
    method = read_step(method, order)
    method.properties(system)
    reason = 'way="numerical" was given'
    if way != "numerical":
        try:
            return _exact(system, method, order)
        except MemoryError as error:
            if type(error) is not InsufficientMemoryError:
                raise
            obstacle: Exception = error
        except Exception as error:  # user functions may raise anything on formal numbers
            obstacle = error
        if way == "exact":
            raise TypeError(f"no exact modified field: {obstacle}") from obstacle
        reason = str(obstacle)
    field = ModifiedField(system, method, order, reason)
    field.check_steps()
    return field


def _exact(system: System, method: Method, order: int) -> ExactField:
    exact, known_to = ExactSystem(system), method.known_to
    exact.check_available_memory(order)
    series = exact.series_of(lambda x, h: method.formal_step(system, x, h), order)
    check_at_a_point(lambda x, h: method.step(system, x, 0 * h, h), exact, series, known_to)
    fields = field_of_series(exact.ring, series)
    difference = max(size_of(a - b) for a, b in zip(fields[0], exact.field, strict=True))
    if 0.0 < difference <= MARGIN * max(known_to, UNIT_ROUNDOFF) * max(map(size_of, exact.field)):
        # The decomposition of a full M into squares is rounded as well.
        known_to, fields[0] = max(known_to, UNIT_ROUNDOFF), exact.field
    if known_to:
        # Substeps back and forth move further than their sum.
        reach = 2.0 * float(np.sum(np.abs(method.fractions)))
        for k, scale in enumerate(scale_of_motion(exact, min(order, method.order))[1:], 1):
            if max(map(size_of, fields[k])) <= MARGIN * known_to * reach**k * scale:
                fields[k] = [exact.ring.zero] * system.dim
    return ExactField(system, method, order, exact, fields, known_to)


class ExactField(ModifiedField):
    """A modified field with polynomial terms; `known_to` is the relative error of the scheme's coefficients."""

    # Even of rounded coefficients, each term preserves the invariants of the scheme exactly.

    def __init__(
        self,
        system: System,
        method: Any,
        order: int,
        exact_system: ExactSystem,
        fields: list[Field],
        known_to: float,
    ) -> None:
        super().__init__(system, method, order, "")
        self._exact_system, self._fields, self.known_to = exact_system, fields, known_to

    @cached_property
    def terms(self) -> Mapping[int, tuple[Polynomial, ...]]:
        """Power k -> the n polynomials of f_k."""
        polynomial = self._exact_system.polynomial
        return MappingProxyType({k: tuple(map(polynomial, f)) for k, f in enumerate(self._fields)})

    @cached_property
    def _table(self) -> ProductSum:
        return Polynomial.side_by_side([F for term in self.terms.values() for F in term])

    def _values(self, x: Floats) -> npt.NDArray[np.float64]:
        return self._table.along(x).reshape(len(x), self.order, -1).transpose(1, 0, 2)

    @property
    def first_error(self) -> int | None:
        exact = [self._exact_system.field, *[[self._exact_system.ring.zero] * self.system.dim] * (self.order - 1)]
        return next((k for k, (f, g) in enumerate(zip(self._fields, exact, strict=True)) if f != g), None)

    def rate(self, invariant: Any) -> dict[int, Polynomial]:
        """Return the rate of change of a function F: the non-zero grad F . f_k, by power of h.

        Parameters
        ----------
        invariant : str, Polynomial or Quadratic
            "energy", the name of a Casimir, or a polynomial.

        Returns
        -------
        dict
            Power -> Polynomial.
        """
        return {k: self._exact_system.polynomial(F) for k, F in self._changes(self._polynomial(invariant)).items()}

    def keeps(self, invariant: Any) -> int | None:
        return next(iter(self._changes(self._polynomial(invariant))), None)

    def _polynomial(self, invariant: Any) -> Exact:
        function = self._invariant(invariant)
        try:
            return self._exact_system.invariant(function)
        except (TypeError, AttributeError, ArithmeticError) as reason:
            raise TypeError(
                f"{short(invariant)} is not a polynomial; an exact field can test polynomials only"
            ) from reason

    def _changes(self, F: Exact) -> dict[int, Exact]:
        changes = {k: self._exact_system.ring.along(field, F) for k, field in enumerate(self._fields)}
        return {k: change for k, change in changes.items() if change != 0}

    def _loss(self, k: int) -> str:
        change = self._changes(self._exact_system.energy)[k]
        return f"grad H . f has a coefficient of {size_of(change):.3g}"

    @cached_property
    def skew_terms(self) -> Mapping[int, tuple[tuple[Polynomial, ...], ...]]:
        """Power k -> the skew matrix K_k of polynomials with f_k = sign K_k grad H, K_0 = J, for a quadratic H.

        Raises
        ------
        ValueError
            The scheme does not preserve the energy (the message gives the power of h and the size), or H is not
            quadratic.
        """
        self._check_energy()
        ring, sign, terms = self._exact_system.ring, self.system.sign, {}
        for k, field in enumerate(self._fields):
            K: Matrix = self._exact_system.structure
            if k:
                K = skew_factor(ring, self._exact_system.energy, [sign * f for f in field])
            terms[k] = tuple(tuple(map(self._exact_system.polynomial, row)) for row in K)
        return MappingProxyType(terms)

    @cached_property
    def _skew_table(self) -> ProductSum:
        return Polynomial.side_by_side([F for K in self.skew_terms.values() for row in K for F in row])

    @suggest_keywords
    @ignore_overflow
    def skew_matrix(self, x: npt.ArrayLike, h: float) -> Floats:
        if self._exact_system.energy.total_degree() > 2:
            return super().skew_matrix(x, h)
        states, shape = self._read_states(x)
        n, step = self.system.dim, read_number(h, "h")
        values = self._skew_table.along(states).reshape(len(states), self.order, n, n)
        return np.einsum("mkij,k->mij", values, step ** np.arange(self.order)).reshape(*shape, n)

    @cached_property
    def poisson_defects(self) -> Mapping[int, float]:
        """Power k -> the largest coefficient of the Lie derivative L_f J of the bracket along f = f_k, if not zero.

        If the mapping is empty, the scheme is a Poisson map to this order.
        """
        ring, J = self._exact_system.ring, self._exact_system.structure
        sizes = {k: bracket_change(ring, J, field) for k, field in enumerate(self._fields)}
        return MappingProxyType({k: size for k, size in sizes.items() if size})

    @cached_property
    def hamiltonians(self) -> Mapping[int, Polynomial]:
        """Power k -> the H_k with f_k = sign J grad H_k, of a scheme that is a Poisson map; unique up to Casimirs.

        Raises
        ------
        ValueError
            The scheme is not a Poisson map (the message gives the power of h and the size), or the field is Poisson but
            not Hamiltonian: it moves a Casimir, or has no polynomial Hamiltonian.
        """
        for k, size in self.poisson_defects.items():
            raise ValueError(
                f"{self.method} is not a Poisson map on {self.system.name}: at h^{k} the change of the bracket along "
                f"its field has a coefficient of {size:.3g}"
            )
        for name, C in self._exact_system.casimirs.items():
            for k, change in self._changes(C).items():
                raise ValueError(
                    f"the field of {self.method} on {self.system.name} is not Hamiltonian: at h^{k} it moves {name}, "
                    f"with a coefficient of {size_of(change):.3g}"
                )
        ring, sign, terms = self._exact_system.ring, self.system.sign, {0: self._exact_system.energy}
        for k, field in enumerate(self._fields[1:], 1):
            H = hamiltonian_of(ring, self._exact_system.structure, [sign * f for f in field])
            if H is None:
                raise ValueError(
                    f"the term f_{k} of {self.method} on {self.system.name} is Poisson, but has no polynomial "
                    "Hamiltonian"
                )
            terms[k] = H
        return MappingProxyType({k: self._exact_system.polynomial(H) for k, H in terms.items()})

    def to_latex(self) -> str:
        """Return the non-zero terms as lines of LaTeX ``f_{k} = ...``, transposed, with all digits."""
        return self._lines(Polynomial.to_latex)

    def _repr_latex_(self) -> str:
        return f"$${self._lines(lambda F: readable_latex(F.monomials, F.names))}$$"

    def _lines(self, to_text: Callable[[Polynomial], str]) -> str:
        lines = [
            rf"f_{{{k}}} = \left({', '.join(map(to_text, term))}\right)^T"
            for k, term in self.terms.items()
            if any(F.monomials for F in term)
        ]
        return " \\\\\n".join(lines)
