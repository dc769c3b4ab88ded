"""A Rossby-Haurwitz wave on the rotating sphere."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coadjoint.checkcases.check_case import CheckCase, Columns, Quantity
from coadjoint.checkcases.registry import checkcase

Floats = npt.NDArray[np.float64]

ROTATION, ZONAL, AMPLITUDE = 7.292e-5, 7.848e-6, 7.848e-6  # 1/s
WAVENUMBER, END = 4, 14 * 86400.0
POINTS = np.array([[10.0, 0.0], [30.0, 0.0], [45.0, 20.0], [60.0, 75.0], [-45.0, 130.0], [-20.0, 300.0]])
"""Latitudes and longitudes of the columns, degrees."""


@checkcase
def rossby_haurwitz() -> CheckCase:
    """Return the Rossby-Haurwitz wave of wavenumber 4 of an ideal fluid on the rotating sphere."""
    m, (latitude, longitude) = WAVENUMBER, np.radians(POINTS).T
    speed = (m * (3 + m) * ZONAL - 2.0 * ROTATION) / ((1 + m) * (2 + m))
    names = tuple(f"zeta_{k}" for k in range(1, len(POINTS) + 1))

    def motion(t: Floats) -> Columns:
        phase = m * (longitude - speed * t[:, None])
        wave = AMPLITUDE * (m * m + 3 * m + 2) * np.sin(latitude) * np.cos(latitude) ** m * np.cos(phase)
        return dict(zip(names, (2.0 * ZONAL * np.sin(latitude) - wave).T, strict=True))

    places = ", ".join(f"({a:g}, {b:g})" for a, b in POINTS)
    return CheckCase(
        name="rossby_haurwitz",
        title="a Rossby-Haurwitz wave of wavenumber 4 on the rotating sphere",
        statement=(
            "The barotropic vorticity equation without divergence, D(zeta + 2 rotation sin(lat))/Dt = 0, with the "
            "stream function psi/a^2 = -zonal sin(lat) + amplitude cos(lat)^4 sin(lat) cos(4 lon) at t = 0, zeta = "
            "Laplacian psi relative to the rotating sphere. The wave moves without change by the angle speed t in "
            "longitude. (The height of the shallow-water test of the same name is another problem.) Columns are "
            f"the relative vorticity at latitude and longitude in degrees: {places}."
        ),
        parameters={
            "rotation": (ROTATION, "rad/s"),
            "zonal": (ZONAL, "1/s"),
            "amplitude": (AMPLITUDE, "1/s"),
            "wavenumber": (WAVENUMBER, "1"),
            "end": (END, "s"),
        },
        quantities=(Quantity("vorticity", names, "1/s", "vector", "relative vorticity at the points, in their order"),),
        motion=motion,
        times=np.linspace(0.0, END, 337),
        accuracy=1e-12,
        basis="closed form",
        source=(
            "B. Haurwitz, The motion of atmospheric disturbances on the spherical earth, J. Marine Res. 3, 254 "
            "(1940); D. L. Williamson et al., J. Comput. Phys. 102, 211 (1992), case 6, for the numbers"
        ),
        results={"speed": (speed, "rad/s")},
    )
