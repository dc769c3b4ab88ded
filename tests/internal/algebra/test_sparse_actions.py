"""Actions of an algebra by its nonzero entries, and which elements commute."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

ALGEBRAS = [
    co.algebras.so(4),
    co.algebras.e(3),
    co.algebras.sl(2),
    co.algebras.heisenberg(2),
    co.algebras.A3_7(0.25),
    co.LieAlgebra([], dim=2),
]
each_algebra = pytest.mark.parametrize("g", ALGEBRAS, ids=lambda g: g.name)


@each_algebra
@pytest.mark.parametrize("kind", [float, Fraction])
def test_sparse_entries_are_the_nonzero_entries_of_the_matrix(g, kind):
    drawn = np.random.default_rng(g.dim).integers(-3, 4, g.dim).tolist()
    vector = np.array([kind(v) / 4 for v in drawn], dtype=float if kind is float else object)
    matrix = g.coadjoint(vector)
    rows, columns, values = g.coadjoint_entries(vector)
    assert np.array_equal(np.argwhere(matrix != 0), np.stack([rows, columns], axis=1))
    assert np.array_equal(values, matrix[rows, columns])
    chosen = {i: value for i, value in enumerate(vector) if value}
    backward = {np.int64(i): vector[i] for i in reversed(range(g.dim))}  # with zeros, in descending order
    outward = dict(sorted(chosen.items(), key=lambda entry: abs(2 * entry[0] - g.dim)))
    for mapping in (chosen, backward, outward):
        for one, other in zip(g.coadjoint_entries(mapping), (rows, columns, values), strict=True):
            assert np.array_equal(one, other)


@each_algebra
@pytest.mark.parametrize("kind", [int, np.int8, np.float32, float, complex])
def test_the_operator_acts_on_each_kind_of_numbers(g, kind):
    rng = np.random.default_rng(7)
    x, v = rng.integers(-9, 10, g.dim) / 4, np.repeat(rng.integers(-9, 10, g.dim), 2)[::2].astype(kind)
    J, operator = g.structure_matrix(x), g.structure_operator(x)
    assert np.array_equal(operator @ v, J @ v) and np.array_equal(operator.T @ v, -J @ v)
    assert np.array_equal(operator.H @ v, -J @ v) and np.array_equal(operator.rmatvec(v), -J @ v)
    assert np.array_equal(operator @ np.stack([v, 2 * v], axis=1), np.stack([J @ v, 2 * J @ v], axis=1))
    assert (operator @ v).dtype == (J @ v).dtype and operator.shape == J.shape


@each_algebra
def test_commuting_and_neighbours(g):
    indptr, indices = g.neighbours()
    basis = np.eye(g.dim)
    for i in range(g.dim):
        expected = [j for j in range(g.dim) if g.bracket(basis[i], basis[j]).any()]
        assert indices[indptr[i] : indptr[i + 1]].tolist() == expected
        assert [j for j in range(g.dim) if not g.commuting(i, j)] == expected


def test_constants_are_sorted_unique_nonzero_and_read_only():
    g = co.LieAlgebra([(3, 1, 0, 2.0), (1, 2, 0, 0.0), (0, 2, 3, 0.0), (1, 3, 0, -2.0)], dim=4)
    assert [column.tolist() for column in g.triples] == [[1], [3], [0], [-2.0]]
    assert [column.dtype for column in g.triples] == [np.int64] * 3 + [np.float64]
    for column in (*g.triples, *g.neighbours()):
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1


def test_a_lattice_of_spins_is_sparse():
    lattice = co.algebras.copies(co.algebras.so(3), 10**5)
    assert lattice.dim == lattice.triples.c.size == 3 * 10**5
    assert lattice.representation is None and lattice.basis[-1] == "e3[100000]"
    assert lattice.neighbours()[1].size == 6 * 10**5
    x, v = np.random.default_rng(8).standard_normal((2, 10**5, 3))
    product = lattice.structure_operator(x.ravel()) @ v.ravel()
    allowed = 4 * 2.0**-53 * np.abs(x).max() * np.abs(v).max()
    assert np.abs(product.reshape(-1, 3) - np.cross(v, x)).max() <= allowed
    assert co.algebras.so(60).triples.c.size == 3 * (60 * 59 * 58 // 6)
    assert co.algebras.heisenberg(10_000).triples.c.size == 10_000


def test_wrong_arguments_are_refused():
    g = co.algebras.so(4)
    for call in (g.structure_operator, g.coadjoint_entries):
        with refused(ValueError, "(6,)", "(5,)"):
            call(np.zeros(5))
    for wrong in (np.array([Fraction(1)] * 6), 1j * np.arange(6)):
        with refused(TypeError, "real floats"):
            g.structure_operator(wrong)
    for wrong in (-1, 6, 1.0):
        with refused(ValueError, "index of u", "0 to 5", wrong):
            g.coadjoint_entries({0: 2.0, wrong: 1.0})
        for pair in ((0, wrong), (wrong, 0)):
            with refused(ValueError, "basis element", "0 to 5", wrong):
                g.commuting(*pair)
    with refused(TypeError, "u is"):
        g.coadjoint_entries({5: "a"})
