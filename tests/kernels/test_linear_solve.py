"""The kernels' own LU factors, against exact rational solutions."""

from __future__ import annotations

import ctypes
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.kernels.library import kernels
from coadjoint.kernels.structures import address

U = 2.0**-53


def solve(A, B):
    """Return whether the matrix is regular, and the solution; four systems as lanes have the same bits, or it is -1."""
    matrix, right = A.copy(), B.copy()
    probe = kernels().probe_solve
    probe.restype = ctypes.c_int64
    size, count = ctypes.c_int64(len(A)), ctypes.c_int64(B.shape[1])
    return probe(address(matrix), size, address(right), count), right


def exact_solution(A, B):
    A = [[Fraction(v) for v in row] for row in A.tolist()]
    B = [[Fraction(v) for v in row] for row in B.tolist()]
    size = len(A)
    for k in range(size):
        pivot = next(i for i in range(k, size) if A[i][k])
        A[k], A[pivot], B[k], B[pivot] = A[pivot], A[k], B[pivot], B[k]
        for i in range(size):
            if i != k:
                factor = A[i][k] / A[k][k]
                A[i] = [a - factor * b for a, b in zip(A[i], A[k], strict=True)]
                B[i] = [a - factor * b for a, b in zip(B[i], B[k], strict=True)]
    return np.array([[float(v / A[i][i]) for v in B[i]] for i in range(size)])


@pytest.mark.parametrize("size", [1, 2, 5, 12])
@pytest.mark.parametrize("lanes", [1, 3])
def test_solution(size, lanes):
    rng = np.random.default_rng(size)
    A, B = rng.standard_normal((size, size)), rng.standard_normal((size, lanes))
    if size > 1:
        A[0, 0] = 0.0  # needs an exchange of rows
    sound, found = solve(A, B)
    assert sound == 1
    expected = exact_solution(A, B)
    # Backward stable: the error is n^2 u times the condition number times the solution.
    bound = 4 * size**2 * U * np.linalg.cond(A) * np.max(np.abs(expected))
    assert np.max(np.abs(found - expected)) <= bound


@pytest.mark.parametrize("A", [np.zeros((2, 2)), np.ones((3, 3)), np.array([[np.nan, 1.0], [1.0, 1.0]])])
def test_singular_and_undefined_matrices_are_told(A):
    assert solve(A, np.ones((len(A), 1)))[0] == 0
