"""Quadratic Hamiltonians: every form of M, exactness in any number type."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse

import coadjoint as co
from refusals import refused


@pytest.mark.parametrize("kind", [scipy.sparse.coo_array, scipy.sparse.csr_array, scipy.sparse.csc_array])
def test_sparse_entries_in_any_order_with_duplicates_and_zeros(kind):
    """Entries at one place are added; zeros, stored or by cancellation, are left out; the given matrix is unchanged."""
    rows = np.array([2, 0, 1, 0, 3, 1, 2, 0, 3, 3, 1])
    columns = np.array([0, 2, 1, 2, 3, 1, 0, 0, 0, 3, 3])
    values = np.array([1.0, 0.5, 2.0, 1.5, 4.0, -0.75, 1.0, 0.0, 0.0, -4.0, 0.0])
    M = kind((values, (rows, columns)), shape=(4, 4)) if kind is scipy.sparse.coo_array else None
    if M is None:  # with duplicates that are not merged
        major, minor = (rows, columns) if kind is scipy.sparse.csr_array else (columns, rows)
        order = np.argsort(major, kind="stable")
        indptr = np.concatenate([[0], np.cumsum(np.bincount(major, minlength=4))])
        M = kind((values[order], minor[order], indptr), shape=(4, 4))
    stored, dense = M.data.copy(), M.toarray()
    H = co.Quadratic(M)
    np.testing.assert_array_equal(H.hessian(np.zeros(4)), dense)
    (term,) = H.terms()
    assert list(zip(term.rows.tolist(), term.indices.tolist(), strict=True)) == [(0, 2), (1, 1), (2, 0)]
    np.testing.assert_array_equal(M.data, stored)
    assert co.Quadratic(M) is not H and M.nnz == 11


def test_a_number_binds_to_any_dimension():
    H = co.Quadratic(3.0)
    assert H.dim is None
    with refused(TypeError, "bind"):
        H.terms()
    assert H.value([1.0, 2.0]) == 7.5
    np.testing.assert_array_equal(H.bind(4).hessian(np.zeros(4)), 3.0 * np.eye(4))
    assert co.Quadratic(3.0, linear=[1.0, 0.0]).dim == 2


def test_fractions_are_exact():
    third = Fraction(1, 3)
    M = np.array([[third, Fraction(1, 7)], [Fraction(1, 7), Fraction(2)]], dtype=object)
    H = co.Quadratic(M, linear=[0.5, 0.0])
    x = np.array([Fraction(3, 5), Fraction(-1, 2)], dtype=object)
    assert H.gradient(x).tolist() == [third * x[0] + x[1] / 7 + Fraction(1, 2), x[0] / 7 + 2 * x[1]]
    assert H.value(x) == (third * x[0] ** 2 + 2 * x[0] * x[1] / 7 + 2 * x[1] ** 2) / 2 + x[0] / 2
    assert H.hessian(x)[0, 0] == third
    assert H.hessian(np.zeros(2)).dtype == np.float64
    rounded = co.Quadratic([0.1, 0.2])
    assert rounded.gradient(x).tolist() == [Fraction(0.1) * x[0], Fraction(0.2) * x[1]]


@pytest.mark.parametrize(
    "M",
    [2.0, [2.0] * 3, 2.0 * np.eye(3), scipy.sparse.eye_array(3) * 2.0],
    ids=["number", "diagonal", "full", "sparse"],
)
@pytest.mark.parametrize("constant", [-3.25, Fraction(-13, 4)])
def test_the_constant_stays_in_every_form_of_m(M, constant):
    """Also where a number becomes a matrix, once the system says the dimension."""
    H = co.Quadratic(M, constant=constant)
    x = np.array([1.0, -2.0, 0.5])
    for same in (H, H.bind(3), co.LiePoissonSystem(co.algebras.so(3), H).hamiltonian):
        assert same.value(x) == x @ x - 3.25
    for multiple, factor in ((2 * H, 2.0), (-H, -1.0), (H / 4, 0.25), (H * Fraction(1, 2), 0.5), (H + H, 2.0)):
        assert multiple.value(x) == multiple.bind(3).value(x) == factor * (x @ x - 3.25)
    assert H.bind(3).terms()[0].constant == -3.25
    system = co.LiePoissonSystem(co.algebras.so(3), H)
    assert co.integrate(system, x, (0.0, 1.0), 0.5).energy[0] == x @ x - 3.25


NUMBERS = {"float": 0.1, "whole": 3, "fraction": Fraction(1, 3)}


@pytest.mark.parametrize("seed", range(4))
def test_coefficients_of_polynomials_keep_their_numbers(seed):
    """Floats, whole numbers and fractions beside each other, in every term, as the fractions that they are."""
    rng = np.random.default_rng(seed)
    for kinds in ([0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]):
        terms = [(2, 0, 0), (0, 2, 0), (1, 1, 0), (0, 1, 1), (1, 0, 0), (0, 0, 1), (0, 0, 0)]
        numbers = [list(NUMBERS.values())[k] for k in rng.permutation(np.resize(kinds, len(terms)))]
        monomials = {e: c * int(rng.choice([-2, -1, 1, 2])) for e, c in zip(terms, numbers, strict=True)}
        H = co.Quadratic.from_polynomial(co.Polynomial(monomials))
        x = [Fraction(int(n), 7) for n in rng.choice([-3, -2, -1, 1, 2, 3], 3)]
        wanted = sum(Fraction(c) * x[0] ** i * x[1] ** j * x[2] ** k for (i, j, k), c in monomials.items())
        assert H.value(np.array(x, dtype=object)) == wanted
        assert H.to_polynomial().monomials == monomials
        assert H.exact == any(not isinstance(c, float) for c in monomials.values())
        doubled = co.Quadratic.from_polynomial(2 * H.to_polynomial())
        assert doubled.value(np.array(x, dtype=object)) == 2 * wanted


@pytest.mark.long
def test_a_million_coordinates_stay_sparse():
    n = 10**6
    M = scipy.sparse.diags_array([np.full(n - 1, -1.0), np.full(n, 2.0), np.full(n - 1, -1.0)], offsets=[-1, 0, 1])
    H = co.Quadratic(M)
    gradient = H.gradient(np.ones(n))
    assert gradient[0] == gradient[-1] == 1.0
    assert not gradient[1:-1].any()
    assert H.value(np.ones(n)) == 1.0
    assert H.terms()[0].values.size == 3 * n - 2
    assert "nonzero" in repr(H)
    twice = H + co.Quadratic(M) / 2
    assert twice.value(np.ones(n)) == 1.5 and len((H - H).terms()[0].values) == 0


def sparse_symmetric(n, seed, density=0.35):
    """Small whole numbers at drawn places, so that all sums are exact."""
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.integers(-4, 5, (n, n)) * (rng.uniform(size=(n, n)) < density)).astype(float)
    return upper + np.triu(upper, 1).T


@pytest.mark.parametrize("seed", range(12))
def test_sums_of_sparse_matrices_are_sums_of_matrices(seed):
    """Entries of the two in any order and place, also of one column in consecutive rows."""
    n = 2 + seed % 5
    A, B = sparse_symmetric(n, seed), sparse_symmetric(n, 100 + seed, density=0.6)
    a, b = np.random.default_rng(seed).integers(-3, 4, (2, n)).astype(float)
    first, second = co.Quadratic(scipy.sparse.csr_array(A), a, 0.25), co.Quadratic(B, b, -2.0)
    x = np.random.default_rng(seed + 1).integers(-5, 6, n).astype(float)
    exact = co.Quadratic(np.array([[Fraction(v) for v in row] for row in A.tolist()], dtype=object), a, 0.25)
    for H in (first + second, second + first, exact + second, 3 * first - 2 * first + second):
        np.testing.assert_array_equal(H.hessian(x), A + B)
        np.testing.assert_array_equal(H.gradient(x), (A + B) @ x + a + b)
        assert H.value(x) == x @ (A + B) @ x / 2 + (a + b) @ x - 1.75
        (term,) = H.terms()
        dense = np.zeros((n, n))
        dense[term.rows, term.indices] = term.values
        np.testing.assert_array_equal(dense, A + B)
        assert np.array_equal(term.linear, a + b) and term.constant == -1.75


@pytest.mark.parametrize("kind", [np.int8, np.int16, np.int32, np.int64])
def test_numpy_integers_among_fractions_do_not_overflow(kind):
    large, third = int(np.iinfo(kind).max), Fraction(1, 3)
    M = np.array([[third, kind(-large)], [kind(-large), kind(large)]], dtype=object)
    H = co.Quadratic(M, linear=np.array([kind(large), third], dtype=object))
    x = [Fraction(large), Fraction(-3 * large, 2)]
    point = np.array(x, dtype=object)
    slope = [third * x[0] - large * x[1] + large, -large * x[0] + large * x[1] + third]
    value = third * x[0] ** 2 / 2 - large * x[0] * x[1] + Fraction(large, 2) * x[1] ** 2 + large * x[0] + third * x[1]
    for same in (H, H + H - H, 2 * H / 2):
        assert same.exact and same.value(point) == value and same.gradient(point).tolist() == slope
        assert same.to_polynomial()(point) == value
    assert (H + H).hessian(point).tolist() == [[2 * third, -2 * large], [-2 * large, 2 * large]]


def test_input_is_copied_and_round_off_asymmetry_takes_the_upper_triangle():
    M = np.array([1.0, 2.0])
    H = co.Quadratic(M)
    M[0] = 9.0
    assert H.gradient([1.0, 1.0])[0] == 1.0
    hessian = co.Quadratic(np.array([[1.0, 0.3], [0.3 + 2.0**-53, 2.0]])).hessian(np.zeros(2))
    assert hessian[0, 1] == hessian[1, 0] == 0.3
