"""The flip of a body that spins about its middle axis."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ellipk

from coadjoint.checkcases.cases.free_body import FREE, free_case
from coadjoint.checkcases.check_case import CheckCase
from coadjoint.checkcases.registry import checkcase
from coadjoint.systems.bodies.inertia import read_vector

MIDDLE_RATES = (0.01, 5.0, 0.01)


@checkcase
def middle_axis_flip(
    inertia: npt.ArrayLike = (1.0, 2.0, 3.0), rates: npt.ArrayLike = MIDDLE_RATES, end: float = 30.0, samples: int = 601
) -> CheckCase:
    """Return the flips of a free body about its middle axis, with their period.

    Parameters
    ----------
    inertia : (3,)
        Three different principal moments, kg m^2.
    rates, end, samples
        As of `free_body`.
    """
    moments, w = read_vector(inertia, "inertia"), read_vector(rates, "rates")
    return free_case(
        "middle_axis_flip",
        "flips of a free body that spins about its middle axis",
        moments,
        w,
        end,
        samples,
        statement=(
            f"{FREE} The axis of the middle moment flips periodically; half the period is the time between flips. "
            "Each flip multiplies small differences of the start, also those of its rounding."
        ),
        results={"period of the rates": (period_of_rates(moments, w), "s")},
    )


def period_of_rates(moments: npt.NDArray[np.float64], w: npt.NDArray[np.float64]) -> float:
    """Return the period of the rates of a free body, 4 K(k)/lambda; ValueError for equal moments or a separatrix."""
    low, middle, high = np.sort(moments)
    if not low < middle < high:
        raise ValueError(f"inertia is {moments.tolist()}; give three different moments")
    energy2, length2 = float(moments @ w**2), float((moments * w) @ (moments * w))
    # Landau, Lifshitz, Mechanics, section 37, for 2 E I_2 < M^2; otherwise the first and third moments are exchanged.
    I1, I2, I3 = (low, middle, high) if length2 > energy2 * middle else (high, middle, low)
    rate = (I3 - I2) * (length2 - energy2 * I1) / (I1 * I2 * I3)
    k2 = (I2 - I1) * (energy2 * I3 - length2) / ((I3 - I2) * (length2 - energy2 * I1))
    if not (rate > 0.0 and 0.0 <= k2 < 1.0):
        raise ValueError(f"rates are {w.tolist()}; give a rotation that is neither permanent nor on the separatrix")
    return float(4.0 * ellipk(k2) / np.sqrt(rate))
