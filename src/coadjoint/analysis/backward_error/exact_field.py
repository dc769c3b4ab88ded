"""Modified fields with polynomial terms, from exact power series."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import ProductSum, exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import readable_latex
from coadjoint.analysis.backward_error.modified_field_base import Floats, ModifiedField
from coadjoint.analysis.backward_error.step_series import ExactSystem, Field, size_of
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System
from coadjoint.validation import read_number

Matrix = list[list[Exact]]
BYTES_PER_ENTRY = 40  # of a matrix of fractions during its reduction


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


def bracket_change(ring: ExactPolynomials, J: list[Field], field: Field) -> float:
    """Return the largest coefficient of the Lie derivative L_f J of the bracket along a field; 0 for Poisson fields."""
    # (L_f J)_ij = f . grad J_ij - sum_l (d f_i / d x_l) J_lj - sum_l J_il (d f_j / d x_l).
    slopes = [ring.gradient(f) for f in field]
    largest = 0.0
    for i in range(ring.dim):
        for j in range(i):
            change = ring.along(field, J[i][j])
            for m in range(ring.dim):
                change -= slopes[i][m] * J[m][j] + J[i][m] * slopes[j][m]
            largest = max(largest, size_of(change))
    return largest


def hamiltonian_of(ring: ExactPolynomials, J: list[Field], field: Field) -> Exact | None:
    """Return a polynomial H with J grad H = field, or None; all non-zero entries of J have one degree."""
    # H is unique up to Casimirs; undetermined coefficients are zero.
    degree_of_J = _degree(J)
    total = ring.zero
    parts = [_by_degree(ring, f, ring.dim) for f in field]
    for degree in sorted(set().union(*parts)):
        part = [terms.get(degree, ring.zero) for terms in parts]
        H = _hamiltonian_of_degree(ring, J, part, degree + 1 - degree_of_J) if degree + 1 > degree_of_J else None
        if H is None:
            return None
        total += H
    return total


def _degree(J: list[Field]) -> int:
    degrees = {sum(map(int, e[: len(J)])) for row in J for entry in row for e in entry.monoms()}
    if len(degrees) > 1:
        raise ValueError(f"the entries of J have the degrees {sorted(degrees)}; a Hamiltonian needs one common degree")
    return degrees.pop() if degrees else 0


def _hamiltonian_of_degree(ring: ExactPolynomials, J: list[Field], field: Field, degree: int) -> Exact | None:
    """Solve J grad H = field for the coefficients of a homogeneous polynomial H; None if there is no solution."""
    from flint import fmpq, fmpq_mat

    columns = [
        ring.monomial(exponents_of(factors, ring.dim))
        for factors in combinations_with_replacement(range(ring.dim), degree)
    ]
    entries: dict[tuple[int, Any], dict[int, Any]] = {}
    for c, monomial in enumerate(columns):
        slope = ring.gradient(monomial)
        for i in range(ring.dim):
            image = sum((J[i][j] * slope[j] for j in range(ring.dim) if slope[j] != 0 and J[i][j] != 0), ring.zero)
            for exponents, value in image.to_dict().items():
                entries.setdefault((i, exponents), {})[c] = value
    size = len(columns)
    for i, f in enumerate(field):
        for exponents, value in f.to_dict().items():
            if (i, exponents) not in entries:
                return None
            entries[i, exponents][size] = value
    check_available_memory(
        BYTES_PER_ENTRY * len(entries) * (size + 1), f"a Hamiltonian of degree {degree} in {ring.dim} coordinates"
    )
    flat = [fmpq(0)] * (len(entries) * (size + 1))
    for r, row in enumerate(entries.values()):
        for c, value in row.items():
            flat[r * (size + 1) + c] = value
    reduced, rank = fmpq_mat(len(entries), size + 1, flat).rref()
    H = ring.zero
    for r in range(rank):
        lead = next(c for c in range(size + 1) if reduced[r, c] != 0)
        if lead == size:
            return None
        H += reduced[r, size] * columns[lead]
    return H


def skew_factor(ring: ExactPolynomials, energy: Exact, field: Field) -> Matrix:
    """Return a skew polynomial matrix K with K grad H = field, for a quadratic H with grad H . field = 0."""
    # Let y = grad H. If a constant vector e has e . y = 1, K = f e^T - e f^T. Otherwise y = M z, with z the distance
    # from an equilibrium. For f of degree d in y with f . y = 0 the Koszul homotopy gives
    # K_ij = (d f_i / d y_j - d f_j / d y_i) / (d + 1), since then K y = ((d + 1) f - grad(y . f)) / (d + 1). Components
    # along the kernel of M are (d f_i / d y_j) / d instead; for these f must vanish where y does.
    from flint import fmpq, fmpq_mat

    n = ring.dim
    if energy.total_degree() > 2:
        raise ValueError("the Hamiltonian is not quadratic, so no polynomial matrix exists; use skew_matrix at points")
    if ring.along(field, energy) != 0:
        raise ValueError("the field does not keep the energy, so it is not a skew matrix times its gradient")
    slope = ring.gradient(energy)
    if all(f == 0 for f in field):
        return [[ring.zero] * n for _ in range(n)]
    at_rest = [0] * len(ring.symbols)
    linear = fmpq_mat(n, 1, [y(*[0] * n, *at_rest) for y in slope])
    M = fmpq_mat(n, n, [y.derivative(j)(*[0] * n, *at_rest) for y in slope for j in range(n)])
    reduced, rank = M.rref()
    pivots = [next(j for j in range(n) if reduced[i, j] != 0) for i in range(rank)]
    kernel = []
    for free in (j for j in range(n) if j not in pivots):
        row = [fmpq(0)] * n
        row[free] = fmpq(1)
        for i, j in enumerate(pivots):
            row[j] = -reduced[i, free]
        kernel.append(row)
    for row in kernel:
        height = sum((e * linear[i, 0] for i, e in enumerate(row)), fmpq(0))
        if height != 0:
            e = [entry / height for entry in row]
            return [[field[i] * e[j] - field[j] * e[i] for j in range(n)] for i in range(n)]
    # x = P z + origin, z = (u, w), with w along the kernel of M.
    columns = [[fmpq(int(i == j)) for i in range(n)] for j in pivots] + kernel
    P = fmpq_mat(n, n, [columns[j][i] for i in range(n) for j in range(n)])
    S_inverse = fmpq_mat(rank, rank, [M[i, j] for i in pivots for j in pivots]).inv()
    equilibrium = S_inverse * fmpq_mat(rank, 1, [-linear[i, 0] for i in pivots])
    origin = [fmpq(0)] * n
    for a, i in enumerate(pivots):
        origin[i] = equilibrium[a, 0]
    P_inverse = P.inv()
    to_z = _substitution(ring, P, origin)
    shift = [-sum((P_inverse[i, j] * origin[j] for j in range(n)), fmpq(0)) for i in range(n)]
    to_x = _substitution(ring, P_inverse, shift)
    g = [sum((P_inverse[i, j] * to_z(field[j]) for j in range(n)), ring.zero) for i in range(n)]

    def by_y(F: Exact, b: int) -> Exact:
        return sum((F.derivative(a) * S_inverse[a, b] for a in range(rank)), ring.zero)

    K = [[ring.zero] * n for _ in range(n)]
    for i in range(n):
        for degree, F in _by_degree(ring, g[i], rank).items():
            if i >= rank and degree == 0:
                raise ValueError("the field does not vanish where grad H does, so there is no polynomial matrix")
            for b in range(rank):
                entry = by_y(F, b) / (degree + 1 if i < rank else degree)
                K[i][b] += entry
                K[b][i] -= entry
    K = [[to_x(entry) for entry in row] for row in K]
    half = [[sum((P[i, a] * K[a][j] for a in range(n)), ring.zero) for j in range(n)] for i in range(n)]
    return [[sum((half[i][b] * P[j, b] for b in range(n)), ring.zero) for j in range(n)] for i in range(n)]


def _substitution(ring: ExactPolynomials, matrix: Any, origin: list[Any]) -> Callable[[Exact], Exact]:
    """Return the map of a polynomial in x to one in z, where x = matrix z + origin."""
    n, x = ring.dim, ring.coordinates
    images = [sum((matrix[i, j] * x[j] for j in range(n)), ring.zero + origin[i]) for i in range(n)]
    if images == list(x):
        return lambda F: F
    return lambda F: F.compose(*images, *ring.symbol_elements.values(), ctx=x[0].context())


def _by_degree(ring: ExactPolynomials, F: Exact, rank: int) -> dict[int, Exact]:
    """Return the parts of a polynomial by their degree in the first coordinates."""
    parts: dict[int, dict[tuple[int, ...], Any]] = {}
    for exponents, value in F.to_dict().items():
        parts.setdefault(int(sum(exponents[:rank])), {})[exponents] = value
    return {degree: ring.coordinates[0].context().from_dict(part) for degree, part in parts.items()}
