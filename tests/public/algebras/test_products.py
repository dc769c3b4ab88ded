"""Direct sums, copies, semidirect products, other bases, subalgebras, quotients: exact, and refused by name."""

from fractions import Fraction

import numpy as np
import pytest
from lie_algebras import constants_of, known_casimirs
from scipy.linalg import block_diag

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

algebras = co.algebras
change_of_basis, copies, direct_sum = algebras.change_of_basis, algebras.copies, algebras.direct_sum
e, get, gl, heisenberg, quotient = algebras.e, algebras.get, algebras.gl, algebras.heisenberg, algebras.quotient
semidirect, sl, so, subalgebra = algebras.semidirect, algebras.sl, algebras.so, algebras.subalgebra


def rational(rng, n):
    return np.array([Fraction(int(v), 7) for v in rng.integers(-40, 41, n)], dtype=object)


def assert_casimirs(g):
    x = rational(np.random.default_rng(6), g.dim)
    for casimir in known_casimirs(g).values():
        if isinstance(casimir, co.Polynomial):
            assert not np.any(g.structure_matrix(x) @ casimir.gradient(x))
        else:
            slope, J = casimir.gradient(x.astype(float)), g.structure_matrix(x.astype(float))
            assert np.abs(J @ slope).max() <= 2**8 * U * np.abs(J).max() * np.abs(slope).max() * g.dim


def test_direct_sum():
    parts = [so(3), get("A4,6", a=2, b=0.5), heisenberg(1)]
    g, x = direct_sum(*parts), rational(np.random.default_rng(7), 10)
    assert (g.dim, g.name) == (10, "so(3) + A4_6(a=2, b=0.5) + heisenberg(1)")
    assert g.basis[:4] == ("e1[1]", "e2[1]", "e3[1]", "e1[2]") and g.basis[-1] == "z[3]"
    assert direct_sum(so(3), heisenberg(1)).basis == ("e1", "e2", "e3", "q1", "p1", "z")
    pieces = np.split(x, [3, 7])
    J = block_diag(*(part.structure_matrix(piece) for part, piece in zip(parts, pieces, strict=True)))
    assert np.array_equal(g.structure_matrix(x), J)
    actions = [part.representation for part in parts]
    for k, (m, i) in enumerate((m, i) for m, part in enumerate(parts) for i in range(part.dim)):
        wanted = block_diag(*(rho[i] if n == m else 0.0 * rho[0] for n, rho in enumerate(actions)))
        assert np.array_equal(g.representation[k], wanted)
    names = [f"{name} [{m + 1}]" for m, part in enumerate(parts) for name in known_casimirs(part)]
    assert list(known_casimirs(g)) == names and len(names) == 4
    assert_casimirs(g)
    angle, alone = known_casimirs(g)[names[2]], known_casimirs(parts[1])["log|x1| - a*atan2(x3, x2)"]
    point = np.linspace(0.5, 1.5, 10)
    assert angle(point) == alone(point[3:7]) and angle.period == alone.period
    assert direct_sum(so(3)) == so(3)
    assert direct_sum(so(3), so(3).from_brackets(2, {(0, 1): {0: 1.0}})).representation is None


def test_user_functions_are_not_carried_over():
    own = co.LieAlgebra([(0, 1, 0, 1.0)], dim=3, casimirs={"x3": co.Invariant(lambda x: x[2])})
    assert set(known_casimirs(direct_sum(own, so(3)))) == {"|x|^2 [2]"}
    assert not known_casimirs(change_of_basis(own, np.eye(3)))


def test_copies_are_a_direct_sum():
    for g in (so(3), get("A3,7", a=0.5), e(2)):
        many, summed = copies(g, 4), direct_sum(g, g, g, g)
        assert many == summed and many.basis == summed.basis
        assert list(known_casimirs(many)) == list(known_casimirs(summed))
        assert np.array_equal(many.representation, summed.representation)
        assert_casimirs(many)
    assert copies(so(3), 1).basis == ("e1[1]", "e2[1]", "e3[1]")


def test_semidirect():
    assert semidirect(so(3)) == e(3) and semidirect(so(4)) == e(4)
    assert np.array_equal(semidirect(so(3)).representation, e(3).representation)
    plane = semidirect(sl(2))  # the one of dimension 5 that is not solvable, in another basis
    assert (plane.dim, plane.dim - plane.generic_rank()) == (5, 1)
    assert change_of_basis(plane, np.diag([1, 2, 1, 1, 1])) == get("A5,40")
    assert semidirect(heisenberg(1)).basis == ("q1", "p1", "z", "v1", "v2", "v3")
    turning = [[[0, -1, 0], [1, 0, 0], [0, 0, 0]]]  # the oscillator: a rotation of (q, p), a derivation of Heisenberg
    oscillator = semidirect(co.LieAlgebra([], dim=1), turning, ideal=heisenberg(1))
    assert oscillator.basis == ("e1", "q1", "p1", "z") and oscillator.representation is None
    renamed = change_of_basis(oscillator, [[0, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0]])
    assert renamed == get("A4,10")
    nested = semidirect(so(3), np.zeros((3, 3, 3)), ideal=so(3))
    assert nested.basis[0] == "e1[1]" and nested == direct_sum(so(3), so(3))


def test_change_of_basis_is_exact_where_it_can_be():
    T = [[1, 1, 0], [0, 1, Fraction(1, 2)], [0, 0, -2.0]]
    g = change_of_basis(so(3), T, basis=("a", "b", "c"))
    assert g.basis == ("a", "b", "c") and g.name == "so(3) in another basis"
    assert_casimirs(g)
    inverse = [[1, -1, Fraction(-1, 4)], [0, 1, Fraction(1, 4)], [0, 0, Fraction(-1, 2)]]
    back = change_of_basis(g, inverse)
    assert back == so(3) and known_casimirs(back) == known_casimirs(so(3))
    assert np.array_equal(back.representation, so(3).representation)
    rounded = change_of_basis(so(3), [[3, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert known_casimirs(rounded)["|x|^2"].monomials[2, 0, 0] == 1 / 9


def test_subalgebras():
    inside = subalgebra(so(4), ["e1", "e2", "e4"], basis=("a", "b", "c"))
    assert inside.basis == ("a", "b", "c") and inside.representation.shape == (3, 4, 4)
    assert subalgebra(e(3), ["e1", "e2", "e3"]) == so(3)
    diagonal = subalgebra(direct_sum(so(3), so(3)), np.hstack([np.eye(3), np.eye(3)]))
    assert diagonal == so(3)
    borel = subalgebra(gl(2), [[1, 0, 0, 0], [0, 1, 0, 0]])
    assert borel == get("A2,1")


def test_quotients():
    rotations = quotient(e(3), ["e4", "e5", "e6"])
    assert rotations == so(3) and rotations.basis == ("e1", "e2", "e3") and rotations.representation is None
    assert not known_casimirs(rotations)  # m.p and |p|^2 vanish where p = 0
    assert quotient(heisenberg(2), ["z"]) == co.LieAlgebra([], dim=4)
    trace = [[1, 0, 0, 0, 1, 0, 0, 0, 1]]
    simple = quotient(gl(3), trace)  # sl(3), on matrices modulo the identity
    assert simple.dim == 8 and simple.generic_rank() == 6 and simple.representation is None
    assert_casimirs(simple)
    assert "quadratic" in known_casimirs(simple) and "trace" not in known_casimirs(simple)
    first = quotient(direct_sum(so(3), so(4)), [np.eye(9)[k] for k in range(3, 9)])
    assert first == so(3) and known_casimirs(first)["|x|^2 [1]"] == known_casimirs(so(3))["|x|^2"]
    acting = co.LieAlgebra(
        [(0, 1, 1, 1.0)], dim=3, representation=[[[1, 0], [0, 0]], [[0, 1], [0, 0]], [[0, 0], [0, 0]]]
    )
    assert quotient(acting, ["e3"]).representation.shape == (2, 2, 2)
    lattice = quotient(copies(so(3), 1000), ["e1[1]", "e2[1]", "e3[1]"])
    assert lattice == copies(so(3), 999)


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("mixed", [False, True])
def test_a_quotient_is_what_remains(place, mixed):
    """By one summand of three whose coordinates are interleaved, given by names or by other vectors that span it."""
    parts = [so(3), e(2), get("A3,7", a=0.5)]
    whole = direct_sum(*parts)
    order = [0, 3, 6, 7, 4, 1, 2, 8, 5]  # number in the sum of each element of the basis
    owner = np.array([k // 3 for k in order])
    acting = np.array(whole.representation)
    acting[3 * place : 3 * place + 3] = 0.0
    moved = change_of_basis(whole, np.eye(9)[order])
    g = co.LieAlgebra(
        constants_of(moved),
        basis=[f"{'abc'[k // 3]}{k % 3}" for k in order],
        representation=acting[order],
        casimirs=known_casimirs(moved),
    )
    kept, gone = np.flatnonzero(owner != place), np.flatnonzero(owner == place)
    ideal = [g.basis[k] for k in gone]
    if mixed:
        ideal = np.array([[1, 2, 0], [0, 1, -1], [3, 0, 1]]) @ np.eye(9, dtype=int)[gone]
    rest = quotient(g, ideal)
    assert rest.basis == tuple(g.basis[k] for k in kept) and rest.name is None
    assert np.array_equal(rest.representation, g.representation[kept])
    u, v, y = (rational(np.random.default_rng(seed), 6) for seed in range(3))
    lifted = np.zeros((3, 9), dtype=object)
    lifted[:, kept] = u, v, y
    assert np.array_equal(rest.bracket(u, v), g.bracket(*lifted[:2])[kept])
    polynomials = {name for name, c in known_casimirs(g).items() if isinstance(c, co.Polynomial)}
    assert set(known_casimirs(rest)) == {name for name in polynomials if not name.endswith(f"[{place + 1}]")}
    for name, casimir in known_casimirs(rest).items():
        assert casimir(y) == known_casimirs(g)[name](lifted[2])
    inside = subalgebra(g, [g.basis[k] for k in kept])
    assert inside == rest and inside.basis == rest.basis and np.array_equal(inside.representation, acting[order][kept])
    assert not known_casimirs(inside)


def test_names_of_what_is_made():
    """Of algebras with names and without; each number in a name is that of the summand, or of the dimension."""
    plain = co.LieAlgebra([(0, 1, 1, 1.0)], dim=2, representation=np.array([[[1, 0], [0, 0]], [[0, 1], [0, 0]]]))
    named = co.LieAlgebra(constants_of(plain), basis=("p1", "v1"), name="line", representation=plain.representation)
    assert direct_sum(so(3), plain, named, plain).name == "so(3) + g2 + line + g4"
    assert (copies(plain, 3).name, copies(named, 3).name) == ("3 g", "3 line")
    assert (semidirect(sl(2)).name, semidirect(so(4)).name) == ("sl(2) ⋉ R^2", "so(4) ⋉ R^4")
    assert (semidirect(plain).name, semidirect(named).name) == ("g ⋉ R^2", "line ⋉ R^2")
    assert semidirect(plain).basis == ("e1", "e2", "p1", "p2") and semidirect(named).basis == ("p1", "v1", "w1", "w2")
    still = np.zeros((2, 3, 3))
    assert semidirect(plain, still, ideal=heisenberg(1)).name == "g ⋉ heisenberg(1)"
    assert semidirect(named, np.zeros((2, 2, 2)), ideal=plain).name == "line ⋉ h"
    assert semidirect(plain, still, ideal=so(3)).basis == ("e1[1]", "e2[1]", "e1[2]", "e2[2]", "e3[2]")
    for made in (change_of_basis(plain, np.eye(2)), subalgebra(plain, ["e2"]), quotient(plain, ["e2"])):
        assert made.name is None
    assert subalgebra(named, ["v1"]).name == "subalgebra of line" and quotient(named, ["v1"]).name == "line / ideal"
    assert subalgebra(named, ["v1"]).basis == ("v1",) and quotient(named, ["v1"]).basis == ("p1",)
    assert subalgebra(named, [[0, 1]]).basis == change_of_basis(named, np.eye(2)).basis[:1] == ("e1",)


@pytest.mark.parametrize(
    ("build", "error", "named"),
    [
        (lambda: direct_sum(), ValueError, ["direct sum", "at least one"]),
        (lambda: semidirect(get("A4,8")), ValueError, ["representation"]),
        (lambda: semidirect(so(3), np.ones((3, 2, 2))), ValueError, ["representation", "commutator"]),
        (lambda: semidirect(so(3), None, heisenberg(2)), ValueError, ["ideal", "5", "3"]),
        (lambda: semidirect(so(3), None, heisenberg(1)), ValueError, ["Jacobi"]),
        (lambda: change_of_basis(so(3), np.eye(3)[:2]), ValueError, ["3", "2"]),
        (lambda: change_of_basis(so(3), np.ones((3, 3))), ValueError, ["1"]),
        (lambda: subalgebra(so(3), ["e1", "e2"]), ValueError, ["vectors 0 and 1"]),
        (lambda: subalgebra(so(3), ["e1", "e4"]), ValueError, ["'e4'"]),
        (lambda: subalgebra(so(3), [[1, 0, "a"]]), TypeError, ["component 2", "vector 0"]),
        (lambda: quotient(e(3), ["e1"]), ValueError, ["ideal", "e2", "vector 0"]),
        (lambda: quotient(so(3), np.eye(3)), ValueError, ["ideal"]),
        (lambda: copies(so(3), 0), ValueError, ["count", "0"]),
    ],
)
def test_refusals(build, error, named):
    with refused(error, *named):
        build()
