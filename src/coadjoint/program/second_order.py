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

    def __add__(self, other: Any) -> Jet:
        return Jet(self.gradient + other.gradient, self.hessian + other.hessian)


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


def second_order_term(
    algebra: LieAlgebra, parts: Sequence[Part], points: NDArray[np.float64], t: float = 0.0
) -> NDArray[np.float64]:
    """Return H2 at points, where ``X1(h/2) ... Xn(h) ... X1(h/2)`` is the time-h flow of H + h^2 H2 + O(h^4).

    For a pair, A outside and D inside, H2 = -{A, {A, D}}/24 + {D, {D, A}}/12; several parts are nested pairs.

    Parameters
    ----------
    algebra : LieAlgebra
        Its bracket {F, G} = (grad F)^T J(x) grad G.
    parts : sequence of Part
        In the order of a forward sweep.
    points : ndarray, shape (k, n)
        Where.
    t : float
        Time, for parts that depend on it.

    Returns
    -------
    ndarray, shape (k,)
        The values.

    Raises
    ------
    TypeError
        If a user function was given without second derivatives.
    """
    return np.array([_at(algebra, [part_jet(part, x, t) for part in parts], x) for x in points])


def _at(algebra: LieAlgebra, jets: Sequence[Jet], x: NDArray[np.float64]) -> float:
    J = algebra.structure_matrix(x)
    inside, total = jets[-1], 0.0
    for outside in jets[-2::-1]:
        bracket = _bracket_gradient(algebra, J, outside, inside)  # of {A, D}
        total += -outside.gradient @ J @ bracket / 24.0 - inside.gradient @ J @ bracket / 12.0
        inside = outside + inside
    return float(total)


def _bracket_gradient(algebra: LieAlgebra, J: NDArray[Any], a: Jet, d: Jet) -> NDArray[np.float64]:
    """Return the gradient of {A, D}: A'' J grad D - D'' J grad A + [grad A, grad D], J being linear in x."""
    first = a.hessian @ (J @ d.gradient) - d.hessian @ (J @ a.gradient)
    return np.asarray(first + algebra.bracket(a.gradient, d.gradient))
