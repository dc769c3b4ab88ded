"""Symmetric matrices of metrics, not all definite."""

import numpy as np


def block(*rows):
    return np.array(rows, dtype=float)


SEMIDEFINITE = {
    "zero": np.zeros((3, 3)),
    "one direction": np.outer([1.0, -2.0, 0.5], [1.0, -2.0, 0.5]),
    "a coordinate left out": block([0, 0, 0], [0, 2, 1], [0, 1, 1]),
    "two equal rows": block([1, 1, 0], [1, 1, 0], [0, 0, 3]),
    "definite": block([2, -1, 0.5], [-1, 3, 0.25], [0.5, 0.25, 1]),
}
