"""Factors that make M - c C singular: known ones, repeated ones, and those of any pencil by its eigenvalues."""

import numpy as np
import pytest
from scipy.linalg import eigh

from coadjoint.program.shifts.pencil import singular_factors

U = 2.0**-53


@pytest.mark.parametrize(
    ("matrix", "casimir", "factors"),
    [
        (np.ones((3, 3)), np.eye(3), (0.0, 0.0, 3.0)),
        (np.ones((3, 3)), -2.0 * np.eye(3), (-1.5, 0.0, 0.0)),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([1.0, 4.0]), (-0.5, 0.5)),
        # Pivots of very different sizes: the smallest one bounds the factors.
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([2.0**-10, 2.0**10]), (-1.0, 1.0)),
        (np.ones((2, 2)), -np.diag([2.0**-10, 1.0]), (-1025.0, 0.0)),
    ],
)
def test_known_factors(matrix, casimir, factors):
    """64 halvings of an interval of 4 n^2 max|M| / min|C|, and the float beyond the factor."""
    found = singular_factors(matrix, casimir)
    width = 4.0 * matrix.size * np.abs(matrix).max() / np.abs(np.diag(casimir)).min()
    assert found == pytest.approx(factors, rel=4 * U, abs=width * 2.0**-64)


def test_none_where_there_is_nothing_to_find():
    coupled = np.ones((2, 2))
    assert singular_factors(np.diag([1.0, 2.0]), np.eye(2)) == ()
    assert singular_factors(coupled, np.diag([1.0, -1.0])) == ()
    assert singular_factors(coupled, np.diag([1.0, 0.0])) == ()


@pytest.mark.parametrize("size", [2, 3, 5, 8])
@pytest.mark.parametrize("scale", [1.0, 2.0**40, 2.0**-40])
def test_they_are_generalized_eigenvalues(size, scale):
    """Found to the last bit; the eigenvalues of LAPACK are within n^2 u times the size of the pencil."""
    rng = np.random.default_rng(size)
    A, B = rng.standard_normal((2, size, size))
    M, C = scale * (A + A.T), np.eye(size) + 0.1 * (B + B.T) / size
    expected = eigh(M, C, eigvals_only=True)
    found = singular_factors(M, C)
    assert len(found) == size
    assert np.abs(found - expected).max() <= 16 * size**2 * U * np.abs(expected).max() * np.linalg.cond(C)
