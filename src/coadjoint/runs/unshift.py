"""The attitude of a shifted run: what was taken off the Hamiltonian as a Casimir still turns the group element."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.exponential import exponentials
from coadjoint.systems.lie_poisson import LiePoissonSystem

Shift = Sequence[tuple[Polynomial, float]]


def unshifted(
    system: LiePoissonSystem,
    shift: Shift,
    representation: NDArray[np.float64] | str,
    x0: NDArray[np.float64],
    g0: NDArray[np.float64],
    elapsed: NDArray[np.float64],
    groups: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the group elements of the whole Hamiltonian H from those of H - sum c C, started at the unit element.

    g(t) = g0 exp(-sign c t rho(grad C(x0))) g_shifted(t): the gradient of a Casimir, carried to space, is constant.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    shift : sequence of (Polynomial, float)
        Casimirs C and factors c.
    representation : ndarray of shape (n, d, d), or "coadjoint"
        What the elements are in.
    x0 : ndarray, shape (members, n)
        Initial momenta.
    g0 : ndarray, shape (members, d, d)
        Initial elements.
    elapsed : ndarray, shape (k,)
        Times since the start.
    groups : ndarray, shape (k, members, d, d)
        Elements of the shifted run.

    Returns
    -------
    ndarray, shape (k, members, d, d)
        The elements of the run.
    """
    result = np.empty_like(groups)
    for member, x in enumerate(x0):
        gradient = sum((factor * np.asarray(casimir.gradient(x), dtype=np.float64) for casimir, factor in shift), 0 * x)
        if isinstance(representation, str):
            generator = system.algebra.coadjoint(gradient)
        else:
            generator = np.einsum("i,ijk->jk", gradient, representation)
        turned = exponentials(np.asarray(-system.sign * generator), elapsed)
        if isinstance(representation, str) and not np.array_equal(generator, -generator.T):
            # The gradient of a Casimir leaves x where it is; rounded, it would push it away in proportion to time.
            turned -= np.einsum("ki,j->kij", turned @ x - x, x / max(float(x @ x), np.finfo(float).tiny))
        result[:, member] = g0[member] @ turned @ groups[:, member]
    return result
