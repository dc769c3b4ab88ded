"""Tables of the loop over steps for step methods: schemes with one compiled step of their own."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.field import Field, GroupField
from coadjoint.kernels.library import kernels
from coadjoint.kernels.recording_tables import Watch


class StepTables(NamedTuple):
    """Tables that a step reads: the field, the compiled values of the terms of H, the group equation, the invariants
    that it restores, integers, and coefficients.
    """

    field: Field
    values: NDArray[np.int64]
    group: GroupField
    kept: Watch
    whole: NDArray[np.int64]
    coefficients: NDArray[np.float64]


class Stepping(NamedTuple):
    """A compiled step, by address, and its tables; a step of the run consists of `substeps` of it.

    They have the lengths `fraction`, at the moments `moment`, in units of the step. `serial` is the number that the
    loop assigns to the tables when it first reads them.
    """

    step: NDArray[np.int64]
    substeps: int
    fraction: NDArray[np.float64]
    moment: NDArray[np.float64]
    tables: StepTables
    serial: int = 0


STEPS: dict[int, Any] = {}
"""Address -> step, for all steps in tables of this process; addresses differ in another process."""


def step_address(step: Any) -> int:
    """Return the address of a step: an object with an ``address``, or the name (`STEP_SCHEME`) that its C++ file gives
    it.

    Raise ValueError if the library has no step of this name.
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
"""Name of the loop for all schemes whose tables contain their step."""
