"""The six systems: each as coadjoint takes it and as its textbook writes it, eight initial states, and a span.

Constants that are combined are dyadic, so that both forms have exactly the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

import coadjoint as co

STATES = 8
SEED = 1993
SPINS = 8
PARTICLES = 8
PRINCIPAL = (1.0, 2.0, 3.0, 5.0)

Field = Callable[[Sequence[Any]], list[Any]]


@dataclass(frozen=True, eq=False)
class Problem:
    """x' = field(x) from t = 0 to `span`; `field` takes and returns sequences of any number type."""

    name: str
    system: co.LiePoissonSystem
    field: Field
    states: np.ndarray  # (STATES, n)
    span: float
    rate: float  # about the largest frequency, radians per unit of time

    def check(self) -> None:
        """Compare the two forms at every initial state, up to the rounding of some ten operations."""
        for x in self.states:
            ours, textbook = self.system.vector_field(x), np.array(self.field(list(x)))
            if not np.allclose(ours, textbook, rtol=0.0, atol=2.0**-49 * float(x @ x + np.linalg.norm(x))):
                raise SystemExit(f"{self.name}: the system and the textbook's equations differ at x = {x.tolist()}")


def cross(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def weighted_sum(terms: Sequence[tuple[float, Any]]) -> Any:
    """Add weight * value without a product by 1, a sum with 0, or a negative weight beyond the first.

    Of no weights at all there is one product with 0, which every kind of number understands.
    """
    total: Any = None
    for weight, value in sorted(((w, v) for w, v in terms if w), key=lambda term: term[0] < 0):
        size = abs(weight) if total is not None else weight
        value = value if size == 1.0 else size * value
        total = value if total is None else total + value if weight > 0 else total - value
    return 0.0 * terms[0][1] if total is None else total


def scattered(*shape: int) -> np.ndarray:
    return np.random.default_rng(SEED).normal(size=(STATES, *shape))


def on_spheres(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rigid_body() -> Problem:
    """Euler's equations, H = (x1^2 + x2^2 / 2 + x3^2 / 4) / 2, momenta of length 1."""
    m = (1.0, 0.5, 0.25)

    def field(x: Sequence[Any]) -> list[Any]:
        return [(m[2] - m[1]) * x[1] * x[2], (m[0] - m[2]) * x[2] * x[0], (m[1] - m[0]) * x[0] * x[1]]

    # A quadratic form: no body has the moments 1, 2 and 4.
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(m), sign=-1)
    return Problem("rigid body", system, field, on_spheres(scattered(3)), 2000.0, 0.75)


def top(name: str, m: Sequence[float], weight: Sequence[float], span: float) -> Problem:
    """L' = L x w + G x c, G' = G x w on e(3)*, w = m L, |G| = 1; c is the weight times the centre of mass."""

    def field(x: Sequence[Any]) -> list[Any]:
        L, G = x[:3], x[3:]
        turned = []
        for j, k in ((1, 2), (2, 0), (0, 1)):
            terms = [(m[k] - m[j], L[j] * L[k]), (weight[k], G[j]), (-weight[j], G[k])]
            turned.append(weighted_sum(terms))
        return [*turned, *cross(G, [m[i] * L[i] for i in range(3)])]

    energy = co.Quadratic([*m, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, *weight])
    system = co.LiePoissonSystem(co.algebras.get("e(3)"), energy, sign=-1, name=name)
    drawn = scattered(2, 3)
    states = np.concatenate([drawn[:, 0], on_spheres(drawn[:, 1])], axis=1)
    return Problem(name, system, field, states, span, 2.5)


def heavy_top() -> Problem:
    """A heavy top without symmetry, inertia (1, 4/3, 2), its centre of mass off every axis: not integrable."""
    return top("heavy top", (1.0, 0.75, 0.5), (0.125, 0.0, 0.25), 400.0)


def kovalevskaya_top() -> Problem:
    """Inertia (2, 2, 1) and the centre of mass in the plane of equal moments: Kovalevskaya's integrable case."""
    return top("Kovalevskaya top", (0.5, 0.5, 1.0), (1.0, 0.0, 0.0), 400.0)


def four_dimensional_body() -> Problem:
    """The free body of four dimensions, w_ab = 4 L_ab / (J_a + J_b), in axes that are not its principal ones."""
    planes = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    unit = np.eye(4)
    turned, _ = np.linalg.qr(np.random.default_rng(SEED).normal(size=(4, 4)))
    basis = [turned.T @ (np.outer(unit[a], unit[b]) - np.outer(unit[b], unit[a])) @ turned for a, b in planes]
    M = np.zeros((6, 6))
    for row, A in enumerate(basis):
        for column, B in enumerate(basis):
            M[row, column] = sum(A[a, b] * B[a, b] * 4.0 / (PRINCIPAL[a] + PRINCIPAL[b]) for a, b in planes)
    M = 0.5 * (M + M.T)
    algebra = co.algebras.so(4)
    i, j, k, c = algebra.triples

    def field(x: Sequence[Any]) -> list[Any]:
        u = [weighted_sum([(float(M[a, b]), x[b]) for b in range(6)]) for a in range(6)]
        terms: list[list[tuple[float, Any]]] = [[] for _ in range(6)]
        for a, b, d, value in zip(i.tolist(), j.tolist(), k.tolist(), c.tolist(), strict=True):
            terms[a].append((value, x[d] * u[b]))
            terms[b].append((-value, x[d] * u[a]))
        return [weighted_sum(row) for row in terms]

    system = co.LiePoissonSystem(algebra, co.Quadratic(M), name="so(4), full M")
    return Problem("so(4), full M", system, field, on_spheres(scattered(6)), 1000.0, 0.75)


def toda_ring() -> Problem:
    """Toda's ring in Flaschka's variables: a_i' = a_i (b_(i+1) - b_i), b_i' = 2 a_i^2 - 2 a_(i-1)^2.

    [b_i, a_i] = a_i, [b_(i+1), a_i] = -a_i: a solvable algebra; Casimirs are the sum of b and the product of a.
    """
    n = PARTICLES

    def field(x: Sequence[Any]) -> list[Any]:
        a, b = x[:n], x[n:]
        squares = [2.0 * (a[i] * a[i]) for i in range(n)]
        return [
            *(a[i] * (b[(i + 1) % n] - b[i]) for i in range(n)),
            *(squares[i] - squares[i - 1] for i in range(n)),
        ]

    brackets = {}
    for i in range(n):
        brackets[n + i, i] = {i: 1.0}
        brackets[n + (i + 1) % n, i] = {i: -1.0}
    momenta = {tuple(int(place == n + i) for place in range(2 * n)): 1.0 for i in range(n)}
    lengths = {(1,) * n + (0,) * n: 1.0}
    system = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(2 * n, brackets, name="Toda ring"),
        co.Quadratic([2.0] * n + [1.0] * n),
        casimirs={"sum of b": co.Polynomial(momenta), "product of a": co.Polynomial(lengths)},
        name="Toda ring",
    )
    drawn = scattered(2, n)
    b = 0.5 * (drawn[:, 1] - drawn[:, 1].mean(axis=1, keepdims=True))
    return Problem("Toda ring", system, field, np.concatenate([0.5 * np.exp(0.5 * drawn[:, 0]), b], axis=1), 200.0, 5.0)


def spin_ring() -> Problem:
    """Heisenberg's classical spins on a ring, S_i' = S_i x (S_(i-1) + S_(i+1)), |S_i| = 1.

    All are some 30 degrees from one direction, waves that interact: in all directions errors grow as exp(0.4 t).
    """
    n = SPINS

    def field(x: Sequence[Any]) -> list[Any]:
        spins = [x[3 * i : 3 * i + 3] for i in range(n)]
        moved: list[Any] = []
        for i in range(n):
            before, after = spins[i - 1], spins[(i + 1) % n]
            moved += cross(spins[i], [before[k] + after[k] for k in range(3)])
        return moved

    neighbours = np.roll(np.eye(n), 1, axis=0) + np.roll(np.eye(n), -1, axis=0)
    energy = co.Quadratic(sparse.csr_array(np.kron(neighbours, np.eye(3))))
    system = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), n), energy, sign=-1, name="spin ring")
    states = on_spheres(0.3 * scattered(n, 3) + np.array([0.0, 0.0, 1.0])).reshape(STATES, 3 * n)
    return Problem("spin ring", system, field, states, 100.0, 4.0)


def problems() -> dict[str, Problem]:
    """Return the systems by their short names, both forms compared."""
    found = {
        "body": rigid_body(),
        "top": heavy_top(),
        "kovalevskaya": kovalevskaya_top(),
        "so4": four_dimensional_body(),
        "toda": toda_ring(),
        "spins": spin_ring(),
    }
    for problem in found.values():
        problem.check()
    return found
