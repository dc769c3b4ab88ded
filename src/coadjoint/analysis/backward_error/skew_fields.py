"""Skew-gradient form K(x) grad H(x) of polynomial fields that keep a quadratic energy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.analysis.backward_error.field_of_step import Field

Matrix = list[list[Exact]]


def skew_factor(ring: ExactPolynomials, energy: Exact, field: Field) -> Matrix:
    """Return a skew polynomial matrix K with K grad H = field, for a quadratic H with grad H . field = 0.

    Let y = grad H. If a constant vector e has e . y = 1, K = f e^T - e f^T. Otherwise y = M z, with z the distance from
    an equilibrium. For f of degree d in y with f . y = 0 the Koszul homotopy gives K_ij = (d f_i / d y_j - d f_j / d
    y_i) / (d + 1), since then K y = ((d + 1) f - grad(y . f)) / (d + 1). Components along the kernel of M are (d f_i /
    d y_j) / d instead; for these f must vanish where y does. Raise ValueError if no polynomial K exists.
    """
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
    chosen = [next(j for j in range(n) if reduced[i, j] != 0) for i in range(rank)]
    kernel = []
    for free in (j for j in range(n) if j not in chosen):
        row = [fmpq(0)] * n
        row[free] = fmpq(1)
        for i, j in enumerate(chosen):
            row[j] = -reduced[i, free]
        kernel.append(row)
    for row in kernel:
        height = sum((e * linear[i, 0] for i, e in enumerate(row)), fmpq(0))
        if height != 0:
            e = [entry / height for entry in row]
            return [[field[i] * e[j] - field[j] * e[i] for j in range(n)] for i in range(n)]
    # x = P z + rest, z = (u, w), with w along the kernel of M.
    columns = [[fmpq(int(i == j)) for i in range(n)] for j in chosen] + kernel
    P = fmpq_mat(n, n, [columns[j][i] for i in range(n) for j in range(n)])
    S = fmpq_mat(rank, rank, [M[i, j] for i in chosen for j in chosen])
    flexible = S.inv()
    rest = flexible * fmpq_mat(rank, 1, [-linear[i, 0] for i in chosen])
    origin = [fmpq(0)] * n
    for a, i in enumerate(chosen):
        origin[i] = rest[a, 0]
    back = P.inv()
    into = _substitution(ring, P, origin)
    shift = [-sum((back[i, j] * origin[j] for j in range(n)), fmpq(0)) for i in range(n)]
    out = _substitution(ring, back, shift)
    g = [sum((back[i, j] * into(field[j]) for j in range(n)), ring.zero) for i in range(n)]

    def by_y(F: Exact, b: int) -> Exact:
        return sum((F.derivative(a) * flexible[a, b] for a in range(rank)), ring.zero)

    K = [[ring.zero] * n for _ in range(n)]
    for i in range(n):
        for degree, F in _by_degree(ring, g[i], rank).items():
            if i >= rank and degree == 0:
                raise ValueError("the field does not vanish where grad H does, so there is no polynomial matrix")
            for b in range(rank):
                entry = by_y(F, b) / (degree + 1 if i < rank else degree)
                K[i][b] += entry
                K[b][i] -= entry
    K = [[out(entry) for entry in row] for row in K]
    half = [[sum((P[i, a] * K[a][j] for a in range(n)), ring.zero) for j in range(n)] for i in range(n)]
    return [[sum((half[i][b] * P[j, b] for b in range(n)), ring.zero) for j in range(n)] for i in range(n)]


def _substitution(ring: ExactPolynomials, matrix: Any, origin: list[Any]) -> Callable[[Exact], Exact]:
    """Return the map of a polynomial in x to one in z, where x = matrix z + origin."""
    n, x = ring.dim, ring.coordinates
    images = [sum((matrix[i, j] * x[j] for j in range(n)), ring.zero + origin[i]) for i in range(n)]
    if images == list(x):
        return lambda F: F
    return lambda F: F.compose(*images, *ring.symbol.values(), ctx=x[0].context())


def _by_degree(ring: ExactPolynomials, F: Exact, rank: int) -> dict[int, Exact]:
    """Return the parts of a polynomial by their degree in the first coordinates."""
    parts: dict[int, dict[tuple[int, ...], Any]] = {}
    for exponents, value in F.to_dict().items():
        parts.setdefault(int(sum(exponents[:rank])), {})[exponents] = value
    return {degree: ring.coordinates[0].context().from_dict(part) for degree, part in parts.items()}
