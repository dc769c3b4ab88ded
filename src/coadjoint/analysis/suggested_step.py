"""Step size for a bound on the energy error, from the modified Hamiltonian."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.analysis.backward_error.modified_hamiltonian import check_system_and_scheme, modified_hamiltonian
from coadjoint.analysis.short_motion import short_motion
from coadjoint.long_operations import long_operation
from coadjoint.methods.protocol.method import Method
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_finite, read_positive

HALVINGS = 40


@long_operation("suggest_step")
def suggest_step(
    system: LiePoissonSystem, method: Method | str | Mapping[str, Any], x0: npt.ArrayLike, energy: float
) -> float:
    """Return the largest step at which the energy stays within a bound, from the modified Hamiltonian.

    A run preserves H + h^p H_p + ..., so its energy varies as h^p H_p does along the motion, for any length of the run.
    Choose it to control the energy error. `choose` selects scheme and step for an error of the momentum over a span.

    Parameters
    ----------
    system : LiePoissonSystem
        With a polynomial Hamiltonian that does not depend on time.
    method : Method, str or mapping
        A splitting or a composition of splittings, or its name as in `integrate`.
    x0 : array_like, shape (n,) or (k, n)
        The initial state, or a sample of states, for which the smallest step is returned.
    energy : float
        The largest accepted change of the energy, in units of H.

    Returns
    -------
    float
        A positive step, from the first two terms along a motion of 128 steps, about 30 radians. It is at most the time
        in which the motion turns by one radian; beyond that the series in h is meaningless.

    Raises
    ------
    TypeError, ValueError
        The scheme has no modified Hamiltonian on this system (see `modified_hamiltonian`), or a motion overflows.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.5)
    >>> h = suggest_step(body, co.Splitting(), x0, energy=1e-5)
    >>> run = co.integrate(body, x0, (0, 1000 * h), h, co.Splitting())
    >>> 0.9e-5 < run.drift()["energy"].absolute < 1.1e-5
    True
    """
    system, scheme = check_system_and_scheme(system, method)
    bound = read_positive(energy, "energy")
    points = np.atleast_2d(read_finite(x0, "x0"))
    if points.ndim != 2 or points.shape[1] != system.dim:
        raise ValueError(f"x0 has the shape {points.shape}; it must be ({system.dim},) or (k, {system.dim})")
    return min(_largest_step(system, scheme, start, bound) for start in points)


def _largest_step(system: LiePoissonSystem, method: Method, start: npt.NDArray[np.float64], bound: float) -> float:
    H = modified_hamiltonian(system, method, method.order + 3)
    points, rate = short_motion(system, start)
    energy = H(points, 0.0)

    def variation(h: float) -> float:
        correction = H(points, h) - energy
        return float(np.max(np.abs(correction - correction[0])))

    low, high = 0.0, 1.0 / rate
    if variation(high) <= bound:
        return high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if variation(middle) <= bound else (low, middle)
    return low
