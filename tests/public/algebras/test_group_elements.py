"""Initial attitudes: elements of groups are accepted, at the end of runs too; other matrices are refused."""

import numpy as np
import pytest
from lie_algebras import coadjoint_matrices

import coadjoint as co
from group_elements import random_element
from refusals import refused

pytestmark = pytest.mark.thinned(1)

TOLERANCE = 2.0**-26
ALGEBRAS = {
    "so(3)": co.algebras.so(3),
    "so(5)": co.algebras.so(5),
    "so(2, 1)": co.algebras.so(2, 1),
    "e(3)": co.algebras.e(3),
    "sl(2)": co.algebras.sl(2),
    "sp(4)": co.algebras.sp(4),
    "su(3)": co.algebras.su(3),
    "heisenberg": co.algebras.heisenberg(2),
    "gl(2)": co.algebras.gl(2),
    "affine": co.algebras.subalgebra(co.algebras.gl(2), ["e1", "e2"]),
}
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def start(algebra, *attitudes, kind=True):
    """Start runs of which nothing moves from attitudes, (d, d), one for each member."""
    n = algebra.dim
    still = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(n)))
    x0 = np.ones((len(attitudes), n))
    ready = co.prepare(still, co.Splitting(), 0.1, attitude=kind)
    return ready.run(x0 if len(attitudes) > 1 else x0[0], (0, 0.1), attitude=np.squeeze(np.stack(attitudes)))


def accepted(algebra, *attitudes, kind=True):
    try:
        found = start(algebra, *attitudes, kind=kind)
    except ValueError as reason:
        assert "attitude" in str(reason)
        return False
    return np.array_equal(found.attitude[0], np.squeeze(np.stack(attitudes)))


@pytest.mark.parametrize("name", ALGEBRAS)
def test_products_of_exponentials_are_elements_and_other_matrices_are_not(name):
    """A departure of a thousandth of the tolerance is round-off of a long run; one of a hundredth is refused."""
    algebra = ALGEBRAS[name]
    random = np.random.default_rng(5)
    for seed in range(3):
        g = random_element(algebra.representation, seed, size=0.7)
        noise = random.normal(size=g.shape)
        assert accepted(algebra, g) and accepted(algebra, g + 1e-3 * TOLERANCE * noise, g)
        if name not in ("gl(2)", "affine"):
            assert not accepted(algebra, 2 * g)
            assert not accepted(algebra, g @ (np.eye(len(g)) + 0.01 * noise))
            assert not accepted(algebra, g, g @ (np.eye(len(g)) + 0.01 * noise))
        else:  # elements have any positive determinant
            assert abs(np.linalg.det(g) - 1.0) > 1e-3
            with refused(ValueError, "determinant", "positive"):
                start(algebra, g @ np.diag([-1.0, 1.0]))


def test_what_is_wrong_is_said():
    far, turn = np.eye(4), np.eye(6)
    far[:3, 3] = 1e6, 2.0, 3.0
    turn[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    assert accepted(ALGEBRAS["e(3)"], far)
    for name, g, named in (
        ("so(3)", 2 * np.eye(3), ["orthogonal", "3"]),
        ("so(3)", np.diag([1.0, -1.0, 1.0]), ["reflection"]),
        ("e(3)", 2 * np.eye(4), ["moves a vector"]),
        ("e(3)", far @ np.diag([2.0, 2.0, 2.0, 1.0]), ["determinant", "8"]),
        ("e(3)", np.diag([2.0, 0.5, 1.0, 1.0]), ["brackets"]),
        ("sl(2)", np.diag([3.0, 1.0]), ["determinant", "3", "1"]),
        ("su(3)", turn, ["brackets"]),
    ):
        with refused(ValueError, "attitude", *named):
            start(ALGEBRAS[name], g)


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
def test_thresholds(share, kept):
    """Rotations, fixed vectors and determinants to 2^-26, on both sides."""
    off = share * TOLERANCE
    turned, fixed = TURN.copy(), np.eye(4)
    turned[0] += off * TURN[1]  # g^T g - 1 has entries of this size
    fixed[3, 3] += off
    assert accepted(ALGEBRAS["so(3)"], turned) is kept
    assert accepted(ALGEBRAS["e(3)"], fixed) is kept
    assert accepted(ALGEBRAS["sl(2)"], np.diag([1.0 + off, 1.0])) is kept


@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("place", [0, 2])
def test_fixed_vectors_of_a_large_element_are_known_to_its_size(far, place):
    """A motion with a large translation: its last row is (0, 0, 0, 1) to the tolerance times the translation."""
    motions = ALGEBRAS["e(3)"]
    g = random_element(motions.representation, 1, size=0.7)
    g[:3, 3] *= far / np.abs(g[:3, 3]).max()
    # Along a row that the translation does not change, so that the determinant stays 1.
    row = np.cross(g[:3, 3], np.eye(3)[place]) @ g[:3, :3]
    assert accepted(motions, g)
    g[3, :3] += 5.0 * TOLERANCE * max(1.0, np.abs(g).max()) * row / np.abs(row).max()
    with refused(ValueError, "moves a vector"):
        start(motions, g)


@pytest.mark.parametrize("name", ["so(3)", "sl(2)", "e(3)", "A4,8", "su(3)"])
def test_matrices_of_the_coadjoint_action_keep_brackets(name):
    algebra = ALGEBRAS.get(name) or co.algebras.get(name)
    random = np.random.default_rng(2)
    K = random_element(coadjoint_matrices(algebra), 2)
    for factor, kept in ((0.0, True), (1e-3 * TOLERANCE, True), (1e3 * TOLERANCE, False)):
        changed = K + factor * np.abs(K).max() * random.normal(size=K.shape)
        assert accepted(algebra, changed, kind="coadjoint") is kept
        assert accepted(algebra, K, changed, kind="coadjoint") is kept
    assert accepted(algebra, np.linalg.inv(K), kind="coadjoint")
    with refused(ValueError, "attitude", "brackets"):
        start(algebra, K @ (np.eye(algebra.dim) + 0.01 * random.normal(size=K.shape)), kind="coadjoint")


@pytest.mark.parametrize("kind", [True, "coadjoint"])
def test_a_run_goes_on_from_the_attitude_of_another(kind):
    top = co.systems.heavy_top()
    first = co.integrate(top, (0.3, 0.2, 3.0, 0.6, 0.0, 0.8), (0, 50), 0.05, co.Splitting(order=4), attitude=kind)
    ready = co.prepare(top, co.Splitting(order=4), 0.05, attitude=kind)
    went = ready.run(first.x[-1], (50, 51), attitude=first.attitude[-1])
    assert np.array_equal(went.attitude[0], first.attitude[-1])
    for wrong in (2 * first.attitude[-1], first.attitude[-1].T):
        with refused(ValueError, "attitude", "heavy_top"):
            ready.run(first.x[-1], (50, 51), attitude=wrong)
