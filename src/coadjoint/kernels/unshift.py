"""exp(t X) before the group elements of a run, X of a Casimir that was taken off the Hamiltonian."""

from __future__ import annotations

import ctypes
from ctypes import addressof
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import number_at
from coadjoint.kernels.library import kernels
from coadjoint.kernels.structures import packer, pointed
from coadjoint.program.unshift import UnshiftTables

# Products of numbers in one call: between two of them the interpreter hears an interrupt.
MOST_PRODUCTS = 2e7


class Unshifted(NamedTuple):
    """What of a run is turned: addresses of its arrays, of `members` members, and which members and points are meant.

    X acts `rate` times as fast. At the address `elapsed`, where it is not 0, stand the times since the start of each
    point and member, in place of a schedule.
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


class Unshifting:
    """The tables of one shift, ready to be acted by.

    Parameters
    ----------
    tables : UnshiftTables
        The generator X.
    rate : float
        It acts so many times as fast.

    Attributes
    ----------
    tables, rate
        As they were given.
    most : float
        A bound of the norm of X, for momenta whose components are at most 1.
    """

    def __init__(self, tables: UnshiftTables, rate: float) -> None:
        self._keep, self._rate = pointed(tables), rate
        self.tables, self.rate = tables, rate
        self._address, self._packed = ctypes.byref(self._keep), packer(Unshifted)
        self._unshift = kernels().unshift
        # No X is larger than that times the largest component of the momentum.
        self.most = abs(rate) * float(np.sum(np.abs(tables.weight)))
        width = max(np.diff(tables.begin).tolist(), default=0)
        self._products = tables.size**3 + 30 * width**3

    def fill(
        self,
        out: NDArray[np.float64],
        held: int,
        momenta: NDArray[np.float64],
        initial: NDArray[np.float64],
        first: int,
        last: int,
        schedule: bytes,
        elapsed: NDArray[np.float64] | None = None,
    ) -> None:
        """Fill out (k, members, d, d) with the elements of the members `first` to `last` - 1.

        Parameters
        ----------
        out : ndarray, shape (k, members, d, d)
            C-contiguous, as the other arrays.
        held : int
            Where the elements of the shifted run, started at the unit element, stand in memory: (k, members, d*d) of
            them, transposed.
        momenta, initial : ndarray, shape (members, n) and (members, d, d)
            The start; the elements at step 0 are `initial`, to the bit.
        first, last : int
            Members.
        schedule : bytes
            The steps of the run, from `schedule_of`.
        elapsed : ndarray, shape (k, members), optional
            Times since the start, in place of those of the steps.
        """
        x0, g0, whole = addressof(number_at(momenta)), addressof(number_at(initial)), addressof(number_at(out))
        points, members = out.shape[:2]
        since = 0 if elapsed is None else addressof(number_at(elapsed))
        size = int(MOST_PRODUCTS / ((last - first) * self._products)) or 1
        for k in range(0, points, size):
            stop = min(k + size, points)
            # The table as plain bytes: a tenth of the time that a structure takes.
            numbers = x0, g0, held, whole, members, first, last, k, stop, self._rate, since
            self._unshift(self._address, self._packed(*numbers), schedule)
