"""What of a quantized fluid is drawn? Its surface, and its fields on a grid."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import CannotShow
from coadjoint.systems.matrices.scale_separation import large_scales
from coadjoint.systems.sphere_euler import SphereEuler
from coadjoint.systems.torus_euler import TorusEuler

Floats = npt.NDArray[np.float64]


def fluid_of(drawn: Drawn) -> str:
    """Return the surface on which the fluid of a run flows.

    Parameters
    ----------
    drawn : Drawn
        The run.

    Returns
    -------
    {"sphere", "torus"}

    Raises
    ------
    CannotShow
        The system is no fluid on a surface.
    """
    for surface, kind in (("sphere", SphereEuler), ("torus", TorusEuler)):
        if isinstance(drawn.family, kind):
            return surface
    raise CannotShow(f"{drawn.family.name} has no vorticity to show; sphere_euler and torus_euler have")


def vorticity_of(state: Any) -> npt.NDArray[np.complex128]:
    """Return the matrix of the vorticity: the state, or the second layer of two."""
    W = np.asarray(state)
    return W[1] if W.ndim == 3 else W


def part_of_state(system: Any, state: Any, part: str, shape: tuple[int, int]) -> Floats:
    """Return a part of the vorticity, or the stream function, on a grid.

    Parameters
    ----------
    system : MatrixSystem
        With ``to_grid``.
    state : (N, N) or (2, N, N) array
        The matrix W, or with a second field before it.
    part : {"all", "large", "small", "stream"}
        As the picture has it.
    shape : (int, int)
        Of the grid.

    Returns
    -------
    ndarray
    """
    W = vorticity_of(state)
    shown = system.relative(W)
    if part != "all":
        P = system.stream_of(W)
        large = large_scales(P, shown)
        shown = {"stream": P, "large": large, "small": shown - large}[part]
    return np.asarray(system.to_grid(shown, shape))
