"""Algebras of matrices: dimensions and ranks by counting, closed brackets, invariant pairings, and what is refused."""

import numpy as np
import pytest

import coadjoint as co
from served import state_of

G = co.MatrixAlgebra
KINDS = [
    G("u", 3), G("su", 3), G("su", 4), G("so", 2), G("so", 5), G("so", 6), G("gl", 3), G("sl", 3), G("sp", 4),
    G("sp", 6), G("gl(C)", 2), G("sl(C)", 3), G("so(C)", 4), G("sp(C)", 4), G("so", 5, 2), G("su", 3, 1), G("u", 4, 2),
    G.sum(G("so", 3), G("su", 2)), G.sum(G("sp", 2), G("gl", 2), G("so", 4, 1)),
]  # fmt: skip


def identity(W):
    return W


def random(g, seed):
    rng = np.random.default_rng(seed)
    return g.projected(rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape))


@pytest.mark.parametrize("g", KINDS, ids=str)
def test_dimension_and_rank_are_those_that_are_counted(g):
    s = co.MatrixSystem(g, identity)
    spanned = s.to_vector(g.projected(s.from_vector(np.eye(s.dim))))
    assert np.linalg.matrix_rank(spanned) == g.dim
    assert np.linalg.matrix_rank(s.structure_matrix(random(g, 1))) == g.generic_rank() == g.dim - g.rank


@pytest.mark.parametrize("g", KINDS, ids=str)
def test_brackets_stay_and_the_pairing_is_invariant(g):
    A, B, C = (random(g, seed) for seed in range(3))
    bracket = g.bracket(A, B)
    size = np.abs(A).max() * np.abs(B).max() * g.N
    assert np.abs(bracket - g.projected(bracket)).max() <= 4 * 2.0**-53 * g.N * size
    left, right = g.pairing(bracket, C), g.pairing(A, g.bracket(B, C))
    assert abs(left - right) <= 64 * 2.0**-53 * g.N * size * np.abs(C).max() * g.N
    assert abs(left) > 1e-3 or g.dim < 3
    assert abs(g.pairing(A, B) - np.sum(np.real(np.conj(g.dual(A)) * B))) <= 64 * 2.0**-53 * size * g.N


@pytest.mark.parametrize("g", KINDS, ids=str)
def test_projections_are_nearest(g):
    rng = np.random.default_rng(3)
    A = rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape) * g.complex
    near = g.projected(A)
    assert np.array_equal(g.projected(near, spared=1e-15), near)
    # What is left stands at right angles to all that the algebra has.
    assert abs(np.vdot(A - near, random(g, 4)).real) <= 64 * 2.0**-53 * g.N**2 * 10
    assert g.projected(np.stack([A, 2 * A])).shape == (2, *g.shape)
    assert np.array_equal(g.read(near), near)


@pytest.mark.parametrize("g", KINDS, ids=str)
def test_members_are_paired_one_by_one(g):
    A, B = (np.stack([random(g, 3 * k + first) for k in range(6)]).reshape(2, 3, *g.shape) for first in (0, 1))
    pairs, brackets, duals = g.pairing(A, B), g.bracket(A, B), g.dual(A)
    assert pairs.shape == (2, 3) and np.isrealobj(pairs)
    for k in np.ndindex(2, 3):
        assert pairs[k] == g.pairing(A[k], B[k]) and np.array_equal(duals[k], g.dual(A[k]))
        # Both are sums of N products; their order may differ.
        size = g.N * np.abs(A[k]).max() * np.abs(B[k]).max()
        assert np.abs(brackets[k] - g.bracket(A[k], B[k])).max() <= 8 * 2.0**-53 * g.N * size


def test_descriptions():
    for g, caption in (
        (G("so", 5, 2), "real and skew, times the signs of 3 and 2"),
        (G("su", 3, 1), "skew-Hermitian, of trace zero, times the signs of 2 and 1"),
        (G("u", 3), "skew-Hermitian"),
        (G.sum(G("so", 3, 1), G("gl", 2)), "block by block of so(2, 1), of gl(2, R), and zero beside"),
    ):
        assert g.description == caption and g.name == str(g)


def test_forms_of_any_signature():
    g, J = G("so", 4, 1), np.diag([1.0, 1.0, 1.0, -1.0])
    W = random(g, 0)
    np.testing.assert_array_equal(W.T @ J + J @ W, np.zeros((4, 4)))
    h, K = G("sp", 4), np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(2))
    V = random(h, 0)
    np.testing.assert_array_equal(V.T @ K + K @ V, np.zeros((4, 4)))
    u, W = G("u", 3, 1), random(G("u", 3, 1), 0)
    np.testing.assert_array_equal(np.conj(W.T) @ np.diag([1.0, 1, -1]) + np.diag([1.0, 1, -1]) @ W, np.zeros((3, 3)))
    assert not u.skew and u.dim == 9 and str(u) == "u(2, 1)"


def test_sums():
    g = G.sum(G.sum(G("so", 3), G("su", 2)), G("gl", 2))
    assert [str(block) for block in g.blocks] == ["so(3)", "su(2)", "gl(2, R)"] and str(g) == "so(3) + su(2) + gl(2, R)"
    assert g.complex and not g.skew and g.N == 7
    W = random(g, 0)
    assert np.all(W[:3, 3:] == 0) and np.all(W[:3, :3].imag == 0) and np.all(W[5:, 5:].imag == 0)
    assert g == G.sum(*g.blocks) and hash(g) == hash(G.sum(*g.blocks))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: G("sp", 5), "must be even"),
        (lambda: G("gl", 4, 1), "no negative signs"),
        (lambda: G("so", 4, 0, (G("so", 2), G("so", 2))), "MatrixAlgebra.sum"),
        (lambda: G.sum(G("so", 3)), "two MatrixAlgebras"),
        (lambda: G("sum", 4, 0, (G("so", 3), G("so", 2))), "5 rows"),
        (lambda: G("so", 3).read(np.ones((3, 3))), "real and skew"),
        (lambda: G("sl", 3).read(np.eye(3)), "trace zero"),
        (lambda: G("sp", 4).read(np.diag([1.0, 0, 0, 0])), r"sp\(4, R\)"),
        (lambda: G("so", 3).read(1j * state_of(co.systems.sphere_euler(3))), "real and skew"),
        (lambda: G.sum(G("so", 3), G("so", 3)).read(np.ones((6, 6))), r"block by block of so\(3\)"),
        (lambda: G("gl", 3).read(np.full((3, 3), np.nan)), "finite"),
        (lambda: G("gl", 3).read(np.eye(4)), "shape"),
        (lambda: G("gl", 3).read("x"), "x0"),
    ],
)
def test_refused(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


@pytest.mark.parametrize("size", [1.0, 1e-30])
def test_a_member_is_measured_by_its_own_size(size):
    skew = np.array([[0.0, 1.0, 2.0], [-1.0, 0.0, 3.0], [-2.0, -3.0, 0.0]])
    members = np.array([skew, size * (skew + 1e-9 * np.eye(3)), skew])
    with pytest.raises(ValueError, match=r"x0\[1\] is not a matrix of so\(3\)"):
        G("so", 3).read(members)
    members[1] = size * skew
    assert np.array_equal(G("so", 3).read(members), members)


@pytest.mark.parametrize("g", [G("so", 3), G("su", 2), G.sum(G("sp", 2), G("so", 3, 1))], ids=str)
@pytest.mark.parametrize("wrong", [(1, 3), (3,), (0, 2, 4)])
def test_the_first_of_several_wrong_members_is_named(g, wrong):
    """With its own size and distance, by the name of the argument; what is read is a copy."""
    members = np.stack([(k + 1.0) * random(g, k) for k in range(5)])
    given = members.copy()
    read = g.read(given)
    given[:] = 7.0
    assert np.array_equal(read, members) and np.array_equal(g.read(members[::-2]), members[::-2])
    assert np.array_equal(g.read(np.repeat(members, 2, axis=2)[:, :, ::2]), members)
    members[list(wrong), 0, 0] += [0.25 * (k + 1) for k in wrong]
    one = members[wrong[0]]
    away, size = np.abs(one - g.projected(one)).max(), np.abs(one).max()
    with pytest.raises(ValueError, match="is not a matrix of") as refused:
        g.read(members, "W")
    assert str(refused.value) == (
        f"W[{wrong[0]}] is not a matrix of {g}: it must be {g.description}, but differs by {away:.2g} where its "
        f"largest entry is {size:.2g}"
    )
    with pytest.raises(ValueError, match=r"^W is not a matrix of"):
        g.read(one, "W")
    for shape in (g.shape[:1], (2, 2, *g.shape), (5, g.N, g.N + 1)):
        with pytest.raises(ValueError, match=rf"^W has the shape .*; it must be .* or \(members, {g.N}, {g.N}\)$"):
            g.read(np.zeros(shape), "W")


@pytest.mark.parametrize("g", [G("so", 3), G("su", 2), G.sum(G("so", 2), G("u", 2)), G("sp(C)", 2)], ids=str)
def test_the_numbers_of_a_matrix_are_named_by_their_places(g):
    s = co.MatrixSystem(g, identity)
    assert len(g.basis) == len(set(g.basis)) == s.dim
    for k, name in enumerate(g.basis):
        i, j = map(int, name.removeprefix("re").removeprefix("im").split(","))
        expected = np.zeros(g.shape, dtype=complex)
        expected[i, j] = 1j if name.startswith("im") else 1.0
        assert np.array_equal(s.from_vector(np.eye(s.dim)[k]), expected)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_the_trace_of_a_member_is_spared_by_its_own_size(order):
    """A mean that is round-off beside a large member is none beside a small one."""
    g = co.MatrixAlgebra("sl", 2)
    members = np.array([np.diag([1.0, -1.0 + 2.0**-40]), 2.0**30 * np.diag([1.0, -1.0 + 2.0**-52])])[order]
    together = g.projected(members, spared=8 * 2.0**-53)
    assert np.array_equal(together, [g.projected(member, spared=8 * 2.0**-53) for member in members])
    assert np.array_equal(
        together != members, np.array([[[True, False], [False, True]], np.zeros((2, 2), bool)])[order]
    )
