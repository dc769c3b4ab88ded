"""How good is a splitting? The h^2 term of its modified Hamiltonian, at given points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts import FunctionShare, LinearShare, Part
from coadjoint.program.terms import derivative_of


class Jet(NamedTuple):
    """Gradient (n,) and Hessian (n, n) of a function at a point."""

    gradient: NDArray[np.float64]
    hessian: NDArray[np.float64]


def part_jet(part: Part, x: NDArray[np.float64], t: float) -> Jet:
    """Return gradient and Hessian of a part's piece of the Hamiltonian at x.

    Parameters
    ----------
    part : Part
        Its forms l_a and shares.
    x : ndarray, shape (n,)
        Momentum.
    t : float
        Time.

    Returns
    -------
    Jet
        sum_a l_a theta_a, and its derivative.
    """
    n = len(x)
    forms = np.zeros((len(part.forms), n))
    for row, (coordinates, values) in zip(forms, part.forms, strict=True):
        row[list(coordinates)] = [float(value) for value in values]
    angles, slopes = [], []
    for share in part.shares:
        if isinstance(share, LinearShare):
            weights = np.zeros((len(share.offset), n))
            owner = np.repeat(np.arange(len(share.offset)), np.diff(share.indptr))
            np.add.at(weights, (owner, share.columns), np.asarray(share.weights, dtype=np.float64))
            angles.append(np.asarray(share.offset, dtype=np.float64) + weights @ x)
            slopes.append(weights)
            continue
        if isinstance(share, FunctionShare):
            own = share.term.coordinates
            angle, hessian = (derivative_of(share.term, order, x[own], t) for order in (1, 2))
        else:
            own = np.array(share.coordinates)
            angle = np.asarray(share.polynomial.gradient(x), dtype=np.float64)[own]
            hessian = np.asarray(share.polynomial.hessian(x), dtype=np.float64)[np.ix_(own, own)]
        slope = np.zeros((len(own), n))
        slope[:, own] = hessian
        angles.append(np.asarray(angle, dtype=np.float64))
        slopes.append(slope)
    return Jet(forms.T @ np.concatenate(angles), forms.T @ np.concatenate(slopes))


class Samples:
    """The parts at some points: gradients and Hessians once, so that many orders of them can be compared.

    Parameters
    ----------
    algebra : LieAlgebra
        Its bracket {F, G} = (grad F)^T J(x) grad G.
    parts : sequence of Part
        The pieces.
    points : ndarray, shape (k, n)
        Where.
    t : float
        Time, for parts that depend on it.

    Raises
    ------
    TypeError
        If a user function was given without second derivatives.
    """

    def __init__(self, algebra: LieAlgebra, parts: Sequence[Part], points: NDArray[np.float64], t: float = 0.0) -> None:
        jets = [[part_jet(part, x, t) for x in points] for part in parts]
        self._gradients = [np.array([jet.gradient for jet in own]) for own in jets]
        self._hessians = [np.array([jet.hessian for jet in own]) for own in jets]
        self._structure = np.array([algebra.structure_matrix(x) for x in points])
        i, j, k, c = algebra.triples
        order = np.argsort(k, kind="stable")
        self._i, self._j, self._c = i[order], j[order], c[order]
        self._k, self._starts = np.unique(k[order], return_index=True)

    def second_order_term(self, order: Sequence[int]) -> NDArray[np.float64]:
        """Return H2 at the points, where ``X1(h/2) ... Xn(h) ... X1(h/2)`` is the time-h flow of H + h^2 H2 + O(h^4).

        For a pair, A outside and D inside, H2 = -{A, {A, D}}/24 + {D, {D, A}}/12; several parts are nested pairs.

        Parameters
        ----------
        order : sequence of int
            Numbers of the parts, in the order of a forward sweep.

        Returns
        -------
        ndarray, shape (k,)
            The values.
        """
        inside, curved = self._gradients[order[-1]], self._hessians[order[-1]]
        total = np.zeros(len(inside))
        for part in order[-2::-1]:
            outside, bent = self._gradients[part], self._hessians[part]
            bracket = self._bracket_gradient(outside, bent, inside, curved)
            total -= self._product(outside / 24.0 + inside / 12.0, bracket)
            inside, curved = outside + inside, bent + curved
        return total

    def _turned(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("kij,kj->ki", self._structure, u)

    def _product(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("ki,ki->k", u, self._turned(v))

    def _bracket_gradient(self, a: Any, a_bent: Any, d: Any, d_bent: Any) -> NDArray[np.float64]:
        """Return the gradient of {A, D}: A'' J grad D - D'' J grad A + [grad A, grad D], J being linear in x."""
        result = np.einsum("kij,kj->ki", a_bent, self._turned(d)) - np.einsum("kij,kj->ki", d_bent, self._turned(a))
        if len(self._c):
            products = self._c * (a[:, self._i] * d[:, self._j] - a[:, self._j] * d[:, self._i])
            result[:, self._k] += np.add.reduceat(products, self._starts, axis=1)
        return np.asarray(result)


def second_order_term(
    algebra: LieAlgebra, parts: Sequence[Part], points: NDArray[np.float64], t: float = 0.0
) -> NDArray[np.float64]:
    """Return H2 of parts in their order at points; see `Samples`.

    Parameters
    ----------
    algebra : LieAlgebra
        The algebra.
    parts : sequence of Part
        In the order of a forward sweep.
    points : ndarray, shape (k, n)
        Where.
    t : float
        Time.

    Returns
    -------
    ndarray, shape (k,)
        The values.
    """
    return Samples(algebra, parts, points, t).second_order_term(range(len(parts)))
