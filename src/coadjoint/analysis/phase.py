"""How early or late is a computed motion on its orbit?"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.given import read_finite
from coadjoint.systems.kinds import check_one_system
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.points import QUIET

MOST_ITERATIONS = 30


def phase_error(
    system: LiePoissonSystem, x0: npt.ArrayLike, t: npt.ArrayLike, x: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Return the signed phase error of computed states: by how much time they are ahead of the exact motion.

    Parameters
    ----------
    system : LiePoissonSystem
        With a closed form.
    x0 : array_like, shape (n,)
        The state at time zero.
    t : array_like, shape (k,)
        Times.
    x : array_like, shape (k, n)
        Computed states.

    Returns
    -------
    ndarray, shape (k,)
        The lead d that makes exact(t + d) the nearest point to x, in units of time; positive is early, negative
        late. Meaningful while abs(d) is less than half a period. NaN where no nearest point is found.

    Raises
    ------
    ValueError
        The states do not fit the times.
    TypeError
        No closed form is known.

    Notes
    -----
    Gauss-Newton on |x - exact(t + d)|^2: d grows by f.(x - y)/|f|^2 at y = exact(t + d), f the vector field there.

    Examples
    --------
    >>> import coadjoint as co
    >>> body, t = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([1.0, 2.0])
    >>> early = body.exact((1.0, 2.0, 0.5), t + 0.01)
    >>> phase_error(body, (1.0, 2.0, 0.5), t, early).round(12)
    array([0.01, 0.01])
    """
    check_one_system(system)
    times, states = read_finite(t, "t"), read_finite(x, "x")
    if times.ndim != 1 or states.shape != (len(times), system.dim):
        raise ValueError(
            f"x has the shape {states.shape}; it must be ({times.size}, {system.dim}), a state for each time"
        )
    return _leads(system, x0, times, states)


@QUIET
def _leads(
    system: LiePoissonSystem, x0: npt.ArrayLike, times: npt.NDArray[np.float64], states: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    lead = np.zeros(len(times))
    change = np.full(len(times), np.inf)
    for _ in range(MOST_ITERATIONS):
        y = system.exact(x0, times + lead)
        f = np.array([system.vector_field(state) for state in y])
        # Gauss-Newton converges linearly off the orbit and its last digits are round-off of the exact motion.
        change = np.einsum("ki,ki->k", f, states - y) / np.einsum("ki,ki->k", f, f)
        lead = lead + change
        if np.max(np.abs(change)) <= 2.0**-40 * max(1.0, float(np.max(np.abs(times)))):
            break
    return np.where(np.abs(change) <= 2.0**-20 * np.maximum(1.0, np.abs(times)), lead, np.nan)
