"""Domains of the parameters of initial states of fluids, as documented."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from domains.kinds import Case, Domain, not_negative, optional, positive, real, vector, whole

SPHERE, TORUS = co.systems.sphere_euler(N=8), co.systems.torus_euler(N=9)
HALF = math.pi / 2


def falling(degrees):
    return degrees**-3.0


def each(domain, per_place):
    """A number for all places, or one for each of two."""
    return domain.plus(*per_place,
        outside=([1.0], [1.0, 1.0, 1.0], [[1.0, 1.0]], [1.0, math.nan], [1.0, 1j], [1.0, True]),
                       without=tuple(v for v in domain.outside if v == [1.0, 2.0]))  # fmt: skip


PLACES = vector([[0.5, 1.0], [-0.25, 4.0]], real(), any_length=True).plus(outside=([0.5, 1.0], [[0.5, 1.0, 0.0]]))
LATITUDES = PLACES.plus(
    [[HALF, 0.0], [-HALF, 0.0]], outside=([[np.nextafter(HALF, 2.0), 0.0], [0.0, 0.0]], [[-2, 0]] * 2)
)
DEGREES = Domain(
    ((2, 4), (1, 1), [3, 4], None),
    ((0, 2), (-1, 2), (3, 2), (2, 99), (2.5, 3), (2,), (2, 3, 4), (True, 2), ("1", 2), 3, "", "2", 1j, math.nan,
     (2, 2**63)),

)  # fmt: skip
SPECTRUM = Domain(
    (None, falling, [0.0, 0.0, 1.0, 0.5, 0.25], np.array([0.0, 1.0, 0.0, 0.0, 2.0])),
    ([0.0, 0.0, -1.0, 1.0, 1.0], [0.0] * 5, [0.0, 0.0, math.nan, 1.0, 1.0], [0.0, 1j, 1.0, 1.0, 1.0],
     np.ones((2, 5)), "", "flat", 1j, True, {}, math.cos, lambda l: -l, lambda l: l[1:], lambda l: l * math.nan),
)  # fmt: skip


def per_surface(system):
    places = LATITUDES if system is SPHERE else PLACES
    return {
        "random": Case(
            system.random,
            {
                "seed": whole(0, usual=1, tried=2**63),
                "degrees": DEGREES,
                "spectrum": SPECTRUM,
                "energy": optional(positive()),
                "enstrophy": optional(positive()),
            },
            usual={"degrees": (2, 4), "energy": None, "enstrophy": None},
        ),
        "blobs": Case(
            system.blobs,
            {
                "places": places,
                "strengths": each(real(), ([1.0, -2.0], (0, 1))),
                "widths": each(positive(), ([1.0, 0.5], (1, 2))).plus(outside=([1.0, 0.0], [-1.0, 1.0])),
            },
        ),
        "patches": Case(
            system.patches,
            {
                "places": places,
                "radii": each(positive(), ([1.0, 0.5], (1, 2)))
                .plus(3.1, outside=(math.pi, 4.0, [1.0, 0.0], [-1.0, 1.0]))
                .but_called(r"\bradii\b|^a radius\b"),
                "vorticities": each(real(), ([1.0, -2.0], (0, 1))),
                "edge": optional(not_negative()),
            },
        ),
    }


WAVE = {
    "degree": whole(2, 7, usual=5),
    "order": whole(0, 5, usual=4),
    "zonal": real(1.0),
    "wave": real(1.0),
    "longitude": real(),
}
JET = {"speed": positive(1.0), "perturbation": real(0.01)}
BAND = vector((0.5, 1.0), real(), (-1.5, 1.5)).plus(outside=((1.0, 0.5), (0.5, 0.5), (-1.6, 0.0), (0.0, 1.6)))
STATES = {
    **{f"sphere, {name}": case for name, case in per_surface(SPHERE).items()},
    **{f"torus, {name}": case for name, case in per_surface(TORUS).items()},
    "sphere, rossby_haurwitz": Case(SPHERE.rossby_haurwitz, WAVE, usual={"order": 2}),
    "sphere, zonal_jet": Case(SPHERE.zonal_jet, {**JET, "band": BAND, "longitude": real()}),
    "torus, zonal_jet": Case(TORUS.zonal_jet, {**JET, "width": positive(0.3, most=0.5), "waves": whole(1, 4, usual=2)}),
}
