"""What no change of basis alters in a Lie algebra, by linear algebra over the rationals."""

from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from flint import fmpq, fmpq_mat


class Invariants(NamedTuple):
    """Dimensions of the derived and lower central series, the upper central series, Der(g) and the nilradical."""

    derived: tuple[int, ...]
    lower: tuple[int, ...]
    upper: tuple[int, ...]
    derivations: int
    nilradical: int


def exact(rows) -> fmpq_mat:
    return fmpq_mat([[fmpq(int(v.numerator), int(v.denominator)) for v in row] for row in rows])


def adjoints(c: np.ndarray) -> list[fmpq_mat]:
    """The matrices ad e_i, which send e_j to sum_k c_ij^k e_k."""
    return [exact(plane.T) for plane in c]


def is_lie_algebra(c: np.ndarray) -> bool:
    """Whether the constants are antisymmetric and ad [e_i, e_j] = ad e_i ad e_j - ad e_j ad e_i."""
    n, ad = len(c), adjoints(c)
    for i, j in combinations(range(n), 2):
        rest = ad[i] * ad[j] - ad[j] * ad[i]
        for k in np.flatnonzero(c[i, j]):
            rest -= ad[k] * fmpq(int(c[i, j, k].numerator), int(c[i, j, k].denominator))
        if rest != fmpq_mat(n, n):
            return False
    return bool(np.all(c == -c.transpose(1, 0, 2)))


def spanned(vectors: list[Any], size: int) -> list[list[Any]]:
    """A basis of the span, in its reduced form."""
    if not vectors:
        return []
    reduced, rank = fmpq_mat(vectors).rref()
    return [[reduced[i, j] for j in range(size)] for i in range(rank)]


def kernel_dim(rows: list[Any], size: int) -> int:
    return size - (fmpq_mat(rows).rank() if rows else 0)


def invariants(c: np.ndarray) -> Invariants:
    """The dimensions, from constants of Fractions, shape (n, n, n), that are those of a Lie algebra."""
    n = len(c)
    table = [[[fmpq(int(v.numerator), int(v.denominator)) for v in row] for row in plane] for plane in c.tolist()]
    whole = [[fmpq(int(i == j)) for j in range(n)] for i in range(n)]

    def bracket(u, v):
        total = [fmpq(0)] * n
        for i, j in product(range(n), repeat=2):
            if u[i] != 0 and v[j] != 0:
                total = [t + u[i] * v[j] * w for t, w in zip(total, table[i][j], strict=True)]
        return total

    def series(left):
        """Dimensions of g, [left, .], ... until they stay; left None is the subspace itself."""
        now, sizes = whole, [n]
        while True:
            now = spanned([bracket(u, v) for u in (left or now) for v in now], n)
            if len(now) == sizes[-1]:
                return tuple(sizes)
            sizes.append(len(now))
            if not now:
                return tuple(sizes)

    return Invariants(series(None), series(whole), _upper(table, n), _derivations(table, n), _nilradical(c))


def _upper(table, n):
    """Dimensions of the upper central series: x with [e_i, x] in the last one, modulo it."""
    inside: list[list[Any]] = []
    sizes = []
    while True:
        # Functionals that vanish on what was found: the bracket with each e_i must vanish under them.
        rows = [
            [sum((f[k] * table[i][j][k] for k in range(n)), fmpq(0)) for j in range(n)]
            for f in _kernel(inside, n)
            for i in range(n)
        ]
        inside = _kernel(rows, n)
        if sizes and len(inside) == sizes[-1]:
            return tuple(sizes)
        sizes.append(len(inside))
        if not inside:
            return (0,)


def _kernel(rows, n):
    """A basis of what all rows send to zero."""
    if not rows:
        return [[fmpq(int(i == j)) for j in range(n)] for i in range(n)]
    reduced, rank = fmpq_mat(rows).rref()
    pivots = [next(j for j in range(n) if reduced[i, j] != 0) for i in range(rank)]
    found = []
    for free in (j for j in range(n) if j not in pivots):
        vector = [fmpq(int(j == free)) for j in range(n)]
        for i, pivot in enumerate(pivots):
            vector[pivot] = -reduced[i, free]
        found.append(vector)
    return found


def _derivations(table, n):
    """Dimension of {D : D[e_i, e_j] = [D e_i, e_j] + [e_i, D e_j]}, D e_i = sum_k D_ki e_k at the place k n + i."""
    rows = []
    for i, j in combinations(range(n), 2):
        for k in range(n):
            row = [fmpq(0)] * (n * n)
            for m in range(n):
                row[k * n + m] += table[i][j][m]
                row[m * n + i] -= table[m][j][k]
                row[m * n + j] -= table[i][m][k]
            rows.append(row)
    return kernel_dim(rows, n * n)


def _nilradical(c):
    """Dimension of {x : tr(ad x B) = 0 for all B of the associative algebra of ad g}: where its radical meets ad g."""
    n = len(c)
    adjoint = adjoints(c)

    def entries(matrix):
        return [matrix[i, j] for i in range(n) for j in range(n)]

    found: list[list[Any]] = []
    new = adjoint
    kept: list[fmpq_mat] = []
    while new:
        fresh = []
        for matrix in new:
            larger = spanned([*found, entries(matrix)], n * n)
            if len(larger) > len(found):
                found = larger
                fresh.append(matrix)
        kept += fresh
        new = [a * b for a in adjoint for b in fresh]
    rows = []
    for b in kept:
        products = [a * b for a in adjoint]
        rows.append([sum((p[i, i] for i in range(n)), fmpq(0)) for p in products])
    return kernel_dim(rows, n)


def adjoint_polynomial(c: np.ndarray, x) -> list[fmpq]:
    """Coefficients, lowest first, of det(s - N), N e_i = [e_i, x]."""
    n = len(c)
    matrix = [[sum(x[j] * c[i, j, k] for j in range(n)) for i in range(n)] for k in range(n)]
    return list(exact([[v + 0 * x[0] for v in row] for row in matrix]).charpoly().coeffs())
