"""The free rigid body of n dimensions with its momentum as a matrix, for large n."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MAX_MATRIX_SIZE, MatrixAlgebra
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import warn_negative_mass
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Weights
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_finite


def _above_the_diagonal(dim: int) -> list[int]:
    n = math.isqrt(dim)
    return [n * i + j for i in range(n) for j in range(i + 1, n)][:8]


def _names(dim: int) -> tuple[str, ...]:
    n = math.isqrt(dim)
    return tuple(f"X{i},{j}" for i in range(1, n + 1) for j in range(1, n + 1))


def _in_all_planes() -> npt.NDArray[np.float64]:
    X = np.zeros((5, 5))
    X[np.triu_indices(5, 1)] = np.cos(np.arange(10.0))
    return X - X.T


@ready_made(
    gallery_entry=GalleryEntry(
        x0=_in_all_planes,
        t_span=(0.0, 60.0),
        step=0.05,
        caption="A body of five dimensions turns in all planes at once, with several frequencies. Its momentum is a "
        "matrix that turns, so its eigenvalues are constant.",
        pictures=(Picture("eigenvalues"),),
        components=Picture("components", chosen=_above_the_diagonal),
        coordinates=_names,
        quantity="angular momentum",
    )
)
def matrix_body(inertia: npt.ArrayLike = (1.0, 2.0, 3.0, 4.0, 5.0)) -> MatrixSystem:
    """Return the free rigid body of n dimensions, ``X' = [X, Omega]``, its momentum X a skew (n, n) matrix.

    ``Omega_ij = X_ij / (l_i + l_j)`` is the angular velocity in the body frame. Choose it instead of `so_n_body` if the
    structure constants of so(n), about n^3 of them, need too much memory, or to preserve the spectrum: steps use
    products of matrices.

    Parameters
    ----------
    inertia : (n,)
        Second moments l of the mass along the principal axes (mass times length squared), n >= 2. The sum of any two
        must be positive.

    Returns
    -------
    MatrixSystem
        On so(n). Energy ``tr(Omega^T X)/2``, the sum over planes of ``X_ij Omega_ij``: twice that of `so_n_body`.
        Casimirs tr X^2, tr X^4, ...

    Raises
    ------
    ValueError
        `inertia` has the wrong shape or is not finite, or the sum of two moments is not positive.

    Warns
    -----
    UserWarning
        A second moment is negative, which is impossible for a distribution of mass.

    Notes
    -----
    Manakov, Funct. Anal. Appl. 10, 328 (1976); Ratiu, Indiana Univ. Math. J. 29, 609 (1980).

    Examples
    --------
    >>> body = matrix_body((1.0, 1.0, 3.0, 7.0))
    >>> X = np.zeros((4, 4))
    >>> X[0, 1] = X[2, 3] = 1.0
    >>> body.energy(X - X.T)
    0.6
    """
    values = read_finite(inertia, "inertia")
    if values.ndim != 1 or not 2 <= len(values) <= MAX_MATRIX_SIZE:
        raise ValueError(f"inertia has shape {values.shape}; give n principal values, n from 2 to {MAX_MATRIX_SIZE}")
    if np.sort(values)[:2].sum() <= 0.0:
        raise ValueError(f"inertia is {short(values.tolist())}; the sum of any two moments must be positive")
    with np.errstate(over="ignore", divide="ignore"):
        sums = np.add.outer(values, values)
        # The diagonal has no effect: that of X is zero.
        np.fill_diagonal(sums, np.inf)
        inverse = -1.0 / sums
    if not (np.isfinite(sums) | np.eye(len(values), dtype=bool)).all() or not np.isfinite(inverse).all():
        raise ValueError("sums of two moments of inertia or their inverses leave the range of float64; change units")
    warn_negative_mass(values)
    parameters = {"inertia": tuple(values.tolist())}
    algebra = MatrixAlgebra("so", len(values))
    return MatrixSystem(algebra, Weights(inverse), energy_sign=-1, name="matrix_body", parameters=parameters)
