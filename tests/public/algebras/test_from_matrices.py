"""Algebras from matrices: constants, representation, runs, completed sets, and messages."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co

U = 2.0**-53
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


def constants(g):
    """All c_ij^k with i < j, dense."""
    dense = np.zeros((g.dim,) * 3)
    dense[g.triples.i, g.triples.j, g.triples.k] = g.triples.c
    return dense


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
    upper = np.triu(np.ones((8, 8)), 1)[:, :, None] > 0
    assert np.array_equal(constants(g), np.where(upper, f, 0.0))
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
    rho = known.representation if known.representation is not None else adjoint(known)
    T = RNG.normal(size=(known.dim,) * 2)
    found = constants(co.LieAlgebra.from_matrices(scale * np.einsum("ij,jab->iab", T, rho)))
    exact = constants(co.algebras.change_of_basis(known, T))
    error = np.abs(found - scale * exact).max() / np.abs(scale * exact).max()
    assert error < 64 * known.dim * U * np.linalg.cond(T) ** 2


def adjoint(g):
    """The matrices of ad, a representation without a centre."""
    return np.array([[g.bracket(u, v) for v in np.eye(g.dim)] for u in np.eye(g.dim)]).transpose(0, 2, 1)


def test_a_body_from_matrices_runs_as_the_known_one_and_keeps_its_spatial_momentum():
    known = co.algebras.so(3)
    g = co.LieAlgebra.from_matrices(known.representation)
    H, x0 = co.Quadratic([1.0, 0.5, 0.25]), (0.3, 1.0, 0.2)
    runs = [
        co.integrate(co.LiePoissonSystem(h, H), x0, (0, 50), 0.05, co.Splitting(order=4), attitude=True)
        for h in (g, known)
    ]
    assert np.array_equal(runs[0].x, runs[1].x) and np.array_equal(runs[0].attitude, runs[1].attitude)
    # On su(3) in the given representation: the matrix of the momentum, turned back by the attitude, is constant.
    su3 = co.LieAlgebra.from_matrices(-0.5j * gell_mann(), name="su(3)")
    system = co.LiePoissonSystem(su3, co.Quadratic(np.linspace(0.5, 1.5, 8)))
    x0 = RNG.normal(size=8)
    sol = co.integrate(system, x0, (0, 20), 0.05, co.Splitting(order=2), attitude=True)
    assert sol.attitude.shape[-2:] == (6, 6)
    momenta = np.einsum("ti,iab->tab", sol.x, su3.representation)
    space = sol.attitude @ momenta @ np.linalg.inv(sol.attitude)
    assert np.abs(space - space[0]).max() < 400 * 64 * U * np.abs(x0).max()
    assert np.abs(sol.x[-1] - x0).max() > 0.1
    assert max(sol.drift()[f"C{degree}"] for degree in (2, 3) if f"C{degree}" in sol.drift()) < 1e-12


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


@pytest.mark.filterwarnings("ignore::coadjoint.long_operations.LongWait")
def test_a_closure_is_bounded():
    raising = np.diag(np.ones(16), 1)
    generators = [raising, raising.T @ np.diag(np.arange(17.0) ** 2 + 1)]
    with pytest.raises(ValueError, match="2 matrices generate an algebra of dimension above 256"):
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


NOISE = {
    "below": (2.0**-43, None),
    "above": (2.0**-36, r"\[A\d, A\d\] is not in the span .* by \d\.\de-1[0-2] of the size"),
}


@pytest.mark.parametrize("side", NOISE)
def test_distance_from_the_span_at_its_threshold(side):
    """A matrix that leaves a closed set by a given share of the product of norms, 2^-40 from both sides."""
    share, message = NOISE[side]
    rho = RNG.normal(size=(2, 1, 1)) * np.array([np.diag([1.0, -1.0, 0.0]), np.diag([1.0, 0.0, -1.0])])
    spoiled = np.array([*rho, np.zeros((3, 3))])
    spoiled[2, 0, 1] = np.pi
    # [A1, A3] = c A3 exactly; an entry elsewhere in A3 leaves the span by its share.
    spoiled[2, 1, 2] = np.pi * share
    if message is None:
        with pytest.raises(ValueError, match="representation violates the commutator"):
            co.LieAlgebra.from_matrices(spoiled)
    else:
        with pytest.raises(ValueError, match=message):
            co.LieAlgebra.from_matrices(spoiled)


@pytest.mark.parametrize(("share", "refused"), [(2.0**-42, True), (2.0**-38, False)])
def test_nearly_dependent_matrices_at_their_threshold(share, refused):
    """Commuting matrices at a small angle, to which no fraction is near."""
    first, second = np.diag([np.pi, np.e]), np.diag([np.pi, np.e * (1 + share * (np.pi**2 + np.e**2) / (np.pi * np.e))])
    if refused:
        with pytest.raises(ValueError, match="the matrices are dependent: A2 = 1 A1; leave A2 out"):
            co.LieAlgebra.from_matrices([first, second])
    else:
        assert co.LieAlgebra.from_matrices([first, second]).triples.c.size == 0


REFUSED = {
    "a commutator outside": ([[[0, 1], [0, 0]], [[0, 0], [1, 0]]],
                             r"^\[A1, A2\] is not .*: it is \[\[1.0, 0.0\], \[0.0, -1.0\]\]; add"),
    "the third pair": (np.delete(co.algebras.so(4).representation, 5, 0), r"^\[A2, A3\] is not in the span"),
    "a Hermitian set": (spin(3), r"give -1j or 1j times them"),
    "a sum": ([[[1, 0], [0, 0]], [[0, 0], [0, 1]], np.eye(2)], "A3 = 1 A1 [+] 1 A2; leave A3 out"),
    "dependent over roots": ([np.diag([1.0, np.sqrt(2)]), np.diag([np.sqrt(2), 2.0])], "A2 = 1.41421 A1"),
    "zero": ([[[1]], [[0]]][1:], "A1 = 0"),
    "too many": (np.ones((5, 2, 2)), "5 matrices of 2 x 2, of which at most 4"),
    "none": ([], "there are no matrices"),
    "one matrix": (np.eye(2), r"A1 has shape \(2,\)"),
    "two sizes": ([np.eye(2), np.eye(3)], r"A2 has shape \(3, 3\), and A1 has \(2, 2\)"),
    "oblong": (np.ones((2, 2, 3)), r"A1 has shape \(2, 3\)"),
    "not finite": ([[[np.inf]]], "finite"),
    "too large": ([[[10**400]]], "finite"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("build", [co.LieAlgebra.from_matrices, co.LieAlgebra.closure])
def test_refused_by_name(name, build):
    matrices, message = REFUSED[name]
    if message[0] == "^" or name == "a Hermitian set":  # which can be completed
        build = co.LieAlgebra.from_matrices
    with pytest.raises(ValueError, match=message):
        build(matrices)


def test_names_of_other_libraries_lead_to_the_constructor():
    for name, meant in {
        "from_tensor": r"LieAlgebra\(constants\)",
        "from_structure_constants": r"LieAlgebra\(constants\)",
        "from_commutators": "LieAlgebra.from_brackets",
        "from_generators": "LieAlgebra.from_matrices",
        "lie_closure": "LieAlgebra.closure",
    }.items():
        with pytest.raises(AttributeError, match=f"no attribute '{name}'; here it is {meant}"):
            getattr(co.LieAlgebra, name)
        with pytest.raises(AttributeError, match=f"no attribute '{name}'; here it is co.{meant}"):
            getattr(co, name)
    with pytest.raises(AttributeError, match="did you mean 'from_brackets'"):
        _ = co.LieAlgebra.from_bracket
    assert not hasattr(co.LieAlgebra, "__wrapped__")


def test_complex_matrices_are_written_by_real_blocks():
    # The conjugate (A, B; -B, A) has the same commutators.
    for scale in (1.0, np.pi):
        g = co.LieAlgebra.from_matrices([scale * np.array([[1j, 2.0], [-2.0, -1j]])])
        A, B = scale * np.array([[0.0, 2.0], [-2.0, 0.0]]), scale * np.diag([1.0, -1.0])
        assert np.array_equal(g.representation[0], np.block([[A, -B], [B, A]]))
