"""Plot data of quantized fluids: fields on a grid, of one matrix or of two."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow
from coadjoint.systems.fluids.two_field_fluids import fluid_of as fluid_of_system
from coadjoint.systems.matrices.fluid_system import FluidSystem, large_scales

Floats = npt.NDArray[np.float64]


def fluid_of(drawn: PlottedRun) -> FluidSystem:
    """Return the fluid system of a run (of two fields, that of the vorticity); raise CannotShow for other systems."""
    found = fluid_of_system(drawn.unforced)
    if found is None:
        raise CannotShow(f"{drawn.unforced.name} has no vorticity to show; sphere_euler and torus_euler have")
    return found


def vorticity_of(state: Any) -> npt.NDArray[Any]:
    """Return the vorticity matrix: the state, or the second of two fields."""
    W = np.asarray(state)
    return W[1] if W.ndim == 3 else W


def carried_field(state: Any) -> npt.NDArray[Any]:
    """Return the matrix of the carried field, of constant spectrum: the state, or the first of two fields."""
    W = np.asarray(state)
    return W[0] if W.ndim == 3 else W


def part_on_grid(fluid: FluidSystem, state: Any, part: str, shape: tuple[int, int]) -> Floats:
    """Evaluate a part of the vorticity, the stream function or the carried field of a state on a grid."""
    if part == "carried":
        return fluid.to_grid(carried_field(state), shape)
    W = vorticity_of(state)
    shown = fluid.relative(W)
    if part != "all":
        P = fluid.stream_of(W)
        large = large_scales(P, shown)
        shown = {"stream": P, "large": large, "small": shown - large}[part]
    return fluid.to_grid(shown, shape)
