"""Attitudes of shifted runs: the factor of Casimirs subtracted from the Hamiltonian, g = g0 exp(t X) g_shifted(t).

X = -sign rho(grad C(x0)) is constant and linear in the initial momentum.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from copy import copy
from ctypes import addressof
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import NamedArrays, as_c_double
from coadjoint.kernels.tables.compiled import as_structure, packer
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.methods.protocol.method import Representation
from coadjoint.program.generators import given_matrices
from coadjoint.program.shifts.group_correction import UnshiftTables, unshift_tables
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times
from coadjoint.systems.system import System
from coadjoint.validation import SMALL_SIZE

Shift = tuple[tuple[Polynomial, float], ...]

FINITE_GROWTH = 700.0  # exp overflows beyond 709
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


def uncorrected_groups(start: Start, times: Times, saved: NamedArrays, points: int) -> NDArray[np.float64]:
    """Return the group elements (points, members, d, d) saved by the loops, transposed back."""
    return np.swapaxes(saved["group"][:points].reshape(points, *start.groups.shape), 2, 3)


def _with_tables(
    system: System, shift: Shift, representation: Representation, tables: Any, rate: float
) -> ShiftCorrection:
    correction = ShiftCorrection(system, shift, representation)
    correction._compiled_correction = CompiledShiftCorrection(tables, rate)
    return correction


class ShiftCorrection:
    """Conversion of group elements for H - sum c C, started at the unit element, to those for H."""

    # g(t) = g0 exp(-sign c t rho(grad C(x0))) g_shifted(t): gradients of Casimirs are constant in the spatial frame.

    def __init__(self, system: System, shift: Shift, representation: Representation) -> None:
        self.shift, self._system, self._representation = shift, system, representation

    @cached_property
    def _compiled_correction(self) -> CompiledShiftCorrection:
        """Tables, built lazily."""
        system, shift, rate = self._system, self.shift, 1.0
        if len(shift) == 1:
            # The factor of a single Casimir scales the time: a scan over factors shares the tables.
            ((casimir, rate),) = shift
            shift = ((casimir, 1.0),)
        rho = given_matrices(self._representation)
        assert system.algebra is not None
        return CompiledShiftCorrection(unshift_tables(system.algebra, rho, system.sign, shift), rate)

    def of_system(self, system: System, factors: Sequence[float]) -> ShiftCorrection:
        """Return the correction of a system with the same algebra for other factors of the Casimirs."""
        shift = tuple((casimir, factor) for (casimir, _), factor in zip(self.shift, factors, strict=True))
        other = ShiftCorrection(system, shift, self._representation)
        if len(shift) == 1:
            other._compiled_correction = self._compiled_correction.at_rate(shift[0][1])
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments and the tables."""
        compiled = self._compiled_correction
        return _with_tables, (self._system, self.shift, self._representation, compiled.tables, compiled.rate)

    def build(self) -> None:
        """Build the tables."""
        _ = self._compiled_correction

    @property
    def most(self) -> float:
        """Largest norm of the generator for momenta with components of at most 1."""
        return self._compiled_correction.most

    def may_overflow(self, start: Start, times: Times) -> bool:
        """Whether the exponential could overflow within the run, by an upper bound on its growth."""
        growth = self.most * abs(times.h) * times.steps
        momenta = start.momenta
        if momenta.size <= SMALL_SIZE:
            # For few numbers Python's max is five times faster than NumPy's.
            return growth * max(map(abs, momenta.ravel().tolist())) > FINITE_GROWTH
        return growth * float(np.max(np.abs(momenta))) > FINITE_GROWTH

    def at(self, start: Start, member: int, elapsed: float, loop_groups: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the group element (d, d) of a member at a time after its start, from that of the loops, (d*d,)."""
        member_start = start._replace(
            momenta=start.momenta[member : member + 1], groups=start.groups[member : member + 1]
        )
        saved, group = np.array(loop_groups), np.empty((1, *member_start.groups.shape))
        times = Times(0.0, elapsed, 1, 1, marks=np.array([1], dtype=np.int64))
        self.fill(group, member_start, times, saved.ctypes.data, 0, 1)
        return group[0, 0]

    def fill(
        self, out: NDArray[np.float64], start: Start, times: Times, loop_groups: int, first: int, last: int
    ) -> None:
        """Fill in the members `first` to `last` - 1 of `out` from the loops' elements at the address `loop_groups`."""
        schedule = schedule_of(*times[:4], False, *times[4:6])
        elapsed = None
        if times.elapsed is not None:
            elapsed = np.repeat(times.elapsed[: len(out), None], out.shape[1], axis=1)
        self._compiled_correction.fill(out, loop_groups, start.momenta, start.groups, first, last, schedule, elapsed)


def corrected_groups_each(
    corrections: Sequence[ShiftCorrection | None],
    owners: NDArray[np.int64] | None,
    start: Start,
    times: Times,
    saved: NamedArrays,
    points: int,
) -> NDArray[np.float64]:
    """Return the group elements (points, members, d, d), each corrected for the shift of its member's H."""
    members, address = len(start.groups), saved.address_of("group")
    if owners is None:
        groups, owners = np.empty((points, *start.groups.shape)), np.zeros(members, dtype=np.int64)
    else:
        groups = np.array(uncorrected_groups(start, times, saved, points), order="C")
    edges = [0, *(np.flatnonzero(np.diff(owners)) + 1).tolist(), members]
    for first, last in pairwise(edges):
        correction = corrections[owners[first]]
        if correction is not None and points:
            correction.fill(groups, start, times, address, first, last)
    return groups
