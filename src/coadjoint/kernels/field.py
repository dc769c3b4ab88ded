"""The vector field, sign * J(x) u, and its group equation, -sign * g rho(u). Tables and vectors come as pointers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import inlined
from coadjoint.kernels.pointers import call_function
from coadjoint.kernels.terms import gradient, value
from coadjoint.program.terms import Terms


class Field(NamedTuple):
    """The field x' = sign * J(x) grad H(x, t) in `size` coordinates.

    On a Lie algebra J is given by `entries` nonzero structure constants: `constant` = sign * c_ij^k, i = `row` < j =
    `column`, k = `state`; where `nonlinear`, `structure` holds the address of the compiled function x -> J(x).
    `longest` is the most rows of a term of H.
    """

    size: int
    sign: float
    entries: int
    row: NDArray[np.uint32]
    column: NDArray[np.uint32]
    state: NDArray[np.uint32]
    constant: NDArray[np.float64]
    nonlinear: bool
    structure: NDArray[np.int64]
    terms: Terms
    addresses: NDArray[np.int64]
    longest: int


class GroupField(NamedTuple):
    """The equation g' = -sign * g rho(u) for d x d matrices; `size` is d, or 0 where no group element is carried.

    Entry by entry, `entries` of them: (rho_i)_ab is nonzero for i = `element`, a = `row`, b = `column`, and `value` =
    -sign * (rho_i)_ab.
    """

    size: int
    entries: int
    element: NDArray[np.uint32]
    row: NDArray[np.uint32]
    column: NDArray[np.uint32]
    value: NDArray[np.float64]


@inlined
def product(field: Any, x: Any, u: Any, f: Any, matrix: Any) -> None:
    """Set f = sign * J(x) u; `matrix` is room for J, n * n, where it is a function of x."""
    n = field.size
    if field.nonlinear:
        call_function(field.structure[0], x, 0.0, matrix)
        for i in range(n):
            total = 0.0
            for j in range(n):
                total = fma(matrix[i * n + j], u[j], total)
            f[i] = field.sign * total
    else:
        for i in range(n):
            f[i] = 0.0
        for q in range(field.entries):
            i, j = field.row[q], field.column[q]
            entry = field.constant[q] * x[field.state[q]]
            f[i] = fma(entry, u[j], f[i])
            f[j] = fma(-entry, u[i], f[j])


@inlined
def slope(
    field: Any, x: Any, u: Any, momentum: Any, t: float, renew: bool, f: Any, rows: Any, y: Any, matrix: Any
) -> None:
    """Set f = sign * J(momentum) u, with u = grad H(x, t) renewed first where it is not given."""
    if renew:
        gradient(field.terms, field.addresses, field.size, x, t, u, rows, y)
    product(field, momentum, u, f, matrix)


@inlined
def structure_times_matrix(field: Any, x: Any, quadratic: Any, factor: float, out: Any, matrix: Any) -> None:
    """Set out = factor * sign * J(x) M, for the dense n x n matrix M."""
    n = field.size
    for i in range(n * n):
        out[i] = 0.0
    if field.nonlinear:
        call_function(field.structure[0], x, 0.0, matrix)
        for i in range(n):
            for j in range(n):
                entry = factor * field.sign * matrix[i * n + j]
                for k in range(n):
                    out[i * n + k] = fma(entry, quadratic[j * n + k], out[i * n + k])
    else:
        for q in range(field.entries):
            first, second = np.int64(field.row[q]) * n, np.int64(field.column[q]) * n
            entry = factor * field.constant[q] * x[field.state[q]]
            for k in range(n):
                out[first + k] = fma(entry, quadratic[second + k], out[first + k])
                out[second + k] = fma(-entry, quadratic[first + k], out[second + k])


@inlined
def coadjoint_matrix(field: Any, u: Any, factor: float, out: Any) -> None:
    """Set out = factor * sign * D_u, dense: J(x) u = D_u x."""
    n = field.size
    for i in range(n * n):
        out[i] = 0.0
    for q in range(field.entries):
        row, column, state = np.int64(field.row[q]), np.int64(field.column[q]), np.int64(field.state[q])
        first, second = row * n + state, column * n + state
        out[first] = fma(factor * field.constant[q], u[column], out[first])
        out[second] = fma(-factor * field.constant[q], u[row], out[second])


@inlined
def group_matrix(group: Any, u: Any, factor: float, out: Any) -> None:
    """Set out = factor * (-sign rho(u))^T, dense d x d: it acts on the stored, transposed, group element."""
    d = group.size
    for i in range(d * d):
        out[i] = 0.0
    for q in range(group.entries):
        place = np.int64(group.column[q]) * d + np.int64(group.row[q])
        out[place] = fma(factor * group.value[q], u[group.element[q]], out[place])


@inlined
def group_slope(group: Any, u: Any, g: Any, f: Any) -> None:
    """Set f = -sign * g rho(u); component c of row r of a matrix stands at c * d + r."""
    d = group.size
    for i in range(d * d):
        f[i] = 0.0
    for q in range(group.entries):
        entry = group.value[q] * u[group.element[q]]
        source, goal = np.int64(group.row[q]) * d, np.int64(group.column[q]) * d
        for r in range(d):
            f[goal + r] = fma(g[source + r], entry, f[goal + r])


@inlined
def energy(field: Any, values: Any, x: Any, t: float, y: Any) -> float:
    """Return H(x, t) without its constant.

    `values` holds the compiled values of FUNCTION terms, `y` is room for longest + 1 numbers.
    """
    total = 0.0
    for k in range(field.terms.size):
        total += value(field.terms, values, k, x, t, y)
    return total
