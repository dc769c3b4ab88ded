"""Lie algebras given by matrices: exact constants, matrices that are missing, runs with the given representation."""

from fractions import Fraction

import numpy as np
import pytest
import sympy

import coadjoint as co


def unit(n, i, j):
    matrix = np.zeros((n, n))
    matrix[i, j] = 1.0
    return matrix


def turns(n):
    return [unit(n, k, j) - unit(n, j, k) for j, k in ((1, 2), (2, 0), (0, 1))]


SE3 = [*turns(4), *(unit(4, i, 3) for i in range(3))]
SP4 = [np.kron([[0, 1], [-1, 0]], np.eye(2)) @ (unit(4, i, j) + unit(4, j, i)) for i in range(4) for j in range(i + 1)]


def gell_mann():
    x, y = ([unit(3, i, j) + c * unit(3, j, i) for i, j in ((0, 1), (0, 2), (1, 2))] for c in (1, -1))
    return [
        x[0], -1j * y[0], np.diag([1, -1, 0]), x[1], -1j * y[1], x[2], -1j * y[2], np.diag([1, 1, -2]) / np.sqrt(3)
    ]  # fmt: skip


def commutators_of(g):
    """Return the largest defect of [rho_i, rho_j] = sum c_ij^k rho_k, by dense arrays."""
    rho = g.representation
    c = np.zeros((g.dim,) * 3)
    i, j, k, value = g.triples
    c[i, j, k], c[j, i, k] = value, -value
    products = np.einsum("iab,jbc->ijac", rho, rho)
    return np.abs(products - products.swapaxes(0, 1) - np.einsum("ijk,kab->ijab", c, rho)).max()


def test_se3_is_the_algebra_of_the_catalogue():
    g = co.LieAlgebra.from_matrices(SE3, name="mine")
    assert g == co.algebras.se(3) and g.name == "mine"
    assert np.array_equal(g.representation, SE3)


def test_gell_manns_matrices_have_their_published_constants():
    g = co.LieAlgebra.from_matrices([-0.5j * m for m in gell_mann()])
    root = np.sqrt(3) / 2
    # f_ijk of [l_i / 2, l_j / 2] = i f_ijk l_k / 2: Gell-Mann, Phys. Rev. 125, 1067 (1962), table II.
    published = {
        (1, 2, 3): 1.0, (1, 4, 7): 0.5, (1, 5, 6): -0.5, (2, 4, 6): 0.5, (2, 5, 7): 0.5, (3, 4, 5): 0.5,
        (3, 6, 7): -0.5, (4, 5, 8): root, (6, 7, 8): root,
    }  # fmt: skip
    c = np.zeros((8, 8, 8))
    for (i, j, k), f in published.items():
        for a, b, d, sign in ((i, j, k, 1), (j, k, i, 1), (k, i, j, 1), (j, i, k, -1), (i, k, j, -1), (k, j, i, -1)):
            c[a - 1, b - 1, d - 1] = sign * f
    i, j, k, value = g.triples
    assert np.array_equal(c[i, j, k], value) and np.count_nonzero(c) == 2 * len(value)
    assert g.representation.shape == (8, 6, 6) and commutators_of(g) < 1e-15


@pytest.mark.parametrize("third", [1 / 3, Fraction(1, 3), sympy.Rational(1, 3)])
def test_constants_are_rounded_once(third):
    h, e, f = ([[1, 0], [0, -1]], [[0, 7 * third], [0, 0]], [[0, 0], [third, 0]])
    g = co.LieAlgebra.from_matrices([np.array(m, dtype=object) for m in (h, e, f)])
    indices = np.transpose(g.triples[:3]).tolist()
    assert indices == [[0, 1, 1], [0, 2, 2], [1, 2, 0]] and g.triples.c.tolist() == [2.0, -2.0, 7 / 9]
    assert list(g.casimirs()) == ["C2"]


def test_square_roots_cancel_exactly():
    root = np.sqrt(2)
    g = co.LieAlgebra.from_matrices([[[0, root], [0, 0]], [[1, 0], [0, -1]], [[0, 0], [root / 3, 0]]])
    # 2 / 3 is the product of two rounded roots, which is not the nearest number to it.
    assert g.triples.c.tolist() == [-2.0, 2 / 3, -2.0] and root * (root / 3) != 2 / 3


@pytest.mark.parametrize("matrices", [SE3, SP4, co.algebras.so(5).representation, co.algebras.su(3).representation])
def test_the_basis_may_be_any(matrices):
    # Entries that are no simple numbers: the constants are those of the change of basis, to rounding of the matrices.
    rng = np.random.default_rng(len(matrices))
    n, d = len(matrices), len(matrices[0])
    mixed, frame = rng.standard_normal((n, n)), np.eye(d) + 0.2 * rng.standard_normal((d, d))
    basis = [frame @ sum(c * m for c, m in zip(row, matrices, strict=True)) @ np.linalg.inv(frame) for row in mixed]
    g = co.LieAlgebra.from_matrices(basis)
    assert commutators_of(g) < 1e-13 * np.abs(g.representation).max() ** 2 * d
    exact = co.algebras.change_of_basis(co.LieAlgebra.from_matrices(matrices), mixed)
    x = rng.standard_normal(n)
    size = np.abs(exact.structure_matrix(x)).max()
    assert np.abs(g.structure_matrix(x) - exact.structure_matrix(x)).max() < 1e-11 * size
    assert g.generic_rank() == exact.generic_rank()


def test_what_is_no_algebra_is_refused_with_what_is_missing():
    with pytest.raises(ValueError, match=r"\[e1, e2\].*\[\[1, 0\], \[0, -1\]\].*closure"):
        co.LieAlgebra.from_matrices([[[0, 1], [0, 0]], [[0, 0], [1, 0]]])
    with pytest.raises(ValueError, match=r"\[A, C\]"):
        co.LieAlgebra.from_matrices(
            [unit(3, 0, 1), unit(3, 0, 2), unit(3, 1, 2) + unit(3, 2, 0)], basis=("A", "B", "C")
        )
    # 1e-9 is no rounding, and 1e-16 is.
    near = [m.astype(float) + 1e-16 * np.ones((4, 4)) for m in SE3]
    assert co.LieAlgebra.from_matrices(near).dim == 6
    with pytest.raises(ValueError, match="no combination of the matrices, by"):
        co.LieAlgebra.from_matrices([m.astype(float) + 1e-9 * np.ones((4, 4)) for m in SE3])


@pytest.mark.parametrize(
    "matrices, words",
    [
        ([*turns(3), turns(3)[0] - 2.5 * turns(3)[2]], r"e4 is e1 - 2\.5 e3"),
        ([turns(3)[0], np.pi * turns(3)[0]], r"e2 is 3\.14159 e1"),
        ([turns(3)[0], np.zeros((3, 3))], "e2 is zero"),
        ([turns(3)[0], np.eye(2)], r"matrix 1 has shape \(2, 2\)"),
        ([[[1, 2, 3]]], r"shape \(1, 3\)"),
        ([[[1, 2], [3]]], "shape|different lengths"),
        ([np.full((2, 2), np.nan)], "matrix 0 contains nan; every entry must be finite"),
        ([1e61 * turns(3)[0]], "largest entry of matrix 0 is 1e.61; take units"),
        ([1e-61 * turns(3)[0]], "largest entry of matrix 0 is 1e-61; take units"),
        ([[["x"]]], "matrix 0 contains 'x'; give numbers"),
        (np.eye(3), r"a single array of shape \(3, 3\)"),
        ([], "empty"),
        ("abc", "matrices is 'abc'"),
        (7, "matrices is 7"),
    ],
)
def test_wrong_matrices(matrices, words):
    for make in (co.LieAlgebra.from_matrices, co.LieAlgebra.closure):
        with pytest.raises((TypeError, ValueError), match=words) as caught:
            make(matrices)
        assert "\n" not in str(caught.value)


def test_dependence_is_found_at_rounding_only():
    first, second, third = turns(3)
    for distance in (1e-16, 1e-9):
        almost = first + second + distance * third
        if distance < 1e-15:
            with pytest.raises(ValueError, match="e3 is e1"):
                co.LieAlgebra.from_matrices([first, second, almost])
        else:
            g = co.LieAlgebra.from_matrices([first, second, almost])
            assert g.dim == 3 and np.abs(g.triples.c).max() > 1e8


def test_closure_adds_what_is_missing_and_nothing_else():
    g = co.LieAlgebra.closure([SE3[0], SE3[1], SE3[3]])
    assert g.dim == 6 and g.generic_rank() == 4 and np.array_equal(g.representation[:3], [SE3[0], SE3[1], SE3[3]])
    assert commutators_of(g) == 0.0
    closed = co.LieAlgebra.closure(SP4)
    assert closed == co.LieAlgebra.from_matrices(SP4) and closed.dim == 10
    # Two generic matrices generate sl(3).
    rng = np.random.default_rng(4)
    two = [m - np.trace(m) / 3 * np.eye(3) for m in rng.standard_normal((2, 3, 3))]
    assert co.LieAlgebra.closure(two).dim == 8
    with pytest.raises(ValueError, match="more than 7 dimensions"):
        co.LieAlgebra.closure(two, max_dim=7)
    assert co.LieAlgebra.closure(two, max_dim=8).dim == 8


@pytest.mark.parametrize("scale", [1e-60, 1e-8, 1e8, 1e60])
def test_units_do_not_matter(scale):
    g = co.LieAlgebra.from_matrices([scale * m for m in SE3])
    assert np.allclose(g.triples.c, scale * co.LieAlgebra.from_matrices(SE3).triples.c, rtol=1e-15, atol=0)
    assert co.LieAlgebra.closure([scale * m for m in SE3[:4]]).dim == 6


def test_runs_carry_the_given_representation():
    # su(2) by Pauli matrices: the momentum in space, g X g^-1 of the dual matrix, is constant.
    pauli = [np.array([[0, 1], [1, 0]]), np.array([[0, -1j], [1j, 0]]), np.diag([1, -1])]
    g = co.LieAlgebra.from_matrices([-0.5j * m for m in pauli])
    assert g == co.algebras.so(3)
    system = co.LiePoissonSystem(g, co.Quadratic([1.0, 0.5, 0.4]), sign=-1)
    sol = co.integrate(system, (0.3, 1.0, -0.4), (0, 20), 0.05, co.Splitting(order=4), attitude=True)
    X = np.einsum("ti,iab->tab", sol.x, g.representation)
    in_space = sol.attitude @ X @ np.linalg.inv(sol.attitude)
    assert np.abs(in_space - X[0]).max() < 1e-13
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    assert np.array_equal(sol.x, co.integrate(body, (0.3, 1.0, -0.4), (0, 20), 0.05, co.Splitting(order=4)).x)


def test_names_of_other_libraries_lead_to_the_constructors():
    for name, words in {
        "from_tensor": "co.LieAlgebra(constants)",
        "from_structure_constants": "co.LieAlgebra(constants)",
        "from_basis": "from_matrices",
        "from_generators": "closure",
        "from_dict": "from_brackets",
        "so": "co.algebras",
    }.items():
        with pytest.raises(AttributeError) as caught:
            getattr(co.LieAlgebra, name)
        assert words in str(caught.value) and name in str(caught.value)
    assert not hasattr(co.LieAlgebra, "no_such_name")


def test_limits_of_size():
    # 4^2 numbers times n (n - 1) / 2 commutators, at most 2^22, by zeros that need not be computed with.
    with pytest.raises(ValueError, match="725 matrices of size 4 have 262450 commutators, too many"):
        co.LieAlgebra.from_matrices([np.zeros((4, 4))] * 725)
    with pytest.raises(ValueError, match="e1 is zero"):
        co.LieAlgebra.from_matrices([np.zeros((4, 4))] * 724)
    with pytest.raises(ValueError, match="max_dim must be a whole number from 1 to 256, not 257"):
        co.LieAlgebra.closure(turns(3), max_dim=257)
    assert co.LieAlgebra.closure(turns(3), max_dim=256).dim == 3


@pytest.mark.parametrize("numerator, read", [(1023, True), (1024, True), (1031, False)])
def test_roots_of_simple_fractions_are_read_as_such(numerator, read):
    # sqrt(q) E12, sqrt(q) E21 and H: [E, F] = q H, the nearest float to q if the root is read as one.
    root = np.sqrt(numerator / 1019)
    g = co.LieAlgebra.from_matrices([[[0, root], [0, 0]], [[0, 0], [root, 0]], [[1, 0], [0, -1]]])
    assert abs(g.triples.c[0] - numerator / 1019) < 4e-16
    assert not read or g.triples.c[0] == numerator / 1019
