"""Rounding of exponentials of blocks that satisfy D^3 = lam D."""

import numpy as np

from rounding import UNIT_ROUNDOFF


def cubic_bound(D, theta):
    """1 + S D + C D^2: the rounding of each term, and of lam = (D^3)_ij / D_ij, whose relative error is kappa u."""
    i, j = np.unravel_index(np.argmax(abs(D)), D.shape)
    lam = np.trace(D @ D) / 2
    kappa = 8 * np.linalg.matrix_power(abs(D), 3)[i, j] / abs(lam * D[i, j])
    root = np.sqrt(abs(lam))
    grown = np.exp(root * abs(theta)) if lam > 0 else 1.0
    terms = np.linalg.norm(D) / root + np.linalg.norm(abs(D) @ abs(D)) / abs(lam)
    return UNIT_ROUNDOFF * (16 + (2 + abs(theta) * root) * kappa) * (1.0 + grown * terms)
