"""exp(t X) of one matrix at many times: every kind of block, in both senses of turning and both directions of time."""

import numpy as np
import pytest
from scipy.linalg import expm

from coadjoint.program.block_table import blocks_of
from coadjoint.program.blocks import Kind
from coadjoint.program.exponential import exponentials

U = 2.0**-53
TIMES = np.array([0.0, 1e-3, -1e-3, 0.7, -0.7, 5.0, -5.0])


def skew(rng, n):
    B = rng.uniform(-1.0, 1.0, (n, n))
    return B - B.T


def drawn(kind, rng):
    """A matrix that is one block of a kind."""
    w = rng.uniform(0.3, 1.0) * rng.choice([-1.0, 1.0])
    if kind == "rotation":
        return np.array([[0.0, -w], [w, 0.0]])
    if kind == "shear":
        return np.array([[0.0, w], [0.0, 0.0]]) if rng.random() < 0.5 else np.array([[0.0, 0.0], [w, 0.0]])
    if kind == "scaling":
        return np.array([[w]])
    if kind == "plane":
        return rng.uniform(-1.0, 1.0, (2, 2))
    if kind == "rotation of space":
        return skew(rng, 3)
    if kind == "rotation of four dimensions":
        return skew(rng, 4)
    if kind == "rotation of five dimensions":
        return skew(rng, 5)
    return rng.uniform(-0.5, 0.5, (4, 4))


KINDS = {
    "rotation": Kind.ROTATE,
    "shear": Kind.SHEAR,
    "scaling": Kind.SCALE,
    "plane": Kind.PLANE,
    "rotation of space": Kind.CUBIC,
    "rotation of four dimensions": Kind.SERIES,
    "rotation of five dimensions": Kind.SERIES,
    "anything": Kind.SERIES,
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_block_in_both_senses(kind):
    rng = np.random.default_rng(1)
    for _ in range(12):
        own = drawn(kind, rng)
        n = len(own)
        # Among other coordinates, in any order: the table may exchange the two of a rotation.
        places = rng.permutation(n + 2)[:n]
        X = np.zeros((n + 2, n + 2))
        X[np.ix_(places, places)] = own
        entries = {(int(i), int(j)): float(X[i, j]) for i, j in np.argwhere(X != 0)}
        assert {block.kind for block in blocks_of(entries, U)} == {KINDS[kind]}
        for t, found in zip(TIMES, exponentials(X, TIMES), strict=True):
            expected = expm(t * X)
            # Some ten products of size n, in squarings that lose a bit each: |t X| is below 2^5.
            bound = 2.0**5 * 2.0**5 * n * U * max(1.0, float(np.abs(expected).max()))
            np.testing.assert_allclose(found, expected, rtol=0, atol=bound)
