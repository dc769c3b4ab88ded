"""Attitudes of shifted runs: the correction for the Casimirs subtracted from the Hamiltonian, and its derivatives."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import addressof
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.kernels.library import kernels
from coadjoint.kernels.loop import NEVER_STOPPED, NamedArrays, as_c_double, kernel_loop, raise_outcome
from coadjoint.kernels.tables.compiled import address, as_structure, packer
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.methods.protocol.method import Representation
from coadjoint.program.generators import given_matrices
from coadjoint.program.group_correction import UnshiftTables, unshift_tables
from coadjoint.program.parts.casimir_shifts import quadratic_entries
from coadjoint.rounding import in_standard_mode
from coadjoint.runs.loops.loops import uncorrected_groups
from coadjoint.runs.start import Start, matrices_of
from coadjoint.runs.times import Times
from coadjoint.systems.system import System
from coadjoint.validation import SMALL_SIZE

Floats = NDArray[np.float64]
Shift = tuple[tuple[Polynomial, float], ...]

FINITE_GROWTH = 700.0  # exp overflows beyond 709
# Multiplications per call; interrupts are handled between calls.
MAX_PRODUCTS = 2e7


UNSHIFTED = ("momenta", "initial", "held", "out", "members", "first", "last", "k0", "k1", "rate", "elapsed")
"""Addresses of arrays of `members` members, ranges of members and points; X is multiplied by `rate`. `elapsed`, if not
0, is the address of times since the start by point and member, in place of those of a schedule.
"""


def unshifting(tables: UnshiftTables) -> Callable[..., None]:
    """Return the function that multiplies elements by the factor of a shift with these tables."""
    structure, width = as_structure(tables), max(np.diff(tables.begin).tolist(), default=0)
    address, packed, kernel = ctypes.byref(structure), packer("Unshifted", UNSHIFTED), kernels().unshift
    products = tables.size**3 + 30 * width**3

    @in_standard_mode
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
        """Fill out (k, members, d, d), members `first` to `last` - 1, from transposed elements at `loop_groups`.

        `elapsed` (k, members) replaces the times of the schedule.
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


class ShiftCorrection:
    """Conversion of group elements for H - sum c C, started at the unit element, to those for H."""

    # g(t) = g0 exp(-sign c t rho(grad C(x0))) g_shifted(t): gradients of Casimirs are constant in the spatial frame.

    def __init__(
        self, system: System, shift: Shift, representation: Representation, tables: UnshiftTables | None = None
    ) -> None:
        self.shift, self._system, self._representation = shift, system, representation
        # The factor of a single Casimir scales the time: a scan over factors shares the tables.
        self._rate = shift[0][1] if len(shift) == 1 else 1.0
        if tables is not None:
            self._tables = tables

    @cached_property
    def _tables(self) -> UnshiftTables:
        """Tables of the generator, whose time is multiplied by the rate."""
        shift = self.shift if len(self.shift) > 1 else ((self.shift[0][0], 1.0),)
        assert self._system.algebra is not None
        return unshift_tables(self._system.algebra, given_matrices(self._representation), self._system.sign, shift)

    @cached_property
    def _unshift(self) -> Callable[..., None]:
        return unshifting(self._tables)

    @cached_property
    def most(self) -> float:
        """Largest norm of the generator for momenta with components of at most 1."""
        return abs(self._rate) * float(np.sum(np.abs(self._tables.weight)))

    def of_system(self, system: System, factors: Sequence[float]) -> ShiftCorrection:
        """Return the correction of a system with the same algebra for other factors of the Casimirs."""
        shift = tuple((casimir, factor) for (casimir, _), factor in zip(self.shift, factors, strict=True))
        if len(shift) > 1:
            return ShiftCorrection(system, shift, self._representation)
        other = ShiftCorrection(system, shift, self._representation, self._tables)
        other._unshift = self._unshift
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        return ShiftCorrection, (self._system, self.shift, self._representation, self._tables)

    def build(self) -> None:
        _ = self._unshift

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
        arrays = out, loop_groups, start.momenta, start.groups
        self._unshift(self._rate, *arrays, first, last, schedule, elapsed)


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


class AttitudeDerivatives:
    """The attitudes A = A0 exp(t X) G of members with the elements G of their loops, X linear in the momentum x0."""

    # X = -sign sum c rho(grad C(x0)) over the Casimirs subtracted from the energy; without any A = G, started at A0.

    def __init__(
        self, system: Any, shift: Sequence[tuple[Any, float]], representation: Any, of_members: Floats | None = None
    ) -> None:
        # (casimirs,), or (members, casimirs) if members differ
        self.factors = np.array([factor for _, factor in shift]) if of_members is None else of_members
        coadjoint = matrices_of(representation) == "coadjoint"
        rho = -np.swapaxes(_dual_coadjoint(system), 1, 2) if coadjoint else representation
        # X = sum over Casimirs c and coordinates j of factors[c] x0[j] of_casimir[c, j].
        self.of_casimir = np.zeros((len(shift), system.dim, *rho.shape[1:]))
        for number, (casimir, _) in enumerate(shift):
            entries = quadratic_entries(casimir)
            assert entries is not None
            for i, j, value in zip(*entries, strict=True):
                self.of_casimir[number, j] -= system.sign * value * rho[i]

    @property
    def shifted(self) -> bool:
        return self.factors.shape[-1] > 0

    def tangents(
        self, x0: Floats, A0: Floats, times: Floats, G: Floats, dx0: Floats, dA0: Floats, factors: Floats, dG: Floats
    ) -> Floats:
        """Return the tangents (points, members, k, d, d) along k directions, from arrays with an axis of members."""
        if not self.shifted:
            return dG
        out, stride = np.empty(dG.shape), factors[0].size if factors.ndim == 3 else 0
        numbers = [np.ascontiguousarray(one) for one in (dx0, dA0, factors, dG)]
        kernel = kernel_loop("attitude_tangents")
        first, second, third, fourth = (address(one) for one in numbers)
        given = ctypes.c_int64(dG.shape[2]), first, second, third, ctypes.c_int64(stride), fourth, address(out)
        outcome = kernel(self._attitudes(x0, A0, times, G), *given, ctypes.byref(NEVER_STOPPED))
        if outcome:
            raise_outcome(outcome)
        return out

    def cotangents(
        self, x0: Floats, A0: Floats, times: Floats, G: Floats, of_attitudes: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the cotangents of x0, A0, the factors, and the elements of the loop, for those of the attitudes."""
        of_x0, of_A0, of_factors = np.zeros_like(x0), np.zeros_like(A0), np.zeros((len(x0), self.factors.shape[-1]))
        if not self.shifted:
            return of_x0, of_A0, of_factors, of_attitudes
        found = of_x0, of_A0, of_factors, np.empty_like(of_attitudes)
        given = np.ascontiguousarray(of_attitudes)
        kernel = kernel_loop("attitude_cotangents")
        run = self._attitudes(x0, A0, times, G)
        outcome = kernel(run, address(given), *map(address, found), ctypes.byref(NEVER_STOPPED))
        if outcome:
            raise_outcome(outcome)
        return found

    def _attitudes(self, x0: Floats, A0: Floats, times: Floats, G: Floats) -> Any:
        """Return the attitudes as the kernels read them."""
        arrays = [
            np.ascontiguousarray(one, dtype=np.float64) for one in (self.of_casimir, self.factors, x0, A0, times, G)
        ]
        turning, factors, *rest = (one.ctypes.data for one in arrays)
        casimirs, n, d = self.of_casimir.shape[:3]
        stride = casimirs if self.factors.ndim == 2 else 0
        run = (ctypes.c_int64 * 12)(n, d, casimirs, len(times), len(x0), turning, factors, stride, *rest)
        run.kept = arrays  # type: ignore[attr-defined]
        return ctypes.byref(run)


def _dual_coadjoint(system: Any) -> Floats:
    """Return -D_i^T, with J(x) e_i = D_i x."""
    units = np.eye(system.dim)
    J = np.array([system.algebra.structure_matrix(unit) for unit in units])
    return np.asarray(-np.transpose(J, (2, 0, 1)))
