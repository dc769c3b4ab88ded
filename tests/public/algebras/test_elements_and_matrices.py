"""Algebras whose elements are matrices, and elements of groups as initial attitudes: both sides of what is accepted."""

from contextlib import nullcontext

import numpy as np
import pytest
from lie_algebras import coadjoint_matrices

import coadjoint as co
from group_elements import random_element
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

G = co.MatrixAlgebra
KINDS = [
    G("u", 3), G("su", 3), G("so", 2), G("so", 5), G("gl", 3), G("sl", 3), G("sp", 4),
    G("gl(C)", 2), G("sl(C)", 3), G("so(C)", 4), G("sp(C)", 4), G("so", 5, 2), G("su", 3, 1), G("u", 4, 2),
    G.sum(G("so", 3), G("su", 2)), G.sum(G("sp", 2), G("gl", 2), G("so", 4, 1)),
]  # fmt: skip
each_kind = pytest.mark.parametrize("g", KINDS, ids=str)


def identity(W):
    return W


def random(g, seed):
    rng = np.random.default_rng(seed)
    return g.projected(rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape))


@each_kind
def test_dimension_and_rank_are_those_that_are_counted(g):
    s = co.MatrixSystem(g, identity)
    assert np.linalg.matrix_rank(s.to_vector(g.projected(s.from_vector(np.eye(s.dim))))) == g.dim
    assert np.linalg.matrix_rank(s.structure_matrix(random(g, 1))) == g.generic_rank() == g.dim - g.rank


@each_kind
def test_brackets_stay_and_the_pairing_is_invariant(g):
    A, B, C = (random(g, seed) for seed in range(3))
    bracket = g.bracket(A, B)
    size = np.abs(A).max() * np.abs(B).max() * g.N
    assert np.abs(bracket - (A @ B - B @ A)).max() <= 8 * U * g.N * size
    assert np.abs(bracket - g.projected(bracket)).max() <= 4 * U * g.N * size
    left, right = g.pairing(bracket, C), g.pairing(A, g.bracket(B, C))
    assert abs(left - right) <= 64 * U * g.N * size * np.abs(C).max() * g.N
    assert abs(left) > 1e-3 or g.dim < 3
    assert abs(g.pairing(A, B) - np.sum(np.real(np.conj(g.dual(A)) * B))) <= 64 * U * size * g.N


@each_kind
def test_projections_are_nearest(g):
    rng = np.random.default_rng(3)
    A = rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape) * g.complex
    near = g.projected(A)
    assert np.array_equal(g.projected(near, spared=1e-15), near)
    # What is left stands at right angles to all that the algebra has.
    assert abs(np.vdot(A - near, random(g, 4)).real) <= 64 * U * g.N**2 * 10
    assert g.projected(np.stack([A, 2 * A])).shape == (2, *g.shape)


@each_kind
def test_members_are_paired_one_by_one(g):
    A, B = (np.stack([random(g, 3 * k + first) for k in range(6)]).reshape(2, 3, *g.shape) for first in (0, 1))
    pairs, brackets, duals = g.pairing(A, B), g.bracket(A, B), g.dual(A)
    assert pairs.shape == (2, 3) and np.isrealobj(pairs)
    for k in np.ndindex(2, 3):
        assert pairs[k] == g.pairing(A[k], B[k]) and np.array_equal(duals[k], g.dual(A[k]))
        # Both are sums of N products; their order may differ.
        size = g.N * np.abs(A[k]).max() * np.abs(B[k]).max()
        assert np.abs(brackets[k] - g.bracket(A[k], B[k])).max() <= 8 * U * g.N * size


def test_forms_of_any_signature():
    for g, form, adjoint in (
        (G("so", 4, 1), np.diag([1.0, 1.0, 1.0, -1.0]), np.transpose),
        (G("sp", 4), np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(2)), np.transpose),
        (G("u", 3, 1), np.diag([1.0, 1.0, -1.0]), lambda W: np.conj(W.T)),
    ):
        W = random(g, 0)
        np.testing.assert_array_equal(adjoint(W) @ form + form @ W, np.zeros(g.shape))
    assert G("u", 3, 1).dim == 9 and str(G("u", 3, 1)) == "u(2, 1)"


def test_sums():
    g = G.sum(G.sum(G("so", 3), G("su", 2)), G("gl", 2))
    assert [str(block) for block in g.blocks] == ["so(3)", "su(2)", "gl(2, R)"] and str(g) == "so(3) + su(2) + gl(2, R)"
    assert g.complex and g.N == 7
    W = random(g, 0)
    assert np.all(W[:3, 3:] == 0) and np.all(W[:3, :3].imag == 0) and np.all(W[5:, 5:].imag == 0)
    assert g == G.sum(*g.blocks) and hash(g) == hash(G.sum(*g.blocks))


def run(g, W):
    """A run from a state, without motion: what is saved first."""
    return co.integrate(co.MatrixSystem(g, identity), W, (0.0, 2.0**-10), 2.0**-10, co.IsospectralGauss()).x[0]


@pytest.mark.parametrize("size", [1.0, 1e-30])
def test_a_member_is_measured_by_its_own_size(size):
    skew = np.array([[0.0, 1.0, 2.0], [-1.0, 0.0, 3.0], [-2.0, -3.0, 0.0]])
    members = np.array([skew, size * (skew + 1e-9 * np.eye(3)), skew])
    with refused(ValueError, "x0[1]", "so(3)"):
        run(G("so", 3), members)
    members[1] = size * skew
    assert np.array_equal(run(G("so", 3), members), members)


@pytest.mark.parametrize(("share", "accepted"), [(0.5, True), (2.0, False)])
def test_membership_at_its_threshold(share, accepted):
    """64 u N; the nearest skew matrix takes half of what one entry is off."""
    W = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -1, 0]])
    W[0, 2] += share * 2 * 4 * 64 * U
    with nullcontext() if accepted else refused(ValueError, "x0", "so(4)"):
        run(G("so", 4), W)


@pytest.mark.parametrize(("share", "left"), [(0.5, True), (2.0, False)])
def test_a_trace_that_is_round_off_is_left(share, left):
    """A mean of the diagonal up to 8 u of the largest entry; of each member by its own size."""
    W = 1j * (np.diag([1.0, -1.0]) + share * 8 * U * np.eye(2)) / 2.0
    assert bool(np.trace(run(G("su", 2), W))) is left
    g = G("sl", 2)
    members = np.array([np.diag([1.0, -1.0 + 2.0**-40]), 2.0**30 * np.diag([1.0, -1.0 + 2.0**-52])])
    for order in (slice(None), slice(None, None, -1)):
        together = g.projected(members[order], spared=8 * U)
        assert np.array_equal(together, [g.projected(member, spared=8 * U) for member in members[order]])
        changed = np.array([[[True, False], [False, True]], np.zeros((2, 2), bool)])[order]
        assert np.array_equal(together != members[order], changed)


TOLERANCE = 2.0**-26
NAMES = ("so(3)", "so(5)", "so(2,1)", "e(3)", "sl(2)", "sp(4)", "su(3)", "heisenberg(2)", "gl(2)")
ALGEBRAS = {name: co.algebras.get(name) for name in NAMES}
ALGEBRAS["affine"] = co.algebras.subalgebra(ALGEBRAS["gl(2)"], ["e1", "e2"])
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def start(algebra, *attitudes, kind=True):
    """Start runs of which nothing moves from attitudes, (d, d), one for each member."""
    n = algebra.dim
    still = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(n)))
    x0 = np.ones((len(attitudes), n))
    ready = co.prepare(still, co.Splitting(), 0.1, attitude=kind)
    return ready.run(x0 if len(attitudes) > 1 else x0[0], (0, 0.1), attitude=np.squeeze(np.stack(attitudes)))


def is_accepted(algebra, *attitudes, kind=True):
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
        assert is_accepted(algebra, g) and is_accepted(algebra, g + 1e-3 * TOLERANCE * noise, g)
        if name not in ("gl(2)", "affine"):
            assert not is_accepted(algebra, 2 * g)
            assert not is_accepted(algebra, g @ (np.eye(len(g)) + 0.01 * noise))
            assert not is_accepted(algebra, g, g @ (np.eye(len(g)) + 0.01 * noise))
        else:  # elements have any positive determinant
            assert abs(np.linalg.det(g) - 1.0) > 1e-3
            with refused(ValueError, "determinant", "positive"):
                start(algebra, g @ np.diag([-1.0, 1.0]))


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
def test_thresholds(share, kept):
    """Rotations, fixed vectors and determinants to 2^-26, on both sides."""
    off = share * TOLERANCE
    turned, fixed = TURN.copy(), np.eye(4)
    turned[0] += off * TURN[1]  # g^T g - 1 has entries of this size
    fixed[3, 3] += off
    assert is_accepted(ALGEBRAS["so(3)"], turned) is kept
    assert is_accepted(ALGEBRAS["e(3)"], fixed) is kept
    assert is_accepted(ALGEBRAS["sl(2)"], np.diag([1.0 + off, 1.0])) is kept


@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("place", [0, 2])
def test_fixed_vectors_of_a_large_element_are_known_to_its_size(far, place):
    """A motion with a large translation: its last row is (0, 0, 0, 1) to the tolerance times the translation."""
    motions = ALGEBRAS["e(3)"]
    g = random_element(motions.representation, 1, size=0.7)
    g[:3, 3] *= far / np.abs(g[:3, 3]).max()
    # Along a row that the translation does not change, so that the determinant stays 1.
    row = np.cross(g[:3, 3], np.eye(3)[place]) @ g[:3, :3]
    assert is_accepted(motions, g)
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
        assert is_accepted(algebra, changed, kind="coadjoint") is kept
        assert is_accepted(algebra, K, changed, kind="coadjoint") is kept
    assert is_accepted(algebra, np.linalg.inv(K), kind="coadjoint")
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
