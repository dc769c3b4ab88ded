"""Power series of steps and their formal vector fields (Lemma 6.1); systems and fields in exact polynomials."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import fraction, rational
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import exponents_of_degree
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.methods.numerics.formal_series import NODE, FormalNumber, formal_numbers, vector
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.hamiltonians.hamiltonian import as_hamiltonian
from coadjoint.systems.system import System

Field = list[Exact]
"""The n polynomials of a vector field."""
Matrix = list[list[Exact]]

BYTES_PER_MONOMIAL = 200  # of a field, including its powers and derivatives and the series of its step
MAX_MONOMIALS = 10**5  # of a field; products of larger ones take minutes
DISPLACEMENT = 1e-10  # displacement, relative to the state, in the step that checks a series at a point
MAX_OMITTED_COEFFICIENT = 1e6  # largest coefficient of the first omitted power of the series, in the same units


class ExactSystem:
    """A system with polynomial J and H in a ring; floats are converted to rationals exactly."""

    def __init__(self, system: System) -> None:
        self.system = system
        _check_monomials(system)
        self.ring = ExactPolynomials(LieAlgebra([], dim=system.dim), (NODE,))  # with zero bracket
        self._number = formal_numbers(self.ring, 1)
        self.energy = self.value_of(system.energy)
        self.field: Field = self._polynomials(system.vector_field(self._point))

    @property
    def _point(self) -> NDArray[Any]:
        return vector(map(self._number.constant, self.ring.coordinates))

    def _polynomials(self, values: Any) -> list[Exact]:
        return [self._number(value).coefficients[0] for value in values]

    @cached_property
    def structure(self) -> list[Field]:
        return [self._polynomials(row) for row in self.system.structure_matrix(self._point)]

    def polynomial(self, F: Exact) -> Polynomial:
        """Return an element of the ring as a polynomial in the coordinates of the system."""
        return in_coordinates_of(self.system, self.ring.polynomial(F))

    def value_of(self, function: Callable[..., Any]) -> Exact:
        return self._polynomials([function(self._point)])[0]

    def invariant(self, function: Any) -> Exact:
        """Return a polynomial, or a Hamiltonian that is one, in the ring."""
        if isinstance(function, Polynomial):
            return self.ring.from_polynomial(function)
        return self.value_of(as_hamiltonian(function, self.system.dim).value)

    @cached_property
    def casimirs(self) -> dict[str, Exact]:
        polynomials = ("monomials", "form", "bind")
        found = self.system.casimirs.items()
        return {name: self.invariant(C) for name, C in found if any(hasattr(C, one) for one in polynomials)}

    def check_available_memory(self, order: int) -> None:
        """Raise an error if the polynomials of an order do not fit in memory."""
        n, degree = self.system.dim, max(int(f.total_degree()) for f in self.field)
        highest = 1 + order * max(degree - 1, 0)
        count = math.comb(n + highest, n) - (math.comb(n + highest - 1, n) if degree > 1 else 0)
        check_available_memory(
            BYTES_PER_MONOMIAL * n * order * count,
            f"a modified field of order {order}, of degree {highest} in {n} coordinates,",
            "take a lower order",
        )

    def series_of(self, step: Callable[[NDArray[Any], Any], Any], order: int) -> list[Field]:
        """Return the coefficients of h^0, ..., h^order of a step, a function of formal numbers x and h."""
        number = formal_numbers(self.ring, order + 1)
        x, h = vector(map(number.constant, self.ring.coordinates)), number.step()
        end: list[FormalNumber] = [number(value) for value in step(x, h)]
        count = min(len(value.coefficients) for value in end)
        if count <= order:
            raise TypeError(f"the series of the step is known up to h^{count - 1} only, not to h^{order}")
        return [[value.coefficients[k] for value in end] for k in range(order + 1)]


def _check_monomials(system: System) -> None:
    """Raise an error for a field with too many monomials, estimated as the number of products in J(x) M x."""
    terms = system.hamiltonian.terms()
    form = terms[0].form if len(terms) == 1 else None
    if not system.has_structure_constants or form is None:
        return
    entries = np.diff(form.indptr)
    i, j, _, _ = system.algebra.triples
    count = int(np.sum(entries[i] + entries[j]))
    if count > MAX_MONOMIALS:
        raise ValueError(
            f"the field of {system.name} has about {count:.0e} monomials; exact series support at most "
            f"{MAX_MONOMIALS:.0e}"
        )


def check_at_a_point(
    step: Callable[[NDArray[Any], Any], Any], exact: ExactSystem, series: list[Field], known_to: float
) -> None:
    """Raise TypeError if the series contradicts the step at a point, as for steps that branch or iterate."""
    from mpmath import mp, workdps

    order = len(series) - 1
    digits = 30 - int((order + 2) * math.log10(DISPLACEMENT))
    with workdps(digits):
        point = np.random.default_rng(order).uniform(0.5, 1.0, exact.system.dim)
        x = vector(map(mp.mpf, point))
        speed = max(abs(value) for value in values_at(exact.field, point)) or mp.mpf(1)
        h = mp.mpf(DISPLACEMENT) / speed
        end = np.asarray(step(x, h))
        expected = sum(np.array(values_at(terms, point)) * h**k for k, terms in enumerate(series))
        size = max(abs(value) for value in end - expected)
        allowed = MAX_OMITTED_COEFFICIENT * (mp.mpf(DISPLACEMENT) ** (order + 1) + known_to * DISPLACEMENT)
        if not size <= allowed:
            raise TypeError(
                f"the power series of the step contradicts the step at a sample point (by {float(size):.2g}, where "
                f"{float(allowed):.2g} is allowed); a step that branches, or iterates to a tolerance, has no such "
                "series"
            )


def values_at(polynomials: list[Exact], x: NDArray[np.float64]) -> list[Any]:
    """Return the values at a point, in the current precision of mpmath."""
    from mpmath import mp

    at = [*(rational(float(value)) for value in x), 0]
    values = [polynomial(*at) for polynomial in polynomials]
    return [mp.mpf(int(value.numer())) / int(value.denom()) for value in values]


def scale_of_motion(exact: ExactSystem, count: int) -> list[float]:
    """Return the largest coefficients of the Taylor terms of the motion, of h^1, ..., h^count."""
    scales, term = [], list(exact.ring.coordinates)
    for k in range(1, count + 1):
        term = [exact.ring.along(exact.field, F) / k for F in term]
        scales.append(max(map(size_of, term)))
    return scales


def field_of_series(ring: ExactPolynomials, series: Sequence[Field]) -> list[Field]:
    """Return f_0, f_1, ... with exp(h (f_0 + h f_1 + ...)) = the series of a step, as polynomials of h^0, h^1, ..."""
    # S. Reich 1993, Lemma 6.1, where the indices of the fields Y are too low by one. With D the derivative along
    # h f_0 + h^2 f_1 + ..., the flow is sum_m D^m x / m!, in which f_k first occurs in the coefficient of h^(k+1).
    fields: list[Field] = []
    # powers[m - 1][q] is the coefficient of h^q in D^m x, q >= m.
    powers: list[dict[int, Field]] = [{}]
    for k in range(len(series) - 1):
        power = k + 1
        field = list(series[power])
        for m in range(2, power + 1):
            if len(powers) < m:
                powers.append({})
            total = [ring.zero] * ring.dim
            for q, inner in powers[m - 2].items():
                j = power - q - 1
                if 0 <= j < len(fields):
                    total = [a + ring.along(fields[j], F) for a, F in zip(total, inner, strict=True)]
            powers[m - 1][power] = total
            field = [a - b / math.factorial(m) for a, b in zip(field, total, strict=True)]
        fields.append(field)
        powers[0][power] = field
    return fields


def size_of(polynomial: Exact) -> float:
    """Return the largest absolute coefficient."""
    largest = max((abs(value) for value in polynomial.coeffs()), default=0)
    return float(fraction(largest)) if largest else 0.0


def field_at(step: Callable[[NDArray[Any], Any], Any], x: NDArray[Any], steps: Sequence[Any]) -> NDArray[Any]:
    """Return f_0(x), ..., f_(r-1)(x), (r, n), from steps ``step(x, h)`` of r different lengths, in the numbers of x."""
    # X(h) = (1/h) sum_(m=1)^r (-1)^(m+1)/m (step - 1)^m x is f_0 + h f_1 + ... + O(h^r). The terms are the coefficients
    # of the interpolation polynomial in h through the r values of X.
    count = len(steps)
    values = []
    for h in steps:
        points = [x]
        for _ in range(count):
            points.append(np.asarray(step(points[-1], h)))
        total, differences = 0 * x, points
        for m in range(1, count + 1):
            differences = [b - a for a, b in pairwise(differences)]
            total = total + differences[0] * (1 if m % 2 else -1) / m
        values.append(total / h)
    # Newton's divided differences, expanded in powers of h.
    table = list(values)
    for level in range(1, count):
        for i in reversed(range(level, count)):
            table[i] = (table[i] - table[i - 1]) / (steps[i] - steps[i - level])
    terms = [table[-1]]
    for i in reversed(range(count - 1)):
        shifted = [0 * x, *terms]
        for k, term in enumerate(terms):
            shifted[k] = shifted[k] - steps[i] * term
        shifted[0] = shifted[0] + table[i]
        terms = shifted
    return np.array(terms, dtype=object)


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

    columns = [ring.monomial(exponents) for exponents in exponents_of_degree(ring.dim, degree)]
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
    parts: dict[int, dict[tuple[int, ...], Any]] = {}
    for exponents, value in F.to_dict().items():
        parts.setdefault(int(sum(exponents[:rank])), {})[exponents] = value
    return {degree: ring.coordinates[0].context().from_dict(part) for degree, part in parts.items()}
