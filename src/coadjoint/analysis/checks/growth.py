"""Growth of deviations with time: bounded, like sqrt(t), linear, or another power."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WINDOWS = 5
"""Number of windows: the last half of the run, the half before it, and so on."""
KINDS = ((-0.25, 0.25, "bounded"), (0.25, 0.75, "like sqrt(t)"), (0.75, 1.25, "linear"))


class Growth(NamedTuple):
    """Growth of deviations over a run.

    Parameters
    ----------
    power : float
        The power of time, fitted over the windows; NaN if no deviation differs from zero.
    kind : str
        "none", "bounded", "like sqrt(t)", "linear", or "like t^...".
    times, sizes : ndarray, shape (windows,)
        Middle and root mean square of each window.
    """

    power: float
    kind: str
    times: Floats
    sizes: Floats


def growth(t: Floats, deviations: Floats) -> Growth:
    """Return the power of time with which the root mean square of deviations grows.

    Parameters
    ----------
    t : ndarray, shape (k,)
        Times since the start, increasing in absolute value.
    deviations : ndarray, shape (k, members)
        Deviations from the initial value.

    Returns
    -------
    Growth

    Notes
    -----
    Each window is twice as long as the previous one, so the logarithm of the root mean square of a deviation c t^a
    rises by a log 2 from window to window, and the fitted slope is a. An oscillation with a period shorter than the
    windows has equal root mean squares. A kind is assigned within 1/4 of its power, half of the distance to the next
    kind. For a random walk of m members the slope has a standard deviation of about 0.3 / sqrt(m).

    Examples
    --------
    >>> t = np.linspace(0, 100, 201)
    >>> growth(t, 1e-3 * np.sin(9 * t)[:, None]).kind, growth(t, 1e-9 * t[:, None]).kind
    ('bounded', 'linear')
    """
    since = np.abs(t - t[0])
    edges = since[-1] / 2.0 ** np.arange(WINDOWS, -1, -1)
    times, sizes = [], []
    for k, (begin, end) in enumerate(pairwise(edges)):
        inside = (since > begin * (1 + 1e-9)) & (since <= end * (1 + 1e-9)) if k else (since > 0) & (since <= end)
        if np.any(inside):
            times.append(float(np.sqrt(begin * end)))
            sizes.append(float(np.sqrt(np.mean(deviations[inside] ** 2))))
    middle, size = np.array(times), np.array(sizes)
    moved = size > 0.0
    if not np.any(moved):
        return Growth(float("nan"), "none in any bit", middle, size)
    if np.count_nonzero(moved) < 3:
        return Growth(float("nan"), "not to be told", middle, size)
    power = float(np.polyfit(np.log(middle[moved]), np.log(size[moved]), 1)[0])
    kind = next((name for low, high, name in KINDS if low <= power < high), f"like t^{power:.1f}")
    return Growth(power, kind, middle, size)
