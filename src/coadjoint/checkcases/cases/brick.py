"""NASA's check-case 2: a brick that tumbles without damping."""

from __future__ import annotations

import importlib.resources
import json
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import body_columns
from coadjoint.checkcases.cases.free_body import FREE, free_case
from coadjoint.checkcases.check_case import CheckCase, Columns
from coadjoint.checkcases.registry import checkcase

SLUG_FOOT_SQUARED = 1.3558179483314004  # kg m^2
EARTH_RATE = 7.292115e-5  # rad/s, of WGS 84
NORTH_EAST_DOWN = Rotation.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""At longitude and latitude zero, from north, east and down to axes that turn with the Earth."""


@cache
def published_case() -> dict[str, object]:
    """Return the stored case: inertia, rates, and every fifth second of five simulators."""
    file = importlib.resources.files(__package__) / "tumbling_brick.json"
    stored: dict[str, object] = json.loads(file.read_text(encoding="utf-8"))
    return stored


def published_columns(rows: npt.NDArray[np.float64]) -> Columns:
    """Return published samples in SI units, with the attitude relative to that at the start."""
    t, longitude = rows[:, 0], np.radians(rows[:, 7])
    frame = Rotation.from_rotvec((longitude + EARTH_RATE * t)[:, None] * [0.0, 0.0, 1.0]) * NORTH_EAST_DOWN
    attitudes = frame * Rotation.from_euler("ZYX", rows[:, 4:7], degrees=True)
    return {"t": t, **body_columns(np.radians(rows[:, 1:4]), attitudes[0].inv() * attitudes)}


@checkcase
def brick() -> CheckCase:
    """Return NASA's check-case 2, a brick that tumbles without damping, with the samples of five simulators."""
    stored: dict[str, object] = published_case()
    inertia = SLUG_FOOT_SQUARED * np.array(stored["inertia"], dtype=np.float64)
    rates = np.radians(np.array(stored["body_rates"], dtype=np.float64))
    simulators: dict[str, list[list[float]]] = stored["simulators"]  # type: ignore[assignment]
    return free_case(
        "brick",
        "NASA's check-case 2, a brick that tumbles without damping",
        inertia,
        rates,
        30.0,
        301,
        statement=(
            f"{FREE} In the units of the source the moments are (0.001894220, 0.006211019, 0.007194665) slug ft^2 "
            "and the rates (10, 20, 30) deg/s. The brick falls in a gravity without torque, so that its rotation "
            "is that of a free body."
        ),
        source=(
            "D. G. Murri, E. B. Jackson, R. O. Shelton, Check-Cases for Verification of 6-Degree-of-Freedom Flight "
            "Vehicle Simulations, NASA/TM-2015-218675 (2015), atmospheric check-case 2; samples of its simulators "
            "01, 02, 04, 05 and 06"
        ),
        published={f"simulator {key}": published_columns(np.array(rows)) for key, rows in simulators.items()},
    )
