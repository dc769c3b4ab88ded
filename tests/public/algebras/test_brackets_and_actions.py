"""What the constants define: brackets, J(x), the coadjoint action, ranks; in any kind of number."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from lie_algebras import catalogue, coadjoint_matrices, constants_of, fractions, in_basis, known_casimirs, orthogonal

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)


@pytest.mark.parametrize("name", catalogue())
def test_identities_hold_exactly_in_fractions(name):
    """Of every entry and family: Jacobi, J(x) v = ad*_v x, <x, [u, v]>, and that the action represents brackets."""
    g, rng = catalogue()[name], np.random.default_rng(3)
    u, v, w = (fractions(rng, g.dim) for _ in range(3))
    assert not np.any(g.bracket(u, v) + g.bracket(v, u))
    assert not np.any(g.bracket(g.bracket(u, v), w) + g.bracket(g.bracket(v, w), u) + g.bracket(g.bracket(w, u), v))
    assert not np.any(g.coadjoint(u) @ w - g.structure_matrix(w) @ u)
    assert u @ g.structure_matrix(w) @ v == g.bracket(u, v) @ w  # J_ij(x) = <x, [e_i, e_j]>
    commutator = g.coadjoint(u) @ g.coadjoint(v) - g.coadjoint(v) @ g.coadjoint(u)
    assert not np.any(commutator - g.coadjoint(g.bracket(u, v)))
    uf, vf, wf = (x.astype(float) for x in (u, v, w))
    # sums of at most 2 n products, each within 3 u of the exact one
    bound = 64 * g.dim * U * (1 + np.abs(uf).max() * (1 + np.abs(wf).max()))
    for there, here in (
        (g.structure_matrix(wf), g.structure_matrix(w)),
        (g.coadjoint(uf), g.coadjoint(u)),
        (g.bracket(uf, vf), g.bracket(u, v)),
    ):
        assert np.abs(there - here.astype(float)).max() <= bound


@pytest.mark.parametrize("name", catalogue())
def test_casimirs_and_representations_of_the_catalogue(name):
    g = catalogue()[name]
    rho, c, x = g.representation, constants_of(g), fractions(np.random.default_rng(4), g.dim)
    commutators = np.einsum("iab,jbc->ijac", rho, rho)
    defect = commutators - commutators.transpose(1, 0, 2, 3) - np.einsum("ijk,kab->ijab", c, rho)
    # Constants are multiples of 1/2 below 8 or, of su(n), square roots.
    assert np.abs(defect).max() <= (64 * U * np.abs(rho).max() ** 2 * rho.shape[1] if "su" in name else 0.0)
    assert np.linalg.matrix_rank(rho.reshape(g.dim, -1)) == g.dim
    known = known_casimirs(g)
    gradients = np.array([casimir.gradient(x) for casimir in known.values()])
    assert known and np.linalg.matrix_rank(gradients.astype(float)) == len(known)
    J = np.abs(g.structure_matrix(x) @ gradients.T)
    assert J.max() <= (2**10 * U * g.dim * 50 if "su" in name else 0)


KINDS = {
    "int": lambda rng, n: rng.integers(-9, 10, n),
    "int8": lambda rng, n: rng.integers(-9, 10, n).astype(np.int8),
    "float32": lambda rng, n: (rng.integers(-9, 10, n) / 4).astype(np.float32),
    "float": lambda rng, n: rng.integers(-9, 10, n) / 4,
    "complex": lambda rng, n: (rng.integers(-9, 10, n) + 1j * rng.integers(-9, 10, n)) / 4,
    "fraction": lambda rng, n: np.array([Fraction(int(a), 3) for a in rng.integers(-9, 10, n)], dtype=object),
}
RESULTS = {"complex": np.complex128, "fraction": object}
# Their constants are small multiples of powers of two, so that all products of the numbers above are exact.
DYADIC = [co.algebras.so(4), co.algebras.e(3), co.algebras.A3_7(0.25), co.LieAlgebra([], dim=2)]


def by_constants(g, u, v):
    """[u, v], constant by constant, with exact numbers where both are real."""
    found = [0] * g.dim
    real = not np.iscomplexobj(u) and not np.iscomplexobj(v)
    u, v = ([Fraction(value) for value in w] if real else list(w) for w in (u.tolist(), v.tolist()))
    c = constants_of(g)
    for i, j, k in zip(*np.nonzero(c), strict=True):
        found[k] += (Fraction(c[i, j, k]) if real else c[i, j, k]) * u[i] * v[j]
    return found


@pytest.mark.parametrize("g", DYADIC, ids=lambda g: g.name)
@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_operations_in_each_kind_of_numbers(g, first, second):
    """Brackets and actions on vectors of any two kinds, strided ones and lists, against the sum over the constants."""
    if {first, second} == {"fraction", "complex"}:
        return  # there are no exact complex numbers
    rng = np.random.default_rng(g.dim)
    u, v = (np.repeat(KINDS[kind](rng, g.dim), 2)[::2] for kind in (first, second))
    wanted = next((RESULTS[kind] for kind in (first, second) if kind in RESULTS), np.float64)
    expected = by_constants(g, u, v)
    for found in (g.bracket(u, v), -g.bracket(v, u), g.bracket(u.tolist(), v.tolist())):
        assert found.tolist() == expected and found.dtype == wanted
    if first == second:
        c = np.vectorize(Fraction, otypes=[object])(constants_of(g)) if first != "complex" else constants_of(g)
        exact = np.array([Fraction(value) for value in u.tolist()]) if first != "complex" else u
        for found, form in ((g.structure_matrix(u), "ijk,k->ij"), (g.coadjoint(u), "jik,i->jk")):
            assert found.tolist() == np.einsum(form, c, exact).tolist() and found.dtype == wanted


@pytest.mark.parametrize("name", ["so(5)", "e(3)", "sl(2)", "A3,7"])
def test_multiprecision(name):
    g = co.algebras.get(name, **({"a": 0.3} if name == "A3,7" else {}))
    a, b = np.random.default_rng(1).integers(1, 50, (2, g.dim)).tolist()
    with mpmath.workdps(50):
        x, u = (np.array([mpmath.sqrt(v) for v in w], dtype=object) for w in (a, b))
        assert max(map(abs, g.coadjoint(u) @ x - g.structure_matrix(x) @ u)) < mpmath.mpf(10) ** -46
        assert max(map(abs, g.bracket(u, x) + g.bracket(x, u))) == 0
        assert abs(u @ g.structure_matrix(x) @ u) < mpmath.mpf(10) ** -46


def test_equations_of_bodies():
    """Euler's, those of the heavy top (sign = -1), and Manakov's M' = [M, Omega]."""
    rng, allowed = np.random.default_rng(2), 64 * U
    u, x = rng.standard_normal((2, 3))
    so3 = co.algebras.so(3)
    assert np.abs(so3.structure_matrix(x) @ u - np.cross(u, x)).max() < allowed
    assert np.array_equal(so3.coadjoint(u), [[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
    x, u = rng.standard_normal((2, 6))
    m, p, w, v = x[:3], x[3:], u[:3], u[3:]
    body = np.concatenate([np.cross(m, w) + np.cross(p, v), np.cross(p, w)])
    assert np.abs(-co.algebras.e(3).structure_matrix(x) @ u - body).max() < allowed
    so4 = co.algebras.so(4)
    momentum, velocity = np.tensordot(x, so4.representation, 1), np.tensordot(u, so4.representation, 1)
    body = (momentum @ velocity - velocity @ momentum)[np.triu_indices(4, 1)]
    assert np.abs(-(so4.structure_matrix(x) @ u) - body).max() < allowed


def test_generic_ranks():
    copies = co.algebras.copies
    assert co.algebras.A3_7(2.0).generic_rank() == co.algebras.A3_7(0.1).generic_rank() == 2
    assert co.LieAlgebra([(0, 1, 1, 2.0**-1000)], dim=2).generic_rank() == 2
    assert co.LieAlgebra([], dim=4).generic_rank() == 0
    assert copies(co.algebras.so(3), 20_000).generic_rank() == 40_000 and co.algebras.so(25).generic_rank() == 288
    # One connected block of 5001 rows: e1 acts on all others.
    assert co.LieAlgebra([(0, i, i, float(i)) for i in range(1, 5001)], dim=5001).generic_rank() == 2
    # A block of tiny constants counts as much as a block of large ones: no floating tolerance is involved.
    units = np.diag([2.0**200] * 6 + [2.0**-200] * 6)
    assert co.algebras.change_of_basis(copies(co.algebras.so(4), 2), units).generic_rank() == 8


def test_rounded_constants_are_not_taken_for_exact():
    """In floats, thirds break the Jacobi identity, and the rank of the rounded constants is that of no Lie algebra."""
    thirds = np.eye(10) + np.triu(np.random.default_rng(0).integers(-1, 2, (10, 10)), 1) / 3
    for basis in (thirds, orthogonal(10, 0)):
        assert in_basis(co.algebras.so(5), basis).generic_rank() == 8


@pytest.mark.parametrize("sizes", [(1.0, 1e-12), (1e-12, 1.0), (1e9, 1.0, 1e-9), (2.0**-300, 2.0**300)])
def test_rounded_constants_of_each_summand_have_their_own_size(sizes):
    """Summands in rotated bases, in units of very different sizes, their coordinates mixed with one another."""
    rng = np.random.default_rng(3)
    parts = [co.algebras.so(4), co.algebras.e(3), co.algebras.so(3)][: len(sizes)]
    n = sum(g.dim for g in parts)
    order, begin, rows = rng.permutation(n), 0, []
    for number, (g, size) in enumerate(zip(parts, sizes, strict=True)):
        c = size * constants_of(in_basis(g, orthogonal(g.dim, number)))
        rows += [(*order[[i + begin, j + begin, k + begin]], c[i, j, k]) for i, j, k in np.argwhere(c) if i < j]
        begin += g.dim
    whole = co.LieAlgebra(rows, dim=n)
    assert whole.generic_rank() == sum((4, 4, 2)[: len(sizes)])
    found = whole.casimirs(2)
    assert list(found) == [f"C2_{number + 1}" for number in range(sum((2, 2, 1)[: len(sizes)]))]
    x = rng.standard_normal(n)
    J = whole.structure_matrix(x)
    for casimir in found.values():
        gradient = casimir.gradient(x)
        # The coefficients have errors of some u, divided by the smallest pivots and singular values.
        assert (np.abs(J @ gradient) <= 2.0**-35 * np.abs(J) @ np.abs(gradient)).all()


def test_vectors_and_arrays_are_not_changed():
    g, x = co.algebras.e(3), np.arange(6.0)
    assert np.array_equal(coadjoint_matrices(g)[1], g.coadjoint([0, 1, 0, 0, 0, 0]))
    g.structure_matrix(x), g.coadjoint(x), g.bracket(x, x[::-1])
    assert x.tolist() == list(range(6))
    with pytest.raises(ValueError, match="read-only"):
        g.representation[0] = 1
