"""The loop over steps for step methods: schemes that bring one compiled step of their own."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.field import Field, GroupField
from coadjoint.kernels.library import kernels
from coadjoint.kernels.watching import Watch


class StepTables(NamedTuple):
    """What a step reads: the field, the compiled values of the terms of H, the group equation, the invariants that it
    restores, and coefficients.
    """

    field: Field
    values: NDArray[np.int64]
    group: GroupField
    kept: Watch
    whole: NDArray[np.int64]
    coefficients: NDArray[np.float64]


class Stepping(NamedTuple):
    """A compiled step, by its name in the library, and what it reads. A step of the run is made of `substeps` of it.

    They have the lengths `fraction`, at the moments `moment`, in units of the step. `step` is the address of the step.
    `serial` is the number that the loop gives to the tables when it first reads them.
    """

    step: NDArray[np.int64]
    substeps: int
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]
    tables: StepTables
    serial: int = 0


STEPS: dict[int, Any] = {}
"""The steps that tables of this process bring, by their addresses: in another process they stand elsewhere."""


def step_address(step: Any) -> int:
    """Return the address of the step that a scheme brings.

    Parameters
    ----------
    step : str or object
        The name that its C++ file gives it (`STEP_SCHEME`) in this library, or a step that was compiled apart and has
        an ``address``.

    Raises
    ------
    ValueError
        The library has no step of this name.
    """
    if not isinstance(step, str):
        STEPS[int(step.address)] = step
        return int(step.address)
    try:
        found = getattr(kernels(), f"{step}_step")
    except AttributeError as error:
        raise ValueError(
            f"the kernels have no step {step!r}; its C++ file must stand beside the scheme when they are built"
        ) from error
    address = ctypes.cast(found, ctypes.c_void_p).value or 0
    STEPS[address] = step
    return address


STEP_LOOP = "stepping_advance"
"""The name of the loop, which takes the steps of a scheme by the step that its tables bring."""
