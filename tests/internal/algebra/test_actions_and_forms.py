"""Actions of an algebra by its nonzero entries, and forms that representations keep."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.algebra import representation as module
from coadjoint.algebra.representation import are_rotations, intertwiner, invariant_form
from group_elements import random_element
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

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


catalogue = co.algebras


def coadjoint_matrices(g):
    return np.array([g.coadjoint(row) for row in np.eye(g.dim)])


def residual(rho, form):
    return np.abs(np.einsum("iba,bc->iac", rho, form) + np.einsum("ab,ibc->iac", form, rho)).max()


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_rotations_keep_the_identity(n):
    assert np.array_equal(invariant_form(catalogue.so(n).representation), np.eye(n))


@pytest.mark.parametrize("n", [3, 4, 5])
def test_rotations_in_a_skewed_basis_keep_another_form(n):
    rho = catalogue.so(n).representation
    basis = np.eye(n) + np.triu(np.ones((n, n)), 1)
    form = invariant_form(np.linalg.inv(basis) @ rho @ basis)
    wanted = basis.T @ basis
    assert np.abs(form / form[0, 0] - wanted / wanted[0, 0]).max() < 1e3 * U * np.linalg.cond(wanted)


def test_sl2_keeps_the_area():
    rho = catalogue.sl(2).representation
    form = invariant_form(rho)
    assert np.allclose(form, -form.T, atol=1e-14)
    assert abs(np.linalg.det(form)) > 0.5
    assert residual(rho, form) < 64 * U


@pytest.mark.parametrize("g", [catalogue.e(3), catalogue.heisenberg(1), catalogue.A3_7(2.0)], ids=lambda g: g.name)
def test_affine_representations_keep_no_form(g):
    assert invariant_form(g.representation) is None


@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_the_form_does_not_depend_on_units(scale):
    rho = catalogue.sl(2).representation * np.array([1.0, scale, 1.0])[:, None, None]
    assert np.allclose(invariant_form(rho), invariant_form(catalogue.sl(2).representation), atol=1e-12)


def test_e3_keeps_a_form_in_the_coadjoint_representation():
    """<(m, p), (m', p')> = m.p' + p.m': the Casimir m.p, nonsingular though |p|^2 is not."""
    actions = coadjoint_matrices(catalogue.e(3))
    form = invariant_form(actions)
    assert residual(actions, form) < 1e-14
    assert np.linalg.cond(form) < 1e3


def test_intertwiner_of_so3_and_its_failure_elsewhere():
    g = catalogue.so(3)
    actions = coadjoint_matrices(g)
    t = intertwiner(g.representation, actions)
    assert np.linalg.matrix_rank(t) == 3
    assert np.abs(t @ g.representation - actions @ t).max() < 1e-14
    for h in (catalogue.so(4), catalogue.e(3), catalogue.sl(2)):
        assert intertwiner(h.representation, coadjoint_matrices(h)) is None


@pytest.mark.parametrize("g", [catalogue.so(4), catalogue.sl(2), catalogue.e(3)], ids=lambda g: g.name)
def test_intertwiner_from_a_larger_representation(g):
    """The coadjoint action inside its sum with itself, in a skewed basis."""
    actions = coadjoint_matrices(g)
    n = g.dim
    double = np.zeros((n, 2 * n, 2 * n))
    double[:, :n, :n] = double[:, n:, n:] = actions
    basis = np.eye(2 * n) + np.triu(np.ones((2 * n, 2 * n)), 1)
    rho = np.linalg.inv(basis) @ double @ basis
    t = intertwiner(rho, actions)
    assert t.shape == (n, 2 * n)
    assert np.linalg.matrix_rank(t) == n
    assert np.abs(t @ rho - actions @ t).max() < 1e-10
    assert np.array_equal(t, intertwiner(rho, actions))


def test_intertwiner_refuses_different_lengths():
    with refused(ValueError, "(3, d, d)"):
        intertwiner(catalogue.so(3).representation, coadjoint_matrices(catalogue.so(4)))


def in_drawn_bases(g, seed):
    """Return the representation of an algebra with its elements in another order and vectors in another basis."""
    rng = np.random.default_rng(seed)
    rho = g.representation[rng.permutation(g.dim)]
    d = rho.shape[1]
    basis = np.linalg.qr(rng.standard_normal((d, d)))[0] * rng.uniform(0.5, 2.0, d)
    return np.linalg.inv(basis) @ rho @ basis


@pytest.mark.thinned(2)
@pytest.mark.parametrize("per_fold", [1, 2, 4, 100])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("g", [catalogue.so(4), catalogue.so(5), catalogue.sl(2)], ids=lambda g: g.name)
def test_every_matrix_counts_however_many_are_looked_at_together(monkeypatch, g, seed, per_fold):
    rho = in_drawn_bases(g, seed)
    whole = invariant_form(rho)
    n, d = rho.shape[:2]
    monkeypatch.setattr(module, "REDUCED_ROWS", per_fold * d * d)
    form = invariant_form(rho)
    # The matrices are conditioned below 16; a form of an irreducible representation is unique up to its factor.
    assert residual(rho, form) < 1e-12 and np.abs(form).max() == form.max() == 1.0
    # The larger of two opposite entries of a skew form is decided by round-off.
    np.testing.assert_allclose(form, np.sign(np.vdot(form, whole)) * whole, rtol=0, atol=1e-12)
    t = intertwiner(rho, -rho.transpose(0, 2, 1))
    assert np.linalg.matrix_rank(t) == d and np.abs(t @ rho + rho.transpose(0, 2, 1) @ t).max() < 1e-12
    for k in range(n):
        wrong = rho.copy()
        wrong[k] += 0.5 * np.eye(d)
        assert invariant_form(wrong) is None
        assert intertwiner(rho, wrong) is None and intertwiner(wrong, rho) is None


def test_forms_of_reducible_representations_have_full_rank():
    """Of two copies each carries a form of its own; beside an element that scales one copy, none is left."""
    rho = catalogue.so(3).representation @ np.diag([1.0, 2.0, 3.0])
    n, d = rho.shape[:2]
    double = np.zeros((n, 2 * d, 2 * d))
    double[:, :d, :d] = double[:, d:, d:] = rho
    form = invariant_form(double)
    assert np.linalg.cond(form) < 1e3 and residual(double, form) < 1e-14
    scaled = np.concatenate([double, np.diag([0.0] * d + [1.0] * d)[None]])
    assert invariant_form(scaled) is None


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
def test_a_form_is_kept_up_to_its_threshold(share, kept):
    """diag(1, -1 + s) keeps P where (-1 + 1 + s) P_12 = 0: singular values 2, 2, s, s of the equations for P."""
    off = share * 64 * U * 4
    assert (invariant_form([np.diag([1.0, -1.0 + 2.0 * off])]) is not None) is kept


def test_only_all_rotations_are_told_to_be_rotations():
    """su(3) acts by rotations of six dimensions, but not by all of them."""
    for name in ("so(3)", "so(5)", "su(3)", "e(3)", "sl(2)"):
        rho = catalogue.get(name).representation
        g, all_of_them = random_element(rho, 2), name.startswith("so")
        assert are_rotations(g, rho) is are_rotations(np.stack([np.eye(len(g)), g]), rho) is all_of_them
        reflected = np.diag([-1.0, *np.ones(len(g) - 1)])
        assert not are_rotations(reflected, rho) and not are_rotations(np.stack([g, g @ reflected]), rho)
        assert not are_rotations(g * (1 + 1e-6), rho)
