"""Structure constants, Casimirs and matrices of Lie algebras, through public names."""

from fractions import Fraction
from functools import cache

import numpy as np

import coadjoint as co

FAMILIES = {
    "e(n)": (2, 3, 4), "gl(n)": (1, 2, 3), "heisenberg(n)": (1, 2, 3), "se(n)": (3,), "sl(n)": (2, 3, 4),
    "so(n)": (2, 3, 4, 5, 6), "su(n)": (2, 3, 4), "u(n)": (1, 2, 3), "sp(2n)": (1, 2),
}  # fmt: skip
INDEFINITE = ((2, 1), (3, 1), (1, 3), (2, 2), (4, 1))


def constants_of(g):
    """c[i, j, k], the component of [e_i, e_j] along e_k."""
    e = np.eye(g.dim)
    return np.array([[g.bracket(u, v) for v in e] for u in e])


def known_casimirs(g):
    """The Casimirs that an algebra was made with, by name."""
    return dict(g.casimirs_known)


def coadjoint_matrices(g):
    return np.array([g.coadjoint(row) for row in np.eye(g.dim)])


def fractions(rng, n):
    """A vector of fractions; with a plain denominator, so that floats of its products are exact."""
    return np.array([Fraction(int(v), 8) for v in rng.integers(-40, 41, n)], dtype=object)


@cache
def catalogue():
    """Every name of the catalogue, families in several sizes, parameters at two values each."""
    found = {}
    for name in co.algebras.names():
        if name in FAMILIES:
            found |= {f"{name} {n}": co.algebras.get(name, n=n) for n in FAMILIES[name]}
        elif name == "so(p,q)":
            found |= {f"so({p},{q})": co.algebras.get(name, p=p, q=q) for p, q in INDEFINITE}
        elif not name.startswith("A"):
            found[name] = co.algebras.get(name)
    return found


def in_basis(g, matrix):
    """The algebra of which rows of a matrix are the basis, from rounded constants."""
    T = np.asarray(matrix, dtype=float)
    back = np.linalg.inv(T)
    return co.LieAlgebra(np.einsum("ai,bj,ijk,kc->abc", T, T, constants_of(g), back))


def orthogonal(n, seed):
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((n, n)))[0]


def whole_change(n, seed):
    """A matrix of whole numbers and determinant one, as fractions."""
    draw = np.random.default_rng(seed).integers(-1, 2, (2, n, n))
    return np.vectorize(Fraction, otypes=[object])(
        (np.tril(draw[0], -1) + np.eye(n, dtype=int)) @ (np.triu(draw[1], 1) + np.eye(n, dtype=int))
    )
