"""The factor exp(t X) of a Casimir subtracted from the Hamiltonian in group elements, g = g0 exp(t X) g_shifted(t).

X = -sign rho(grad C(x0)) is constant and linear in the initial momentum.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from ctypes import addressof
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import as_c_double
from coadjoint.kernels.tables.compiled import as_structure, packer
from coadjoint.program.group_correction import UnshiftTables

# Multiplications per call; interrupts are handled between calls.
MAX_PRODUCTS = 2e7


class Unshifted(NamedTuple):
    """The part of a run to process: addresses of its arrays for `members` members, and ranges of members and points. X
    is multiplied by `rate`. `elapsed`, if not 0, is the address of the times since the start of each point and member,
    instead of those of a schedule.
    """

    momenta: int
    initial: int
    held: int
    out: int
    members: int
    first: int
    last: int
    k0: int
    k1: int
    rate: float
    elapsed: int = 0


def unshifting(tables: UnshiftTables) -> Callable[..., None]:
    """Return the function that multiplies elements by the factor of a shift with these tables."""
    structure, width = as_structure(tables), max(np.diff(tables.begin).tolist(), default=0)
    address, packed, kernel = ctypes.byref(structure), packer(Unshifted), kernels().unshift
    products = tables.size**3 + 30 * width**3

    def fill(
        rate: float,
        out: NDArray[np.float64],
        loop_groups: int,
        momenta: NDArray[np.float64],
        initial: NDArray[np.float64],
        first: int,
        last: int,
        schedule: bytes,
        elapsed: NDArray[np.float64] | None = None,
    ) -> None:
        """Fill out (k, members, d, d) with the elements of the members `first` to `last` - 1, from the transposed ones
        of the shifted run at the address `loop_groups`. `elapsed` (k, members) replaces the times of the schedule.
        """
        x0, g0 = addressof(as_c_double(momenta)), addressof(as_c_double(initial))
        out_address = addressof(as_c_double(out))
        points, members = out.shape[:2]
        elapsed_address = 0 if elapsed is None else addressof(as_c_double(elapsed))
        points_per_call = int(MAX_PRODUCTS / ((last - first) * products)) or 1
        for k in range(0, points, points_per_call):
            stop = min(k + points_per_call, points)
            # Packed bytes take a tenth of the time of a ctypes structure.
            numbers = x0, g0, loop_groups, out_address, members, first, last, k, stop, rate, elapsed_address
            kernel(address, packed(*numbers), schedule)

    return fill
