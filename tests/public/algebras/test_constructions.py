"""Algebras from matrices and from other algebras: exact, in floats, at thresholds."""

from contextlib import nullcontext
from fractions import Fraction

import numpy as np
import pytest
from lie_algebras import coadjoint_matrices, constants_of, fractions, known_casimirs
from scipy.linalg import block_diag

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)

algebras = co.algebras
change_of_basis, copies, direct_sum = algebras.change_of_basis, algebras.copies, algebras.direct_sum
e, get, gl, heisenberg, quotient = algebras.e, algebras.get, algebras.gl, algebras.heisenberg, algebras.quotient
semidirect, sl, so, subalgebra = algebras.semidirect, algebras.sl, algebras.so, algebras.subalgebra


def assert_casimirs(g):
    x = fractions(np.random.default_rng(6), g.dim)
    for casimir in known_casimirs(g).values():
        if isinstance(casimir, co.Polynomial):
            assert not np.any(g.structure_matrix(x) @ casimir.gradient(x))
        else:
            slope, J = casimir.gradient(x.astype(float)), g.structure_matrix(x.astype(float))
            assert np.abs(J @ slope).max() <= 2**8 * U * np.abs(J).max() * np.abs(slope).max() * g.dim


def test_direct_sum():
    parts = [so(3), get("A4,6", a=2, b=0.5), heisenberg(1)]
    g, x = direct_sum(*parts), fractions(np.random.default_rng(7), 10)
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
    u, v, y = (fractions(np.random.default_rng(seed), 6) for seed in range(3))
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


RNG = np.random.default_rng(5)


def gell_mann():
    """The eight matrices, as written: lambda_8 has floats of 1/sqrt(3)."""
    matrices = np.zeros((8, 3, 3), dtype=complex)
    for k, (a, b) in ((0, (0, 1)), (3, (0, 2)), (5, (1, 2))):
        matrices[k, a, b] = matrices[k, b, a] = 1
        matrices[k + 1, a, b], matrices[k + 1, b, a] = -1j, 1j
    matrices[2], matrices[7] = np.diag([1, -1, 0]), np.diag([1, 1, -2]) / np.sqrt(3)
    return matrices


def spin(twice):
    """Spin matrices of any spin: square roots of several integers."""
    m = np.arange(twice, -twice - 1, -2) / 2
    plus = np.diag(np.sqrt(twice / 2 * (twice / 2 + 1) - m[1:] * (m[1:] + 1)), 1)
    return np.array([(plus + plus.T) / 2, (plus - plus.T) / 2j, np.diag(m)])


@pytest.mark.parametrize(
    "name", ["so(3)", "so(5)", "so(3,1)", "e(3)", "sl(3)", "sp(4)", "su(3)", "gl(3)", "heisenberg(2)", "A3,8"]
)
def test_matrices_of_known_algebras_give_their_constants(name):
    known = co.algebras.get(name)
    g = co.LieAlgebra.from_matrices(known.representation, name=name)
    assert g == known and g.name == name
    assert np.array_equal(g.representation, known.representation)


def test_gell_mann_gives_the_published_constants():
    """f_123 = 1, f_147 = f_165 = f_246 = f_257 = f_345 = f_376 = 1/2, f_458 = f_678 = sqrt(3)/2, each rounded once."""
    g = co.LieAlgebra.from_matrices(-0.5j * gell_mann())
    root = float.fromhex("0x1.bb67ae8584caap-1")  # sqrt(3)/2 to nearest, from 40 digits
    published = {(1, 2, 3): 1.0, (4, 5, 8): root, (6, 7, 8): root}
    published |= dict.fromkeys([(1, 4, 7), (1, 6, 5), (2, 4, 6), (2, 5, 7), (3, 4, 5), (3, 7, 6)], 0.5)
    f = np.zeros((8, 8, 8))
    for (i, j, k), value in published.items():
        for a, b, c in ((i, j, k), (j, k, i), (k, i, j)):
            f[a - 1, b - 1, c - 1], f[b - 1, a - 1, c - 1] = value, -value
    assert np.array_equal(constants_of(g), f)
    assert set(g.casimirs(3)) == {"C2", "C3"} and g.generic_rank() == 6
    assert g.representation.shape == (8, 6, 6)
    assert np.array_equal(g.representation[4, :3, :3], (-0.5j * gell_mann()[4]).real)
    assert np.array_equal(g.representation[4, 3:, :3], (-0.5j * gell_mann()[4]).imag)


@pytest.mark.parametrize("twice", [1, 2, 3, 4, 5, 8])
def test_spins_give_so3_exactly(twice):
    """Spin 5/2 has the roots of 2 and 5, spin 4 those of 2, 5 and 7: products of all of them occur."""
    assert co.LieAlgebra.from_matrices(-1j * spin(twice)) == co.algebras.so(3)


def test_fractions_are_exact():
    third = Fraction(1, 3)
    g = co.LieAlgebra.from_matrices([[[third, 0], [0, 0]], [[0, Fraction(2, 7)], [0, 0]]], basis=("d", "n"))
    assert g.bracket([1, 0], [0, 1]).tolist() == [0.0, 1 / 3] and g.basis == ("d", "n")
    # The float nearest to 1/3 stands for 1/3 as well.
    assert co.LieAlgebra.from_matrices([[[1 / 3, 0], [0, 0]], [[0, 0.1], [0, 0]]]) == g


@pytest.mark.parametrize("scale", [1.0, 1e-200, 1e150])
@pytest.mark.parametrize("name", ["so(4)", "e(3)", "sl(3)", "A4,9"])
def test_random_bases_by_least_squares(name, scale):
    """Against the exact change of basis: round-off of the matrices, times the condition of the basis."""
    known = co.algebras.get(name, **({"b": 0.5} if name == "A4,9" else {}))
    rho = known.representation if known.representation is not None else coadjoint_matrices(known)
    T = RNG.normal(size=(known.dim,) * 2)
    found = constants_of(co.LieAlgebra.from_matrices(scale * np.einsum("ij,jab->iab", T, rho)))
    exact = constants_of(co.algebras.change_of_basis(known, T))
    error = np.abs(found - scale * exact).max() / np.abs(scale * exact).max()
    assert error < 64 * known.dim * U * np.linalg.cond(T) ** 2


def test_the_attitude_of_a_run_is_that_of_the_given_matrices():
    """The matrix of the momentum, turned back by the attitude, is constant."""
    su3 = co.LieAlgebra.from_matrices(-0.5j * gell_mann(), name="su(3)")
    system = co.LiePoissonSystem(su3, co.Quadratic(np.linspace(0.5, 1.5, 8)))
    x0 = RNG.normal(size=8)
    sol = co.integrate(system, x0, (0, 10), 0.05, co.Splitting(order=2), attitude=True)
    assert sol.attitude.shape[-2:] == (6, 6)
    space = sol.attitude @ np.einsum("ti,iab->tab", sol.x, su3.representation) @ np.linalg.inv(sol.attitude)
    assert np.abs(space - space[0]).max() < 200 * 64 * U * np.abs(x0).max() < 0.1 < np.abs(sol.x[-1] - x0).max()


def test_completed_sets():
    """Two shifts generate sl(2); two controls of a spin 1 and its quadratic field generate su(3)."""
    sl2 = co.LieAlgebra.closure([[[0, 1], [0, 0]], [[0, 0], [1, 0]]], basis=("e", "f"))
    assert sl2.basis == ("e", "f", "e3") and sl2.name == "2 matrices, and e3 = [e, f]"
    assert np.array_equal(sl2.representation[2], np.diag([1.0, -1.0]))
    x, _, z = spin(2)
    su3 = co.LieAlgebra.closure([-1j * x, -1j * z, -1j * (z @ z - 2 / 3 * np.eye(3))])
    assert su3.dim == 8 and su3.generic_rank() == 6 and set(su3.casimirs(3)) == {"C2", "C3"}
    closed = co.LieAlgebra.closure(co.algebras.e(3).representation)
    assert closed == co.algebras.e(3) and closed.name == "6 matrices"
    # Floats that are no simple numbers, by least squares.
    assert co.LieAlgebra.closure(RNG.normal(size=(2, 3, 3))).dim == 9
    turned = np.linalg.qr(RNG.normal(size=(4, 4)))[0]
    assert co.LieAlgebra.closure(turned @ co.algebras.so(4).representation[[0, 1, 2]] @ turned.T).dim == 6


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::coadjoint.LongWait")
def test_a_closure_is_bounded():
    raising = np.diag(np.ones(16), 1)
    generators = [raising, raising.T @ np.diag(np.arange(17.0) ** 2 + 1)]
    with refused(ValueError, "2 matrices", "256"):
        co.LieAlgebra.closure(generators)
    assert co.LieAlgebra.closure([generators[0][:4, :4], generators[1][:4, :4]]).dim == 15


@pytest.mark.parametrize(("units", "exact"), [(2, True), (12, False)])
@pytest.mark.parametrize(("square", "small"), [(9998.0, True), (10002.0, False)])
def test_square_roots_at_their_thresholds(units, exact, square, small):
    """Floats within two units of round-off of the root of a number up to 10^4 stand for the root.

    The square of the root is a constant, which only exact arithmetic finds to the last bit.
    """
    root = np.sqrt(square) * (1.0 + units * 2.0**-52)
    g = co.LieAlgebra.from_matrices(
        [[[0, root], [-root, 0]]] + [[[root, 0], [0, 0]], [[0, 0], [0, root]], [[0, 1], [1, 0]]]
    )
    found = abs(g.bracket([0, 1, 0, 0], [0, 0, 0, 1])[0])  # [root E11, s] = root (E12 - E21) = 1 e1
    assert found == 1.0
    twice = abs(g.bracket([1, 0, 0, 0], [0, 0, 0, 1])[1])  # [root (E12 - E21), s] = 2 root (E11 - E22) = 2 e2
    assert twice == 2.0
    through = abs(g.bracket([1, 0, 0, 0], [0, 1, 0, 0])[3])  # [root (E12 - E21), root E11] = -square s
    assert (through == square) == (exact and small)


@pytest.mark.parametrize(("share", "named"), [(2.0**-43, "representation"), (2.0**-36, "not in the span")])
def test_distance_from_the_span_at_its_threshold(share, named):
    """A matrix that leaves a closed set by a share of the product of norms, on both sides of 2^-40.

    Closer, the set is taken for closed, and its matrices violate their commutators.
    """
    rho = RNG.normal(size=(2, 1, 1)) * np.array([np.diag([1.0, -1.0, 0.0]), np.diag([1.0, 0.0, -1.0])])
    spoiled = np.array([*rho, np.zeros((3, 3))])
    # [A1, A3] = c A3 exactly; an entry elsewhere in A3 leaves the span by its share.
    spoiled[2, 0, 1], spoiled[2, 1, 2] = np.pi, np.pi * share
    with refused(ValueError, named):
        co.LieAlgebra.from_matrices(spoiled)


@pytest.mark.parametrize(("share", "dependent"), [(2.0**-42, True), (2.0**-38, False)])
def test_nearly_dependent_matrices_at_their_threshold(share, dependent):
    """Commuting matrices at a small angle, to which no fraction is near."""
    first, second = np.diag([np.pi, np.e]), np.diag([np.pi, np.e * (1 + share * (np.pi**2 + np.e**2) / (np.pi * np.e))])
    with refused(ValueError, "dependent", "A2 = 1 A1") if dependent else nullcontext():
        assert co.LieAlgebra.from_matrices([first, second]) == co.LieAlgebra([], dim=2)


def test_complex_matrices_are_written_by_real_blocks():
    # The conjugate (A, B; -B, A) has the same commutators.
    for scale in (1.0, np.pi):
        g = co.LieAlgebra.from_matrices([scale * np.array([[1j, 2.0], [-2.0, -1j]])])
        A, B = scale * np.array([[0.0, 2.0], [-2.0, 0.0]]), scale * np.diag([1.0, -1.0])
        assert np.array_equal(g.representation[0], np.block([[A, -B], [B, A]]))
