"""The verb `angle`: gradients and values of the terms of a table. Tables and vectors come as pointers."""

from __future__ import annotations

from typing import Any

from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import inlined
from coadjoint.kernels.pointers import call_function, shifted
from coadjoint.program.terms import LINEAR, POLYNOMIAL


@inlined
def power(x: float, exponent: int) -> float:
    """Return x to a whole power by repeated multiplication, in an order that depends on the exponent alone."""
    result = 1.0
    for _ in range(exponent):
        result *= x
    return result


@inlined
def linear_row(terms: Any, row: int, x: Any) -> float:
    """Return one row of a LINEAR term: offset + weight . x."""
    total = terms.offset[row]
    for entry in range(terms.entry[row], terms.entry[row + 1]):
        total = fma(terms.weight[entry], x[terms.column[entry]], total)
    return total


@inlined
def gradient_rows(terms: Any, addresses: Any, k: int, x: Any, t: float, out: Any, first: int, y: Any) -> None:
    """Fill out[row - first] with every row of term k: the angles of a share, or components of a gradient.

    `addresses` holds the compiled gradients of FUNCTION terms; `y` is room for their arguments.
    """
    start, stop = terms.row[k], terms.row[k + 1]
    kind = terms.kind[k]
    if kind == LINEAR:
        for row in range(start, stop):
            out[row - first] = linear_row(terms, row, x)
    elif kind == POLYNOMIAL:
        for row in range(start, stop):
            out[row - first] = 0.0
        for monomial in range(terms.monomial[k], terms.monomial[k + 1]):
            low, high = terms.factor[monomial], terms.factor[monomial + 1]
            for chosen in range(low, high):
                product = terms.coefficient[monomial]
                for factor in range(low, high):
                    coordinate = x[terms.target[terms.factor_row[factor]]]
                    exponent = terms.exponent[factor]
                    if factor == chosen:
                        product *= exponent * power(coordinate, exponent - 1)
                    else:
                        product *= power(coordinate, exponent)
                out[terms.factor_row[chosen] - first] += product
    else:
        for row in range(start, stop):
            y[row - start] = x[terms.target[row]]
        call_function(addresses[k], y, t, shifted(out, start - first))


@inlined
def value(terms: Any, addresses: Any, k: int, x: Any, t: float, y: Any) -> float:
    """Return the value of term k; `addresses` holds the values of FUNCTION terms, `y` is room for arguments."""
    start, stop = terms.row[k], terms.row[k + 1]
    kind = terms.kind[k]
    total = 0.0
    if kind == LINEAR:
        for row in range(start, stop):
            weighted = 0.0
            for entry in range(terms.entry[row], terms.entry[row + 1]):
                weighted = fma(terms.weight[entry], x[terms.column[entry]], weighted)
            total = fma(x[terms.target[row]], fma(0.5, weighted, terms.offset[row]), total)
    elif kind == POLYNOMIAL:
        for monomial in range(terms.monomial[k], terms.monomial[k + 1]):
            product = terms.coefficient[monomial]
            for factor in range(terms.factor[monomial], terms.factor[monomial + 1]):
                product *= power(x[terms.target[terms.factor_row[factor]]], terms.exponent[factor])
            total += product
    else:
        for row in range(start, stop):
            y[row - start] = x[terms.target[row]]
        room = shifted(y, stop - start)
        call_function(addresses[k], y, t, room)
        total = room[0]
    return total


@inlined
def gradient(terms: Any, addresses: Any, size: int, x: Any, t: float, u: Any, rows: Any, y: Any) -> None:
    """Fill u (`size` components) with the gradient of the sum of all terms; `rows` and `y` are room."""
    for i in range(size):
        u[i] = 0.0
    for k in range(terms.size):
        first = terms.row[k]
        gradient_rows(terms, addresses, k, x, t, rows, first, y)
        for row in range(first, terms.row[k + 1]):
            u[terms.target[row]] += rows[row - first]
