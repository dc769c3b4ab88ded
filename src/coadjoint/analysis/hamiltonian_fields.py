"""Is a polynomial field Hamiltonian for a bracket of polynomials? And with which Hamiltonian?"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

from coadjoint.algebra.exact_polynomials import Exact, ExactPolynomials
from coadjoint.analysis.field_of_step import Field, size_of
from coadjoint.memory import check_room

BYTES_PER_ENTRY = 40  # for each entry of a matrix of fractions while it is reduced


def bracket_change(ring: ExactPolynomials, J: list[Field], field: Field) -> float:
    """Return the largest coefficient of the change of the bracket along a field, L_f J; 0 for a Poisson field.

    (L_f J)_ij = f . grad J_ij - sum_l (d f_i / d x_l) J_lj - sum_l J_il (d f_j / d x_l).

    Parameters
    ----------
    ring : ExactPolynomials
        What everything belongs to.
    J : list of lists
        The skew matrix.
    field : list
        n polynomials.

    Returns
    -------
    float

    Examples
    --------
    A scaling is none on so(3):

    >>> from coadjoint.algebra import catalogue
    >>> ring = ExactPolynomials(catalogue.so(3))
    >>> x1, x2, x3 = ring.coordinates
    >>> J = [[0 * x1, x3, -x2], [-x3, 0 * x1, x1], [x2, -x1, 0 * x1]]
    >>> bracket_change(ring, J, [x1, x2, x3]), bracket_change(ring, J, [-x2, x1, 0 * x3])
    (1.0, 0.0)
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
    """Return a polynomial H with J grad H = field, or None where there is none.

    H is unique up to Casimirs. Coefficients that Casimirs leave open are zero.

    Parameters
    ----------
    ring : ExactPolynomials
        What everything belongs to.
    J : list of lists
        The skew matrix, whose entries that are not zero have one degree.
    field : list
        n polynomials.

    Returns
    -------
    polynomial or None

    Raises
    ------
    ValueError
        The linear system does not fit in memory.

    Examples
    --------
    >>> from coadjoint.algebra import catalogue
    >>> ring = ExactPolynomials(catalogue.so(3))
    >>> x1, x2, x3 = ring.coordinates
    >>> J = [[0 * x1, x3, -x2], [-x3, 0 * x1, x1], [x2, -x1, 0 * x1]]
    >>> hamiltonian_of(ring, J, [x2 * x3, -x1 * x3, 0 * x3])
    1/2*x1^2 + 1/2*x2^2
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
        raise ValueError(f"the entries of J have the degrees {sorted(degrees)}; a Hamiltonian is sought for one degree")
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
    check_room(
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
