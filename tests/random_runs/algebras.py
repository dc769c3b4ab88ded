"""Random algebras: catalogue, families, nilpotent and solvable algebras, and changes of basis."""

from __future__ import annotations

import re
from functools import cache

import numpy as np

import coadjoint as co
from catalogue_cases import EXAMPLES

FAMILIES = {
    "so(n)": (3, 8),
    "se(n)": (2, 5),
    "gl(n)": (2, 4),
    "sl(n)": (2, 4),
    "su(n)": (2, 4),
    "u(n)": (1, 4),
    "heisenberg(n)": (1, 5),
}


@cache
def parameters_of(name: str) -> list[str]:
    """Return the names of the parameters of an algebra, from the messages that ask for them."""
    given: dict[str, float] = {}
    while True:
        try:
            co.algebras.get(name, **given)
        except ValueError as refusal:
            missing = re.search(r"needs the parameter '(\w+)'", str(refusal))
            if missing:
                given[missing[1]] = 0.5
                continue
        return list(given)


def low_dimensional(rng: np.random.Generator) -> co.LieAlgebra:
    """Return an algebra of dimension 2 to 5, with valid parameters."""
    names = [name for name in co.algebras.names() if name.startswith("A")]
    name = names[rng.integers(len(names))]
    while True:
        values = {p: float(np.round(rng.uniform(-1, 1), 2)) for p in EXAMPLES.get(name, {})}
        if "eps" in values:
            values["eps"] = float(rng.choice([-1, 1]))
        try:
            return co.algebras.get(name, **values)
        except ValueError:
            continue  # out of range: drawn again


def nilpotent(rng: np.random.Generator) -> co.LieAlgebra:
    """Return a two-step nilpotent algebra, whose brackets are random sums of central elements."""
    a, b = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    constants = rng.integers(-3, 4, (a, a, b)) * (rng.random((a, a, b)) < 0.5)
    rows = [(i, j, a + k, float(constants[i, j, k])) for i, j, k in np.argwhere(constants) if i < j]
    return co.LieAlgebra([tuple(map(int, row[:3])) + (row[3],) for row in rows], dim=a + b, name="nilpotent")


def solvable(rng: np.random.Generator) -> co.LieAlgebra:
    """Return an algebra of one element that acts on commuting ones by a random matrix."""
    n = int(rng.integers(2, 6))
    matrix = rng.integers(-2, 3, (n, n))
    rows = [(0, 1 + int(i), 1 + int(j), float(matrix[i, j])) for i, j in np.argwhere(matrix)]
    return co.LieAlgebra(rows, dim=n + 1, name="solvable")


def another_basis(rng: np.random.Generator, algebra: co.LieAlgebra) -> co.LieAlgebra:
    """Return the algebra in a random integer basis, permuted."""
    n = algebra.dim
    basis = np.eye(n, dtype=int)
    for _ in range(int(rng.integers(1, 2 * n))):
        i, j = rng.integers(n, size=2)
        if i != j and abs(basis).max() < 4:
            basis[i] += int(rng.choice([-1, 1])) * basis[j]
    return co.algebras.change_of_basis(algebra, basis[rng.permutation(n)])


def some_algebra(rng: np.random.Generator) -> co.LieAlgebra:
    """Return a random algebra of at most 60 dimensions."""
    kind = rng.random()
    if kind < 0.3:
        algebra = low_dimensional(rng)
    elif kind < 0.4:
        algebra = nilpotent(rng)
    elif kind < 0.5:
        algebra = solvable(rng)
    elif kind < 0.6:
        algebra = co.algebras.copies(co.algebras.get(str(rng.choice(["so(3)", "e(3)"]))), int(rng.integers(2, 10)))
    elif kind < 0.65:
        algebra = co.algebras.direct_sum(low_dimensional(rng), co.algebras.so(3))
    elif kind < 0.7:
        algebra = co.algebras.get("so(p,q)", p=int(rng.integers(1, 4)), q=int(rng.integers(2, 4)))
    elif kind < 0.73:
        algebra = co.algebras.get("sp(4)")
    else:
        name = str(rng.choice(list(FAMILIES), p=[0.3, 0.25, 0.08, 0.1, 0.12, 0.05, 0.1]))
        algebra = co.algebras.get(name, n=int(rng.integers(*FAMILIES[name])))
    return another_basis(rng, algebra) if algebra.dim <= 12 and rng.random() < 0.25 else algebra
