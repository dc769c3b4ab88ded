"""Completed squares reproduce the quadratic form: exactly in rationals, to round-off where those stop."""

from fractions import Fraction

import numpy as np
import pytest

from coadjoint.program.parts.offsets_of_squares import ExactSums, ReductionSteps
from coadjoint.program.parts.sparse_squares import sparse_squares
from coadjoint.program.parts.squares import MAX_RATIONAL_SIZE, complete_squares
from coadjoint.program.sparse_rows import SparseRows

U = 2.0**-53


def symmetric(seed, n, diagonal=True):
    A = np.random.default_rng(seed).standard_normal((n, n))
    M = A + A.T
    return M if diagonal else M - np.diag(np.diag(M))


def singular(seed, n, rank):
    """Integer entries, so that the rank is exact."""
    L = np.random.default_rng(seed).integers(-3, 4, (n, rank)).astype(float)
    return L @ np.diag([1.0, -2.0, 3.0, -1.0][:rank]) @ L.T


MATRICES = {
    "definite": symmetric(1, 4) @ symmetric(1, 4),
    "indefinite": symmetric(2, 5),
    "one coordinate": np.array([[-0.3]]),
    "zero diagonal": symmetric(3, 5, diagonal=False),
    "zero diagonal, odd rank": np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]),
    "tiny diagonal": symmetric(4, 4, diagonal=False) + 1e-17 * np.diag([1.0, -2.0, 3.0, 1.0]),
    "rank 2 of 5": singular(5, 5, 2),
    "rank 3 of 6": singular(6, 6, 3),
    "zero": np.zeros((3, 3)),
    "largest rational": symmetric(7, MAX_RATIONAL_SIZE),
    "graded": np.diag([1e-8, 1.0, 1e8]) @ symmetric(8, 3) @ np.diag([1e-8, 1.0, 1e8]),
}


def fractions(array):
    return np.vectorize(Fraction, otypes=[object])(array)


def total(squares):
    """Return sum d l l^T, its size (the sum of absolute values), and sum beta l."""
    outer = [d * np.multiply.outer(form, form) for form, d in zip(squares.forms, squares.weights, strict=True)]
    linear = [beta * form for form, beta in zip(squares.forms, squares.linear, strict=True)]
    return sum(outer, 0), sum((abs(o) for o in outer), 0), sum(linear, 0)


@pytest.mark.parametrize("with_linear", [False, True])
@pytest.mark.parametrize("name", MATRICES)
def test_reconstruction_is_exact_in_rationals(name, with_linear):
    M = MATRICES[name]
    n = len(M)
    b = np.random.default_rng(9).standard_normal(n) if with_linear else np.zeros(n)
    squares = complete_squares(M, b)
    assert len(squares.forms) <= n
    matrix, _, linear = total(squares)
    assert np.all(fractions(M) - matrix == 0)
    assert np.all(fractions(b) - linear == 0)


@pytest.mark.parametrize("name", [name for name in MATRICES if name != "graded"])
def test_weights_have_the_signature_of_the_matrix(name):
    """Sylvester's law of inertia, by the eigenvalues; those below 16 n u of the largest count as zero."""
    M = MATRICES[name]
    weights = complete_squares(M, np.zeros(len(M))).weights
    eigenvalues = np.linalg.eigvalsh(M)
    floor = 16 * len(M) * U * max(abs(eigenvalues))
    assert sum(w > 0 for w in weights) == np.sum(eigenvalues > floor)
    assert sum(w < 0 for w in weights) == np.sum(eigenvalues < -floor)


def test_forms_have_no_large_coefficients():
    """The pivot rule bounds them: a single pivot by 64/41, a pair by 2 and by 15 (a largest entry 1)."""
    rng = np.random.default_rng(10)
    for trial in range(200):
        n = int(rng.integers(2, 7))
        scale = 10.0 ** rng.uniform(-18, 0, n)
        M = symmetric(100 + trial, n, diagonal=False) + np.diag(scale * rng.standard_normal(n))
        assert max(abs(float(v)) for v in complete_squares(M, np.zeros(n)).forms.ravel()) <= 15.0


@pytest.mark.parametrize("side", [1, -1])
def test_a_pair_is_squared_along_the_better_diagonal(side):
    """Of e_i + e_j and e_i - e_j the first square is taken along the one where it is at least half of the entry."""
    rng = np.random.default_rng(18)
    for n in (2, MAX_RATIONAL_SIZE + 4):
        for entry in (1.0, -1.0):
            M = np.zeros((n, n))
            M[0, 1] = M[1, 0] = entry
            M[[0, 1], [0, 1]] = side * entry * rng.uniform(0.3, 0.6, 2)
            rows = SparseRows.of_lists(
                [[0, 1], [0, 1], *[[]] * (n - 2)], [M[0, :2].tolist(), M[1, :2].tolist(), *[[]] * (n - 2)]
            )
            for squares in (complete_squares(M, np.zeros(n)), sparse_squares(rows, np.zeros(n))):
                assert len(squares.weights) == 2
                assert abs(squares.weights[0]) >= 0.5
                assert np.sign(float(squares.weights[0])) == side * entry


@pytest.mark.parametrize("kind", ["definite", "indefinite", "zero diagonal", "singular"])
def test_reconstruction_in_floats(kind):
    """Above the rational size: each of r updates rounds three times, so 4 r u times all that was added up."""
    n = MAX_RATIONAL_SIZE + 5
    made = {
        "definite": lambda: symmetric(11, n) @ symmetric(11, n),
        "indefinite": lambda: symmetric(12, n),
        "zero diagonal": lambda: symmetric(13, n, diagonal=False),
        "singular": lambda: singular(14, n, 4),
    }
    M = made[kind]()
    M = (M + M.T) / 2
    b = np.random.default_rng(15).standard_normal(n)
    squares = complete_squares(M, b)
    assert squares.forms.dtype == np.float64
    if kind == "singular":
        # What is left after four squares is rounding, below the floor 4 n u max|M|, and must not become a square.
        assert np.count_nonzero(squares.weights) == 4
    matrix, size, linear = total(squares)
    floor = 4 * n * U * abs(M).max()
    assert np.all(abs(matrix - M) <= 4 * n * U * (size + abs(M)) + floor)
    linear_size = sum(abs(beta * form) for form, beta in zip(squares.forms, squares.linear, strict=True))
    assert np.all(abs(linear - b) <= 4 * n * U * (linear_size + abs(b)))


def test_other_exact_numbers_stay_exact():
    M = fractions(np.array([[0.0, 3.0, 1.0], [3.0, 0.0, 0.0], [1.0, 0.0, 7.0]])) / 3
    squares = complete_squares(M, np.array([Fraction(1, 3)] * 3))
    matrix, _, linear = total(squares)
    assert np.all(matrix == M) and np.all(linear == Fraction(1, 3))


def test_the_matrix_given_is_not_changed():
    M, b = symmetric(16, 4), np.ones(4)
    kept = M.copy()
    complete_squares(M, b)
    assert np.array_equal(M, kept) and np.array_equal(b, np.ones(4))


@pytest.mark.parametrize(
    "offsets",
    [
        ExactSums((1,), ((1,), (2**600,)), (3, 1)),
        ReductionSteps((((0,), ({0: 1.0},)), ((1,), ({1: 2.0**-600},))), (1, 0)),
    ],
    ids=["exact", "reduced"],
)
def test_offsets_beyond_float64_are_refused(offsets):
    """Any of them, not the first one alone; large ones that are numbers are given."""
    assert np.all(np.isfinite(offsets.at(np.array([1.0, 2.0**400]))))
    for size in (2.0**600, -(2.0**600)):
        with pytest.raises(OverflowError, match="too large for"):
            offsets.at(np.array([1.0, size]))
