"""The h^2 term of the modified Hamiltonian of a splitting, at given points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import BodyShare, FunctionShare, Parts, PolynomialShare
from coadjoint.program.term_table import derivative_of

Floats = NDArray[np.float64]


class Jet(NamedTuple):
    """Gradient (n,) and Hessian (n, n) of a function at a point, or stacked over parts and points."""

    gradient: Floats
    hessian: Floats


def part_jets(parts: Parts, points: Floats, t: float = 0.0) -> Jet:
    """Return gradient and Hessian of the piece of the Hamiltonian of each part at points (k, n).

    The gradients sum_a l_a theta_a have shape (parts, k, n), the Hessians (parts, k, n, n), or (parts, 1, n, n) if all
    are constant.
    """
    count, n = points.shape
    constant, bent = np.zeros((len(parts), 1, n)), np.zeros((len(parts), 1, n, n))
    forms, weights, part = parts.forms, parts.weights, parts.part_of_angle
    angle, value = forms.owner, forms.value.astype(np.float64)
    place: Any = (part[angle], 0, forms.coordinate)
    np.add.at(constant, place, value * parts.offset[angle].astype(np.float64))
    entry, at = expand(weights.start[angle], weights.start[angle + 1])
    place = (part[angle[entry]], 0, forms.coordinate[entry], weights.coordinate[at])
    np.add.at(bent, place, value[entry] * weights.value[at].astype(np.float64))
    gradient = constant + _applied(bent, points)
    hessian = np.repeat(bent, count, axis=1) if parts.nonlinear_shares else bent
    for s, share in parts.nonlinear_shares.items():
        if isinstance(share, BodyShare):
            continue
        own = share.term.coordinates if isinstance(share, FunctionShare) else np.array(share.coordinates)
        p = part[parts.row[s]]
        for k, x in enumerate(points):
            slope, curvature = _share_jet(share, own, x, t)
            gradient[p, k, own] += slope
            hessian[p, k][np.ix_(own, own)] += curvature
    return Jet(gradient, hessian)


def _share_jet(share: PolynomialShare | FunctionShare, own: NDArray[Any], x: Floats, t: float) -> tuple[Floats, Floats]:
    """Return gradient and Hessian of a share with respect to its own coordinates."""
    if isinstance(share, FunctionShare):
        slope, curvature = (derivative_of(share.term, order, x[own], t) for order in (1, 2))
    else:
        slope, curvature = share.polynomial.gradient(x)[own], share.polynomial.hessian(x)[np.ix_(own, own)]
    return np.asarray(slope, dtype=np.float64), np.asarray(curvature, dtype=np.float64)


def _applied(matrices: Floats, vectors: Floats) -> Floats:
    """Multiply matrices (..., n, n) by vectors (..., n), summed in order.

    The bits of einsum may depend on the batch size, and the choice of the smallest term must not.
    """
    total = matrices[..., 0] * vectors[..., :1]
    for j in range(1, matrices.shape[-1]):
        total = total + matrices[..., j] * vectors[..., j : j + 1]
    return total


class Samples:
    """Gradients and Hessians of several sets of parts at points (k, n), computed once to compare many orders.

    The bracket is {F, G} = (grad F)^T J(x) grad G. All algebras must have the same sparsity pattern, and all sets the
    same number of parts. Raises TypeError if a user function has no second derivatives.
    """

    def __init__(self, algebras: Sequence[LieAlgebra], sets: Sequence[Parts], points: Floats, t: float = 0.0) -> None:
        every = part_jets(Parts.concatenate(sets), points, t)
        shape = (len(sets), len(sets[0]))
        self._gradients, self._hessians = (jet.reshape(*shape, *jet.shape[1:]) for jet in every)
        count, n = points.shape
        self._i, self._j, self._k, _ = algebras[0].triples
        self._c = np.array([algebra.triples.c for algebra in algebras]).reshape(len(sets), 1, 1, -1)
        flat = np.zeros((n * n, len(sets), count))
        products = np.moveaxis(self._c[:, 0] * points[:, self._k], -1, 0)
        np.add.at(flat, self._i * n + self._j, products)
        np.subtract.at(flat, self._j * n + self._i, products)
        self._structure = np.moveaxis(flat, 0, -1).reshape(len(sets), 1, count, n, n)

    def second_order_terms(self, orders: Sequence[Sequence[int]]) -> Floats:
        """Return H2, shape (sets, orders, k), for orders of parts in a forward sweep.

        ``X1(h/2) ... Xn(h) ... X1(h/2)`` is the time-h flow of H + h^2 H2 + O(h^4). For a pair, A outside and D inside,
        H2 = -{A, {A, D}}/24 + {D, {D, A}}/12; several parts are nested pairs.
        """
        places = np.array(orders)
        inside, curved = self._gradients[:, places[:, -1]], self._hessians[:, places[:, -1]]
        total = np.zeros(inside.shape[:3])
        for place in range(places.shape[1] - 2, -1, -1):
            outside, bent = self._gradients[:, places[:, place]], self._hessians[:, places[:, place]]
            turned = self._turned(self._bracket_gradient(outside, bent, inside, curved))
            weights = outside / 24.0 + inside / 12.0
            for i in range(inside.shape[-1]):
                total -= weights[..., i] * turned[..., i]
            inside, curved = outside + inside, bent + curved
        return total

    def sizes(self, orders: Sequence[Sequence[int]]) -> Floats:
        """Return the root mean square of H2 over the points, shape (sets, orders)."""
        # Terms that overflow float64 count as larger than all others.
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.second_order_terms(orders)
            squares = np.zeros(terms.shape[:2])
            for k in range(terms.shape[2]):
                squares += terms[..., k] ** 2
            found = np.sqrt(squares / terms.shape[2])
        return np.where(np.isnan(found), np.inf, found)

    def nested_brackets(self, j: NDArray[np.int64], k: NDArray[np.int64]) -> Floats:
        """Return {H_i, {H_j, H_k}} of the first set, all parts i and pairs (j, k), shape (parts, pairs, k)."""
        inner = self._bracket_gradient(
            self._gradients[:1, j], self._hessians[:1, j], self._gradients[:1, k], self._hessians[:1, k]
        )
        turned = self._turned(inner)[0]
        found = np.zeros((len(self._gradients[0]), *turned.shape[:2]))
        for i, gradient in enumerate(self._gradients[0]):
            for a in range(gradient.shape[-1]):
                found[i] += gradient[:, a] * turned[..., a]
        return found

    def _turned(self, u: Floats) -> Floats:
        return _applied(self._structure, u)

    def _bracket_gradient(self, a: Floats, a_bent: Floats, d: Floats, d_bent: Floats) -> Floats:
        """Return the gradient of {A, D}: A'' J grad D - D'' J grad A + [grad A, grad D], J being linear in x."""
        result = _applied(a_bent, self._turned(d)) - _applied(d_bent, self._turned(a))
        products = self._c * (a[..., self._i] * d[..., self._j] - a[..., self._j] * d[..., self._i])
        np.add.at(np.moveaxis(result, -1, 0), self._k, np.moveaxis(products, -1, 0))
        return result


def second_order_term(algebra: LieAlgebra, parts: Parts, points: Floats, t: float = 0.0) -> Floats:
    """Return H2 of parts in the order of a forward sweep at points (k, n), shape (k,); see `Samples`."""
    return Samples([algebra], [parts], points, t).second_order_terms([range(len(parts))])[0, 0]
