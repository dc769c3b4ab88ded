"""Polynomial vector fields: test for Poisson fields, and Hamiltonians for a bracket of polynomials."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.analysis.backward_error.field_of_step import Field, size_of
from coadjoint.memory import check_available_memory

BYTES_PER_ENTRY = 40  # of a matrix of fractions during its reduction


def bracket_change(ring: ExactPolynomials, J: list[Field], field: Field) -> float:
    """Return the largest coefficient of the Lie derivative L_f J of the bracket along a field; 0 for a Poisson field.

    (L_f J)_ij = f . grad J_ij - sum_l (d f_i / d x_l) J_lj - sum_l J_il (d f_j / d x_l).
    """
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
    """Return a polynomial H with J grad H = field, or None if there is none; all non-zero entries of J have one degree.

    H is unique up to Casimirs; undetermined coefficients are zero. Raise ValueError if the linear system exceeds
    memory.
    """
    degree_of_J = _degree(J)
    total = ring.zero
    for degree, part in _by_degree(ring, field).items():
        found = _of_degree(ring, J, part, degree + 1 - degree_of_J) if degree + 1 > degree_of_J else None
        if found is None:
            return None
        total += found
    return total


def _degree(J: list[Field]) -> int:
    degrees = {sum(map(int, e[: len(J)])) for row in J for entry in row for e in entry.monoms()}
    if len(degrees) > 1:
        raise ValueError(f"the entries of J have the degrees {sorted(degrees)}; a Hamiltonian needs one common degree")
    return degrees.pop() if degrees else 0


def _by_degree(ring: ExactPolynomials, field: Field) -> dict[int, Field]:
    context = ring.coordinates[0].context()
    parts: dict[int, list[dict[Any, Any]]] = {}
    for i, f in enumerate(field):
        for exponents, value in f.to_dict().items():
            parts.setdefault(int(sum(exponents)), [{} for _ in field])[i][exponents] = value
    return {degree: [context.from_dict(entry) for entry in part] for degree, part in sorted(parts.items())}


def _of_degree(ring: ExactPolynomials, J: list[Field], field: Field, degree: int) -> Exact | None:
    from flint import fmpq, fmpq_mat

    columns = []
    for chosen in combinations_with_replacement(range(ring.dim), degree):
        monomial = ring.zero + 1
        for i in chosen:
            monomial *= ring.coordinates[i]
        columns.append(monomial)
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
    found = ring.zero
    for r in range(rank):
        lead = next(c for c in range(size + 1) if reduced[r, c] != 0)
        if lead == size:
            return None
        found += reduced[r, size] * columns[lead]
    return found
