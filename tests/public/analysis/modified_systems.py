"""The polynomial systems that modified Hamiltonians are tried on, each with a state of size one."""

from __future__ import annotations

import numpy as np

import coadjoint as co
from moments import moments


def full(seed: int, n: int) -> np.ndarray:
    """Return a symmetric matrix with a condition number of a few."""
    B = np.random.default_rng(seed).uniform(-0.4, 0.4, (n, n))
    return np.round(np.diag(np.linspace(0.6, 1.4, n)) + (B + B.T) / n, 3)


def systems() -> dict[str, tuple[co.LiePoissonSystem, list[float]]]:
    """Return system and state by name."""
    so3, e3, so4, a37 = co.algebras.so(3), co.algebras.e(3), co.algebras.so(4), co.algebras.A3_7(1.5)
    system = co.LiePoissonSystem
    top = co.Quadratic([1.0, 0.5, 0.4, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    bent = {(2, 0, 0, 0, 0, 0): 0.5, (0, 2, 0, 0, 0, 0): 0.25, (0, 0, 2, 0, 0, 0): 0.2, (0, 0, 0, 0, 3, 0): 0.3}
    six = [1.0, 0.5, -0.4, 0.7, -1.0, 0.3]
    # <pp>/2 and a potential that is quadratic in the moments of q.
    plasma = {(0, 0, 1, 0, 0, 0, 0, 0): 0.5, (2, 0, 0, 0, 0, 0, 0, 0): 0.4, (1, 0, 0, 1, 0, 0, 0, 0): 0.3}
    return {
        "so(3)": (system(so3, co.Quadratic([1.0, 0.5, 1 / 3], linear=[0.2, 0.0, -0.3])), [1.0, 2.0, 0.5]),
        "so(3), full, body": (system(so3, co.Quadratic(full(1, 3)), sign=-1), [1.0, -1.5, 1.2]),
        "A3,7, full": (system(a37, co.Quadratic(full(2, 3))), [0.7, -0.4, 0.5]),
        "A3,7, body": (system(a37, co.Quadratic([1.0, 1.5, 0.3]), sign=-1), [0.7, 0.5, 0.6]),
        "e(3), top": (system(e3, top, sign=-1), [1.0, -0.5, 1.5, 0.6, 0.0, 0.8]),
        "e(3), cubic": (system(e3, co.Polynomial(bent)), six),
        "so(4)": (system(so4, co.Quadratic([2.0, 0.4, 0.7, 0.3, 0.5, 1.0]), sign=-1), six),
        "so(4), full": (system(so4, co.Quadratic(full(3, 6))), six),
        "moments": (system(moments(), co.Polynomial(plasma)), [1.0, 0.3, 0.8, 1.2, 0.1, 0.4, -0.2, 0.9]),
        "moments, full, body": (
            system(moments(), co.Quadratic(full(4, 8)), sign=-1),
            [0.5, 0.3, -0.4, 0.6, 0.1, 0.4, -0.2, 0.3],
        ),
    }
