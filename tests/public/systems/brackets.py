"""Poisson brackets at rational points, which vanish exactly, and integrals checked by them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

import coadjoint as co

U = 2.0**-53


def exact(F: Any) -> co.Polynomial:
    """Return an invariant or a Hamiltonian as a polynomial whose coefficients are fractions."""
    P = F.to_polynomial() if hasattr(F, "to_polynomial") else getattr(F, "polynomial", F)
    return co.Polynomial({e: Fraction(c) for e, c in P.monomials.items()}, dim=P.dim)


def rational_points(n: int, count: int = 2, seed: int = 1) -> np.ndarray:
    """Return points with small fractions as coordinates, none of them zero."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(1, 12, (count, n)) * rng.choice([-1, 1], (count, n))
    return np.array([[Fraction(int(v), 7) for v in row] for row in drawn], dtype=object)


def structure(system: Any, x: np.ndarray) -> np.ndarray:
    """Return J(x), which is linear, in exact numbers."""
    columns = [system.structure_matrix(unit) for unit in np.eye(len(x))]
    to_fractions = np.vectorize(Fraction, otypes=[object])
    return sum(value * to_fractions(column) for value, column in zip(x, columns, strict=True))


def bracket(system: Any, F: Any, G: Any, x: np.ndarray) -> Any:
    """Return {F, G} at a rational point, up to the sign of the system: zero at several for a polynomial identity."""
    left, right = (np.asarray(exact(function).gradient(x), dtype=object) for function in (F, G))
    return left @ structure(system, x) @ right


def assert_integrals(system: Any, names: list[str], rounded: bool = False) -> int:
    """Check names, brackets with H, and that none is a constant; return how many functions are independent.

    These are the energy, the Casimirs and the integrals. `rounded`: coefficients are, by u of them.
    """
    assert list(system.integrals) == names
    x = np.cos(np.arange(1.0, system.dim + 1.0))
    known = [system.hamiltonian.gradient(x), *(C.gradient(x) for C in system.casimirs.values())]
    for F in system.integrals.values():
        for point in rational_points(system.dim):
            assert abs(bracket(system, F, system.hamiltonian, point)) <= (64 * U if rounded else 0)
        assert np.linalg.matrix_rank([*known, F.gradient(x)], tol=1e-9) >= len(system.casimirs) + 1
    return int(np.linalg.matrix_rank([*known, *(F.gradient(x) for F in system.integrals.values())], tol=1e-9))
