"""Modified fields with polynomial terms, from exact power series."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.exact_polynomials import Exact
from coadjoint.algebra.polynomials.monomials import ProductSum
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import readable_latex
from coadjoint.analysis.backward_error.field_of_step import Field, size_of
from coadjoint.analysis.backward_error.modified_field_base import Floats, ModifiedField
from coadjoint.analysis.backward_error.polynomial_fields import Matrix, bracket_change, hamiltonian_of, skew_factor
from coadjoint.analysis.backward_error.step_series import ExactSystem
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.validation import read_number


class ExactField(ModifiedField):
    """A modified field with polynomial terms.

    Attributes
    ----------
    known_to : float
        Relative error of the scheme's coefficients. Even if they are rounded, each term preserves the invariants of the
        scheme exactly. Terms below its order that are within that rounding are set to zero.
    """

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
        if isinstance(function, Polynomial):
            return self._exact_system.ring.from_polynomial(function)
        try:
            return self._exact_system.value_of(as_hamiltonian(function, self.system.dim).value)
        except (TypeError, AttributeError, ArithmeticError) as reason:
            raise TypeError(
                f"{short(invariant)} is not a polynomial; an exact field can test polynomials only"
            ) from reason

    def _changes(self, F: Exact) -> dict[int, Exact]:
        """Return the non-zero derivatives of a polynomial along the terms, by power."""
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
