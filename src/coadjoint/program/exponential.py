"""exp(t X) of one matrix at many times: what a Casimir shift leaves out on the group."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.block_table import blocks_of
from coadjoint.program.blocks import TAYLOR_DEGREE, Block, Kind

UNIT = 2.0**-53


def exponentials(matrix: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exp(t X), by the closed form of each block of X, its eigenvectors where it is skew, else by squaring.

    Parameters
    ----------
    matrix : ndarray, shape (d, d)
        X.
    times : ndarray, shape (k,)
        The t.

    Returns
    -------
    ndarray, shape (k, d, d)
        A rotation stays orthogonal to round-off however large t is.

    Examples
    --------
    >>> quarter = exponentials(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([0.0, np.pi / 2]))
    >>> np.round(quarter[1]).tolist()
    [[0.0, -1.0], [1.0, 0.0]]
    """
    size = len(matrix)
    result = np.zeros((len(times), size, size))
    result[:] = np.eye(size)
    # Entries that are rounding beside the rest would tie blocks together that are not.
    floor = 4 * UNIT * np.max(np.abs(matrix), initial=0.0)
    entries = {(int(i), int(j)): float(matrix[i, j]) for i, j in np.argwhere(np.abs(matrix) > floor)}
    for block in blocks_of(entries, UNIT):
        own = np.array(block.coordinates)
        result[:, own[:, None], own] += _increment(block, matrix[np.ix_(own, own)], times)
    return result


def _increment(block: Block, own: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return exp(t B) - 1 of one block."""
    t = times[:, None, None]
    if block.kind == Kind.SHEAR:
        return np.asarray(t * np.array([[0.0, block.constants[0]], [0.0, 0.0]]))
    if block.kind == Kind.SCALE:
        return np.asarray(np.expm1(t * own))
    if block.kind == Kind.ROTATE:
        half = np.sin(0.5 * t * block.constants[0])
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        return np.asarray(np.sin(t * block.constants[0]) * turn - 2.0 * half * half * np.eye(2))
    if block.kind == Kind.CUBIC and block.constants[0] < 0.0:
        root = np.sqrt(-block.constants[0])
        half = np.sin(0.5 * t * root)
        return np.asarray(np.sin(t * root) / root * own + 2.0 * (half / root) ** 2 * (own @ own))
    if np.array_equal(own, -own.T):
        # i B is Hermitian: unitary to round-off at any time, where squarings lose a bit each.
        frequencies, vectors = np.linalg.eigh(1j * own)
        # What X leaves where it is must not begin to turn by rounding.
        still = np.abs(frequencies) <= 4 * len(own) * UNIT * np.max(np.abs(frequencies))
        frequencies = np.where(still, 0.0, frequencies)
        turned = np.exp(-1j * times[:, None] * frequencies)[:, None, :]
        return np.asarray((vectors * turned @ vectors.conj().T).real - np.eye(len(own)))
    return np.array([_squared(own, float(time)) for time in times]) - np.eye(len(own))


def _squared(matrix: NDArray[np.float64], time: float) -> NDArray[np.float64]:
    """Return exp(t B) by the Taylor series at t / 2^k and k squarings."""
    norm = abs(time) * float(np.max(np.sum(np.abs(matrix), axis=0), initial=0.0))
    squarings = max(0, int(np.ceil(np.log2(norm)))) if norm > 0.0 else 0
    scaled = matrix * (time / 2.0**squarings)
    result = np.eye(len(matrix))
    for k in range(TAYLOR_DEGREE, 0, -1):
        result = np.eye(len(matrix)) + scaled @ result / k
    for _ in range(squarings):
        result = result @ result
    return result
