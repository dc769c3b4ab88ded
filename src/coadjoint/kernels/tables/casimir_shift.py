"""The factor exp(t X) of a Casimir subtracted from the Hamiltonian in group elements, g = g0 exp(t X) g_shifted(t).

X = -sign rho(grad C(x0)) is constant and linear in the initial momentum.
"""

from __future__ import annotations

import ctypes
from copy import copy
from ctypes import addressof
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import as_c_double
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.structures import as_structure, packer
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


class CompiledShiftCorrection:
    """Tables of one shift, whose generator X is multiplied by `rate`."""

    def __init__(self, tables: UnshiftTables, rate: float) -> None:
        self.tables, self.rate, self._keepalive = tables, rate, as_structure(tables)
        self._address, self._packed = ctypes.byref(self._keepalive), packer(Unshifted)
        self._kernel = kernels().unshift
        self.most = _largest_norm(tables, rate)
        width = max(np.diff(tables.begin).tolist(), default=0)
        self._products = tables.size**3 + 30 * width**3

    def at_rate(self, rate: float) -> CompiledShiftCorrection:
        """Return the same shift with another rate."""
        other = copy(self)
        other.rate, other.most = rate, _largest_norm(self.tables, rate)
        return other

    def fill(
        self,
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
        points_per_call = int(MAX_PRODUCTS / ((last - first) * self._products)) or 1
        for k in range(0, points, points_per_call):
            stop = min(k + points_per_call, points)
            # Packed bytes take a tenth of the time of a ctypes structure.
            numbers = x0, g0, loop_groups, out_address, members, first, last, k, stop, self.rate, elapsed_address
            self._kernel(self._address, self._packed(*numbers), schedule)


def _largest_norm(tables: UnshiftTables, rate: float) -> float:
    """Return the largest norm of X for momenta with components of at most 1."""
    return abs(rate) * float(np.sum(np.abs(tables.weight)))
