"""Test systems beyond so(3).

Unimodular and non-unimodular algebras, diagonal and full M, permuted axes, a dense change of basis, every kind of
Hamiltonian, dimensions 3, 6 and 15, both signs; each with a state from which the motion is nonlinear and of size one.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

import coadjoint as co

AXES = (2, 0, 1)


class Case(NamedTuple):
    """A system, a state, and the time over which orders are measured."""

    system: co.LiePoissonSystem | co.PoissonSystem
    x0: np.ndarray
    time: float = 1.0


def full_matrix(seed: int, n: int) -> np.ndarray:
    """Return a symmetric positive definite matrix with condition number of a few."""
    B = np.random.default_rng(seed).uniform(-0.5, 0.5, (n, n))
    M = np.diag(np.linspace(0.6, 1.6, n)) + 0.25 * (B + B.T)
    assert np.linalg.eigvalsh(M)[0] > 0.05
    return np.round(M, 3)


def permuted(algebra: co.LieAlgebra, order: tuple[int, ...], casimirs: dict | None = None) -> co.LieAlgebra:
    """Return the algebra in the basis e_order[0], e_order[1], ..."""
    index = {old: new for new, old in enumerate(order)}
    rows = [(index[i], index[j], index[k], c) for i, j, k, c in zip(*algebra.triples, strict=True)]
    rho = algebra.representation[list(order)]
    return co.LieAlgebra(rows, dim=algebra.dim, name=f"{algebra.name} permuted", representation=rho, casimirs=casimirs)


def in_another_basis(algebra: co.LieAlgebra, T: np.ndarray, casimirs: dict) -> co.LieAlgebra:
    """Return the algebra in the basis f_i = sum_a T_ia e_a; T is integer, of determinant one: constants stay exact."""
    n = algebra.dim
    dense = np.array([[algebra.bracket(np.eye(n)[i], np.eye(n)[j]) for j in range(n)] for i in range(n)])
    inverse = np.round(np.linalg.inv(T))
    c = np.einsum("ia,jb,abk,kl->ijl", T, T, dense, inverse)
    rho = np.einsum("ia,abc->ibc", T, algebra.representation)
    return co.LieAlgebra(c, name=f"{algebra.name} in another basis", representation=rho, casimirs=casimirs)


def permuted_polynomial(p: co.Polynomial, order: tuple[int, ...]) -> co.Polynomial:
    return co.Polynomial({tuple(e[i] for i in order): c for e, c in p.monomials.items()})


def substituted_polynomial(p: co.Polynomial, rows: np.ndarray) -> co.Polynomial:
    """Return p with x_a replaced by sum_i rows[a, i] y_i, for integer rows."""
    n = p.dim
    forms = [
        co.Polynomial({tuple(np.eye(n, dtype=int)[i].tolist()): int(v) for i, v in enumerate(row) if v}) for row in rows
    ]
    total = co.Polynomial({}, dim=n)
    for exponents, c in p.monomials.items():
        term = co.Polynomial({(0,) * n: c})
        for form, e in zip(forms, exponents, strict=True):
            for _ in range(e):
                term = term * form
        total = total + term
    return total


def rotation_unlike_jacobi(x):
    """Return a skew matrix that violates the Jacobi identity: w = (x2, x3 + x1^2, x1) is not orthogonal to its curl."""
    return np.array([[0.0, x[0], -x[2] - x[0] * x[0]], [-x[0], 0.0, x[1]], [x[2] + x[0] * x[0], -x[1], 0.0]])


def rotation_unlike_jacobi_derivative(x):
    d = np.zeros((3, 3, 3))
    d[0, 1, 0], d[1, 0, 0] = 1.0, -1.0
    d[0, 2, 2], d[2, 0, 2] = -1.0, 1.0
    d[0, 2, 0], d[2, 0, 0] = -2.0 * x[0], 2.0 * x[0]
    d[1, 2, 1], d[2, 1, 1] = 1.0, -1.0
    return d


def _well(y):
    return 0.5 * y * y + 0.1 * y**4


def _well_slope(y):
    return y + 0.4 * y**3


def _well_curvature(y):
    return 1.0 + 1.2 * y * y


def _wave(y):
    return math.cos(y)


def _wave_slope(y):
    return -math.sin(y)


def _wave_curvature(y):
    return -math.cos(y)


def _field(y):
    return y[0] + 0.5 * y[1] * y[2] + math.exp(0.5 * y[2])


def _field_gradient(y):
    return np.array([1.0, 0.5 * y[2], 0.5 * y[1] + 0.5 * math.exp(0.5 * y[2])])


def _field_hessian(y):
    return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.5, 0.25 * math.exp(0.5 * y[2])]])


def _driven(y, t):
    return 0.5 * y * y + math.sin(3.0 * t) * y


def _driven_slope(y, t):
    return y + math.sin(3.0 * t)


def _driven_curvature(y, t):
    return 1.0 + 0.0 * y * t


@cache
def cases() -> dict[str, Case]:
    """Return the systems with a Lie algebra, by name."""
    so3, so4, e3, sl2 = co.algebras.so(3), co.algebras.so(4), co.algebras.e(3), co.algebras.sl(2)
    turned = permuted(so3, AXES, dict(so3.casimirs_known))
    axes = (4, 1, 3, 0, 5, 2)
    e3_permuted = permuted(e3, axes, {k: permuted_polynomial(p, axes) for k, p in e3.casimirs_known.items()})
    T = np.eye(6)
    T[[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]] = [1, -1, 1, 1, -1]
    T[5] += T[0]
    # <y, f_i> = <x, sum T_ia e_a>: y = T x.
    back = np.round(np.linalg.inv(T)).astype(int)
    so4_basis = in_another_basis(so4, T, {k: substituted_polynomial(p, back) for k, p in so4.casimirs_known.items()})
    body_and_spin = {(2,) + (0,) * 5: 0.5, (0, 2) + (0,) * 4: 0.25, (0, 0, 2) + (0,) * 3: 0.2}
    potential = {(0, 0, 0, 1, 0, 0): 0.75, (0, 0, 0, 0, 3, 0): 0.3, (0, 0, 0, 1, 0, 1): 0.4, (0, 0, 0, 0, 2, 2): 0.2}
    top = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
    six = np.array([1.0, 0.5, -0.4, 0.7, -1.0, 0.3])
    pieces = [((0, 1, 2)[i : i + 1], co.Quadratic(m)) for i, m in enumerate((1.0, 0.5, 0.4))]
    pieces.append(((3, 4, 5), co.Hamiltonian(_field, _field_gradient, _field_hessian)))
    wells = {i: (_well, _well_slope, _well_curvature) for i in (0, 3)} | {
        i: (_wave, _wave_slope, _wave_curvature) for i in (1, 2, 4, 5)
    }
    system = co.LiePoissonSystem
    return {
        "so(3), diagonal": Case(co.systems.paper_rigid_body(), np.array([1.0, 2.0, 0.5]), 2.0),
        "so(3), full, axes turned": Case(
            system(turned, co.Quadratic(full_matrix(1, 3)), sign=-1), np.array([1.0, -1.5, 1.2]), 2.0
        ),
        "A3,7, diagonal": Case(co.systems.paper_a37(2.0, (1.0, 1.5, 0.3)), np.array([0.7, 0.5, 0.6]), 1.0),
        "A3,7, full": Case(
            system(co.algebras.A3_7(1.5), co.Quadratic(full_matrix(2, 3)), sign=-1), np.array([0.7, -0.4, 0.5]), 0.8
        ),
        "sl(2), diagonal": Case(system(sl2, co.Quadratic([1.0, 2.0, 3.0])), np.array([1.0, 0.5, -0.25]), 1.0),
        "sl(2), full": Case(system(sl2, co.Quadratic(full_matrix(3, 3)), sign=-1), np.array([0.8, 0.5, 0.6]), 2.0),
        "so(4), diagonal": Case(system(so4, co.Quadratic([2.0, 0.4, 0.7, 0.3, 0.5, 1.0]), sign=-1), six, 1.0),
        "so(4), full, another basis": Case(system(so4_basis, co.Quadratic(0.4 * full_matrix(4, 6))), six, 0.5),
        "e(3), heavy top": Case(
            system(e3, co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0]), sign=-1),
            top,
            3.0,
        ),
        "e(3), full, axes permuted": Case(system(e3_permuted, co.Quadratic(full_matrix(5, 6))), six, 1.0),
        "e(3), polynomial potential": Case(system(e3, co.Polynomial(body_and_spin | potential), sign=-1), top, 3.0),
        "e(3), split": Case(system(e3, co.SplitHamiltonian(pieces), sign=-1), top, 3.0),
        "sl(2), driven": Case(
            system(sl2, co.Separable({i: (_driven, _driven_slope, _driven_curvature) for i in range(3)}), sign=-1),
            np.array([0.8, 0.5, 0.6]),
        ),
        "so(4), separable": Case(system(so4, co.Separable(wells)), six, 1.0),
    }


@cache
def without_jacobi() -> Case:
    """Return x' = J(x) M x with a skew J that is no Poisson bracket."""
    return Case(
        co.PoissonSystem(
            rotation_unlike_jacobi,
            co.Quadratic(full_matrix(6, 3)),
            derivative=rotation_unlike_jacobi_derivative,
            name="skew without Jacobi",
        ),
        np.array([0.5, 0.7, -0.4]),
    )


@cache
def with_cubic_casimir() -> Case:
    """Return a body in six dimensions, with the Pfaffian of so(6), a sum over the fifteen pairings of six indices."""
    algebra = co.algebras.so(6)
    index = {pair: k for k, pair in enumerate((i, j) for i in range(6) for j in range(i + 1, 6))}

    def pairings(left: list[int]):
        if not left:
            yield []
        for k in range(1, len(left)):
            for rest in pairings(left[1:k] + left[k + 1 :]):
                yield [(left[0], left[k]), *rest]

    monomials = {}
    for pairing in pairings(list(range(6))):
        order = [i for pair in pairing for i in pair]
        crossings = sum(order[a] > order[b] for a in range(6) for b in range(a + 1, 6))
        exponents = tuple(int(k in {index[pair] for pair in pairing}) for k in range(15))
        monomials[exponents] = (-1) ** crossings
    casimirs = {"|x|^2": algebra.casimirs_known["|x|^2"], "Pfaffian": co.Polynomial(monomials)}
    M = np.random.default_rng(5).uniform(0.2, 1.0, 15)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M), sign=-1, casimirs=casimirs)
    return Case(system, np.random.default_rng(6).uniform(-2.0, 2.0, 15))


def three_spins() -> Case:
    """Return three spins with an anisotropic exchange, in a field."""
    M = np.zeros((9, 9))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        for axis, strength in enumerate((1.0, 0.7, 0.4)):
            M[3 * a + axis, 3 * b + axis] = M[3 * b + axis, 3 * a + axis] = strength
    field = np.tile([0.1, 0.0, 0.3], 3)
    x0 = np.array([0.6, 0.0, 0.8, -0.5, 0.7, 0.5, 0.1, -0.9, 0.4])
    return Case(co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 3), co.Quadratic(M, linear=field)), x0)


@cache
def matrices() -> dict[str, Case]:
    """Return systems of matrices, with states as vectors."""
    g, rng = co.MatrixAlgebra, np.random.default_rng(7)

    def case(system: co.MatrixSystem, time: float = 1.0, size: float = 1.0) -> Case:
        W = system.algebra.projected(rng.normal(size=system.shape) + 1j * rng.normal(size=system.shape))
        return Case(system.in_numbers, system.to_vector(size * W / np.abs(W).max()), time)

    masses = np.linspace(1.0, 2.0, 5)
    return {
        "so(5), body": case(co.MatrixSystem(g("so", 5), co.systems.Weights(3.0 / np.add.outer(masses, masses)))),
        "sphere": case(co.systems.sphere_euler(N=3), size=3.0),
        "torus": case(co.systems.torus_euler(N=3), 2.0),
        "gl(3), transposed": case(co.MatrixSystem(g("gl", 3), np.transpose, np.diag([0.3, 0.1, -0.2]), energy_sign=-1)),
        "magnetic sphere": case(co.systems.reduced_mhd(N=3), 2.0),
    }


def all_cases() -> dict[str, Case]:
    return {**cases(), "skew J, no Jacobi identity": without_jacobi(), **matrices()}
