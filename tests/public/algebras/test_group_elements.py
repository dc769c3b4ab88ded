"""Elements of groups are accepted, at the end of runs too; other matrices are refused by what they do not keep."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.algebra.group_elements import TOLERANCE, are_rotations, automorphism_violation, group_element_violation

ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "so(5)": co.algebras.so(5),
    "so(2, 1)": co.algebras.so(2, 1),
    "e(3)": co.algebras.e(3),
    "sl(2)": co.algebras.sl(2),
    "sp(4)": co.algebras.sp(4),
    "su(3)": co.algebras.su(3),
    "heisenberg": co.algebras.heisenberg(2),
}


def element(algebra, seed, size=0.7):
    random = np.random.default_rng(seed)
    g = np.eye(algebra.representation.shape[1])
    for _ in range(3):
        g = g @ expm(np.tensordot(size * random.normal(size=algebra.dim), algebra.representation, axes=1))
    return g


@pytest.mark.parametrize("name", ALGEBRAS)
def test_products_of_exponentials_are_elements(name):
    algebra = ALGEBRAS[name]
    for seed in range(10):
        assert group_element_violation(element(algebra, seed)[None], algebra.representation) is None


@pytest.mark.parametrize("name", ALGEBRAS)
def test_other_matrices_are_not(name):
    """What is looked at is kept by elements to ALLOWED; a departure of ten times that is seen, or one of size one."""
    algebra = ALGEBRAS[name]
    g, random = element(algebra, 3), np.random.default_rng(5)
    assert group_element_violation(2 * g[None], algebra.representation) is not None
    for _ in range(10):
        noise = random.normal(size=g.shape)
        assert group_element_violation((g @ (np.eye(len(g)) + 0.01 * noise))[None], algebra.representation) is not None
        assert group_element_violation((g + 1e-3 * TOLERANCE * noise)[None], algebra.representation) is None


def test_what_is_wrong_is_said():
    rotations, motions = ALGEBRAS["so(3)"].representation, ALGEBRAS["e(3)"].representation
    assert group_element_violation(2 * np.eye(3)[None], rotations).endswith("differs from the unit matrix by 3")
    assert "reflection" in group_element_violation(np.diag([1.0, -1.0, 1.0])[None], rotations)
    assert "moves a vector" in group_element_violation(2 * np.eye(4)[None], motions)
    far = np.eye(4)
    far[:3, 3] = 1e6, 2.0, 3.0
    assert group_element_violation(far[None], motions) is None
    assert "determinant is 8" in group_element_violation((far @ np.diag([2.0, 2.0, 2.0, 1.0]))[None], motions)
    assert "brackets" in group_element_violation(np.diag([2.0, 0.5, 1.0, 1.0])[None], motions)
    turn = np.eye(6)
    turn[:2, :2] = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert "brackets" in group_element_violation(turn[None], ALGEBRAS["su(3)"].representation)


@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("place", [0, 2])
def test_fixed_vectors_of_a_large_element_are_known_to_its_size(far, place):
    """A motion with a large translation: its last row is (0, 0, 0, 1) to ALLOWED times the translation."""
    motions = ALGEBRAS["e(3)"].representation
    g = element(ALGEBRAS["e(3)"], 1)
    g[:3, 3] *= far / np.abs(g[:3, 3]).max()
    # Along a row that the translation does not change, so that the determinant stays 1.
    row = np.cross(g[:3, 3], np.eye(3)[place]) @ g[:3, :3]
    for factor, kept in ((0.2, True), (5.0, False)):
        moved = g.copy()
        moved[3, :3] += factor * TOLERANCE * max(1.0, np.abs(g).max()) * row / np.abs(row).max()
        why = group_element_violation(np.stack([g, moved]), motions)
        assert ("moves a vector" in (why or "")) is not kept


@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(3)", "A4,8", "su(3)"])
def test_matrices_of_the_coadjoint_action_keep_brackets(name):
    algebra = ALGEBRAS.get(name) or co.algebras.get(name)
    random = np.random.default_rng(2)
    K = np.eye(algebra.dim)
    for _ in range(3):
        K = K @ expm(algebra.coadjoint(0.5 * random.normal(size=algebra.dim)))
    for g in (K, np.linalg.inv(K)):
        assert automorphism_violation(g[None], algebra.structure_matrix) is None
    far = K @ np.linalg.matrix_power(expm(algebra.coadjoint(np.ones(algebra.dim) / 4)), 4)
    for factor, kept in ((1e-3 * TOLERANCE, True), (1e3 * TOLERANCE, False)):
        changed = far + factor * np.abs(far).max() * random.normal(size=far.shape)
        assert (automorphism_violation(np.stack([K, changed]), algebra.structure_matrix) is None) == kept
    wrong = K @ (np.eye(algebra.dim) + 0.01 * random.normal(size=K.shape))
    assert "brackets" in automorphism_violation(wrong[None], algebra.structure_matrix)
    assert automorphism_violation(np.stack([K, wrong]), algebra.structure_matrix) is not None


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0]])
def test_determinants_are_those_that_some_generator_changes(order):
    """One generator with a trace is enough, wherever it is; of generators without, the determinant stays 1."""
    general, affine = co.algebras.gl(2), co.algebras.subalgebra(co.algebras.gl(2), ["e1", "e2"])
    for algebra in (co.algebras.change_of_basis(general, np.eye(4)[order]), affine, general):
        for seed in range(3):
            g = element(algebra, seed)
            assert (
                abs(np.linalg.det(g) - 1.0) > 1e-3 and group_element_violation(g[None], algebra.representation) is None
            )
            turned = group_element_violation((g @ np.diag([-1.0, 1.0]))[None], algebra.representation)
            assert turned is not None and turned.endswith("that of every element is positive")
    sheared = element(ALGEBRAS["sl(2)"], 0) @ np.diag([3.0, 1.0])
    assert group_element_violation(sheared[None], ALGEBRAS["sl(2)"].representation) == (
        "its determinant is 3; that of every element is 1"
    )


def test_only_all_rotations_are_told_to_be_rotations():
    """su(3) acts by rotations of six dimensions, but not by all of them."""
    for name, all_of_them in (("so(3)", True), ("so(5)", True), ("su(3)", False), ("e(3)", False), ("sl(2)", False)):
        g, rho = element(ALGEBRAS[name], 2), ALGEBRAS[name].representation
        assert are_rotations(g, rho) is are_rotations(np.stack([np.eye(len(g)), g]), rho) is all_of_them
        assert are_rotations(np.eye(len(g)), rho) is all_of_them
        reflected = np.diag([-1.0, *np.ones(len(g) - 1)])
        assert not are_rotations(reflected, rho) and not are_rotations(np.stack([g, g @ reflected]), rho)
        assert not are_rotations(g * (1 + 1e-6), rho)


@pytest.mark.parametrize("kind", [True, "coadjoint"])
def test_a_run_goes_on_from_the_attitude_of_another(kind):
    top = co.systems.heavy_top()
    first = co.integrate(top, (0.3, 0.2, 3.0, 0.6, 0.0, 0.8), (0, 50), 0.05, co.Splitting(order=4), attitude=kind)
    ready = co.prepare(top, co.Splitting(order=4), 0.05, attitude=kind)
    went = ready.run(first.x[-1], (50, 51), attitude=first.attitude[-1])
    assert np.array_equal(went.attitude[0], first.attitude[-1])
    for wrong in (2 * first.attitude[-1], first.attitude[-1].T):
        with pytest.raises(ValueError, match="attitude is no element of the group of heavy_top: it "):
            ready.run(first.x[-1], (50, 51), attitude=wrong)


def test_one_of_many_is_refused():
    body, X = co.systems.rigid_body(), np.tile((0.3, 1.0, 0.2), (3, 1))
    each = np.tile(np.eye(3), (3, 1, 1))
    co.integrate(body, X, (0, 1), 0.1, attitude=each)
    each[2, 0, 0] = -1.0
    with pytest.raises(ValueError, match="reflection"):
        co.integrate(body, X, (0, 1), 0.1, attitude=each)
