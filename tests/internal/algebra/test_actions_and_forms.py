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
