"""Known flows on the torus: two opposite jets."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from coadjoint.validation import read_integer, read_number, read_positive

if TYPE_CHECKING:
    from coadjoint.systems.fluids.torus_euler import TorusEuler

Complexes = npt.NDArray[np.complex128]


def zonal_jet(
    system: TorusEuler, speed: float = 1.0, *, width: float = 0.3, perturbation: float = 0.01, waves: int = 2
) -> Complexes:
    """Return the state of two jets along x, eastward at y = pi/2 and westward at 3 pi/2, slightly perturbed.

    They are Bickley jets, ``speed / cosh(y/width)^2`` with the distance y from the middle, periodic on the torus.

    Parameters
    ----------
    speed : float
        Largest speed.
    width : float
        Width in radians, at most 0.5.
    perturbation : float
        Largest vorticity of the perturbation of both jets, as a fraction of ``speed/width``; with zero the flow is
        steady.
    waves : int
        Number of waves of the perturbation along x.

    Returns
    -------
    (N, N) array

    Examples
    --------
    >>> import coadjoint as co
    >>> s = co.systems.torus_euler(N=65)
    >>> W = s.zonal_jet(perturbation=0.0)
    >>> bool(np.abs(s.vector_field(W)).max() < 1e-12 * np.abs(W).max() ** 2)
    True
    """
    fast, thickness = read_positive(speed, "speed"), read_positive(width, "width")
    if thickness > 0.5:
        raise ValueError(f"width is {thickness:g}; give at most 0.5, so that the jets do not overlap")
    part = read_number(perturbation, "perturbation")
    along = read_integer(waves, "waves", 1, system.resolved_degree)
    x, y = system.grid((4 * along, max(256, 4 * system.algebra.N)))
    field = np.zeros((len(x), len(y)))
    for sign, middle in ((1, pi / 2), (-1, 3 * pi / 2)):
        for turn in (-2 * pi, 0.0, 2 * pi):
            with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are reported by from_grid
                away = (y - middle + turn) / thickness
                bell = 1 / np.cosh(away) ** 2
                # the vorticity of the speed u along x is -du/dy
                field += sign * fast / thickness * 2 * np.tanh(away) * bell
                field += part * fast / thickness * np.cos(along * x)[:, None] * bell
    return system.absolute(system.from_grid(field))
