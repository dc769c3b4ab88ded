"""Hamiltonians shared by several tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import coadjoint as co


def polynomial(n: int, degree: int, seed: int | np.random.Generator) -> co.Polynomial:
    """Return a polynomial of n coordinates with all squares, and some monomials of every degree up to the given one."""
    rng = np.random.default_rng(seed)
    monomials = {tuple(2 * (k == i) for k in range(n)): 0.5 + 0.125 * i for i in range(n)}
    for d in range(1, degree + 1):
        for _ in range(3):
            exponents = np.bincount(rng.integers(0, n, d), minlength=n)
            monomials[tuple(exponents.tolist())] = float(np.round(rng.uniform(-0.25, 0.25), 3))
    return co.Polynomial(monomials)


def pulsed(rate: float) -> tuple[Callable[[Any, Any], Any], ...]:
    """Return ``cos(y) (1 + sin(rate t))`` and its first two derivatives by y."""
    return (
        lambda y, t: np.cos(y) * (1.0 + np.sin(rate * t)),
        lambda y, t: -np.sin(y) * (1.0 + np.sin(rate * t)),
        lambda y, t: -np.cos(y) * (1.0 + np.sin(rate * t)),
    )
