"""Derivatives of the energy: by parameters, as sums of monomials or by complex steps, and gradients at many states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coefficients import EnergyCoefficients, Key, Monomials, decoded
from coadjoint.systems.coordinates import momenta_of
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.parameter_differences import sizes_of_entries

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


class DerivativeMonomial(NamedTuple):
    """A factor times a product of coordinates, each as often as its power, in the derivative by an entry."""

    coordinates: tuple[int, ...]
    entry: int
    factor: float


class FunctionDerivative(NamedTuple):
    """Functions in dH/dp: value(y) and gradient(y), with y = x[coordinates], by each of some `entries`."""

    coordinates: Integers
    entries: Integers
    value: Callable[[Any], Any]
    gradient: Callable[[Any], Any]


class EnergyDerivative(NamedTuple):
    """dH/dp for the entries p of a parameter: monomials of degree 1 and 2 by columns, others, and functions."""

    # Monomial k of the first degree is linear_factor[k] x[linear[k]], in the derivative by linear_entry[k]; of the
    # second quadratic_factor[k] x[quadratic[k, 0]] x[quadratic[k, 1]], by quadratic_entry[k].

    size: int
    linear: Integers
    linear_entry: Integers
    linear_factor: Floats
    quadratic: Integers
    quadratic_entry: Integers
    quadratic_factor: Floats
    others: tuple[DerivativeMonomial, ...] = ()
    functions: tuple[FunctionDerivative, ...] = ()

    @classmethod
    def of_monomials(cls, size: int, monomials: Sequence[DerivativeMonomial] = ()) -> EnergyDerivative:
        """Sort monomials by degree."""
        first, second = ([one for one in monomials if len(one.coordinates) == degree] for degree in (1, 2))
        return cls(
            size,
            np.array([one.coordinates[0] for one in first], dtype=np.int64),
            np.array([one.entry for one in first], dtype=np.int64),
            np.array([one.factor for one in first], dtype=np.float64),
            np.array([one.coordinates for one in second], dtype=np.int64).reshape(-1, 2),
            np.array([one.entry for one in second], dtype=np.int64),
            np.array([one.factor for one in second], dtype=np.float64),
            tuple(one for one in monomials if len(one.coordinates) not in (1, 2)),
        )

    @classmethod
    def of_coefficients(cls, size: int, pieces: Sequence[tuple[Integers, EnergyCoefficients]]) -> EnergyDerivative:
        """Sort the derivatives of coefficients, with the entry of each, by degree and entry; zeros are dropped."""
        empty = cls.of_monomials(size)
        codes, entry, factor = [empty.linear], [empty.linear], [empty.linear_factor]
        others: list[DerivativeMonomial] = []
        for entries, (monomials, factors) in pieces:
            count = len(monomials.codes)
            codes.append(monomials.codes)
            entry.append(entries[:count])
            factor.append(factors[:count])
            rest = zip(monomials.others, entries[count:].tolist(), factors[count:].tolist(), strict=True)
            others += [DerivativeMonomial(*one) for one in rest if one[2]]
        first, second = decoded(np.concatenate(codes))
        all_entries, all_factors = np.concatenate(entry), np.concatenate(factor)

        def chosen(which: NDArray[np.bool_]) -> Integers:
            found = np.flatnonzero(which & (all_factors != 0.0))
            return found[np.argsort(all_entries[found], kind="stable")]

        constant, linear, quadratic = chosen(second < 0), chosen((first < 0) & (second >= 0)), chosen(first >= 0)
        constants = zip(all_entries[constant].tolist(), all_factors[constant].tolist(), strict=True)
        others += [DerivativeMonomial((), *one) for one in constants]
        return cls(
            size,
            second[linear],
            all_entries[linear],
            all_factors[linear],
            np.stack([first[quadratic], second[quadratic]], axis=1),
            all_entries[quadratic],
            all_factors[quadratic],
            tuple(sorted(others, key=lambda one: (one.entry, len(one.coordinates), one.coordinates))),
        )

    @classmethod
    def joined(cls, pieces: Sequence[EnergyDerivative]) -> EnergyDerivative:
        """Join the derivatives by several parameters, with their entries one after the other."""
        starts = np.cumsum([0, *(piece.size for piece in pieces)]).tolist()
        moved = [
            piece._replace(
                linear_entry=piece.linear_entry + start,
                quadratic_entry=piece.quadratic_entry + start,
                others=tuple(one._replace(entry=one.entry + start) for one in piece.others),
                functions=tuple(one._replace(entries=one.entries + start) for one in piece.functions),
            )
            for start, piece in zip(starts[:-1], pieces, strict=True)
        ]

        def column(name: str) -> NDArray[Any]:
            return np.concatenate([getattr(piece, name) for piece in (cls.of_monomials(0), *moved)])

        return cls(
            size=starts[-1],
            linear=column("linear"),
            linear_entry=column("linear_entry"),
            linear_factor=column("linear_factor"),
            quadratic=column("quadratic"),
            quadratic_entry=column("quadratic_entry"),
            quadratic_factor=column("quadratic_factor"),
            others=tuple(one for piece in moved for one in piece.others),
            functions=tuple(one for piece in moved for one in piece.functions),
        )

    @property
    def as_monomials(self) -> list[DerivativeMonomial]:
        """All monomials, in the order of `entries`, with sorted coordinates; functions are left out."""
        keys: list[Key] = [(i,) for i in self.linear.tolist()] + [*map(tuple, np.sort(self.quadratic, 1).tolist())]
        low = zip(keys, self.entries.tolist(), self.coefficients.tolist(), strict=False)
        return [*(DerivativeMonomial(*one) for one in low), *self.others]

    @property
    def of_functions(self) -> EnergyDerivative:
        return self.of_monomials(self.size)._replace(functions=self.functions)

    @property
    def entries(self) -> Integers:
        """Entry of each monomial: those of the first degree, of the second, the others, and then the functions."""
        others = np.array([one.entry for one in self.others], dtype=np.int64)
        functions = (one.entries for one in self.functions)
        return np.concatenate([self.linear_entry, self.quadratic_entry, others, *functions])

    @property
    def coefficients(self) -> Floats:
        """Factor of each monomial, in the order of `entries`; it is one for functions."""
        others = np.array([one.factor for one in self.others], dtype=np.float64)
        functions = np.ones(sum(len(one.entries) for one in self.functions))
        return np.concatenate([self.linear_factor, self.quadratic_factor, others, functions])

    @property
    def apart(self) -> EnergyDerivative:
        """The monomials with factors of one, and the functions, each with an entry of its own."""
        linear, low = len(self.linear), len(self.linear) + len(self.quadratic)
        ends = low + len(self.others) + np.cumsum([0, *(len(one.entries) for one in self.functions)])
        return self._replace(
            size=int(ends[-1]),
            linear_entry=np.arange(linear),
            linear_factor=np.ones(linear),
            quadratic_entry=np.arange(linear, low),
            quadratic_factor=np.ones(low - linear),
            others=tuple(one._replace(entry=low + k, factor=1.0) for k, one in enumerate(self.others)),
            functions=tuple(
                one._replace(entries=np.arange(first, last))
                for one, first, last in zip(self.functions, ends[:-1], ends[1:], strict=True)
            ),
        )

    @property
    def monomials(self) -> tuple[Any, ...]:
        """The monomials without their factors; energies of the same ones have tables of one structure."""
        columns = (self.linear, self.linear_entry, self.quadratic, self.quadratic_entry)
        others = (one[:2] for one in self.others)
        return self.size, *(column.tobytes() for column in columns), *others, *(one.gradient for one in self.functions)

    def along(self, x: Floats, w: Floats) -> Floats:
        """Return the derivatives of dH/dp at a state (n,) along w, shape (size,)."""
        total = np.zeros(self.size)
        np.add.at(total, self.linear_entry, self.linear_factor * w[self.linear])
        i, j = self.quadratic.T
        np.add.at(total, self.quadratic_entry, self.quadratic_factor * (w[i] * x[j] + x[i] * w[j]))
        for one in self.others:
            for k, coordinate in enumerate(one.coordinates):
                rest = one.coordinates[:k] + one.coordinates[k + 1 :]
                total[one.entry] += one.factor * w[coordinate] * np.prod(x[list(rest)])
        for function in self.functions:
            total[function.entries] += function.gradient(x[function.coordinates]) @ w[function.coordinates]
        return total

    def gradient(self, x: Floats, direction: Floats) -> Floats:
        """Return the gradient (n,) at a state of the derivative of the energy along entries (size,)."""
        total = np.zeros(len(x))
        np.add.at(total, self.linear, self.linear_factor * direction[self.linear_entry])
        (i, j), weights = self.quadratic.T, self.quadratic_factor * direction[self.quadratic_entry]
        np.add.at(total, i, weights * x[j])
        np.add.at(total, j, weights * x[i])
        for one in self.others:
            for k, coordinate in enumerate(one.coordinates):
                rest = one.coordinates[:k] + one.coordinates[k + 1 :]
                total[coordinate] += direction[one.entry] * one.factor * np.prod(x[list(rest)])
        for function in self.functions:
            total[function.coordinates] += direction[function.entries] @ function.gradient(x[function.coordinates])
        return total

    def at(self, x: Floats) -> Floats:
        """Return the derivatives of the energy at states (..., n), shape (..., size)."""
        flat = x.reshape(-1, x.shape[-1])
        total = np.zeros((self.size, len(flat)))
        np.add.at(total, self.linear_entry, self.linear_factor[:, None] * flat.T[self.linear])
        i, j = self.quadratic.T
        np.add.at(total, self.quadratic_entry, self.quadratic_factor[:, None] * flat.T[i] * flat.T[j])
        for one in self.others:
            total[one.entry] += one.factor * np.prod(flat[:, list(one.coordinates)], axis=1)
        for function in self.functions:
            total[function.entries] += np.array([function.value(y) for y in flat[:, function.coordinates]]).T
        return total.T.reshape(*x.shape[:-1], self.size)


RANK = 2.0**-32  # of an eigenvalue of the scaled inverse mass, relative to the largest: below it there is no motion


class FixedVelocity(NamedTuple):
    """How momenta follow parameters at fixed velocities, the derivatives of the energy by momenta."""

    momenta: Integers
    inverse: Floats
    state: Floats

    @classmethod
    def at(cls, system: Any, x: Floats, t: float) -> FixedVelocity:
        """Return it at a state (n,); raise TypeError for a system whose coordinates are no momenta of bodies."""
        system = system.unforced
        mask = momenta_of(system)
        if system.has_matrices or (mask is None and not hasattr(system, "angular_velocity")):
            raise TypeError(
                f'fixed is "velocity", and the coordinates of {system.name} are no momenta of bodies; take "momentum"'
            )
        momenta = np.flatnonzero(np.ones(len(x), dtype=bool) if mask is None else mask)
        # The rate of a frame that turns is in the energy, and not in the angular velocity.
        state = x if system.frame_rate is None or mask is None else np.where(mask, x, 0.0)
        points = np.tile(state, (len(momenta) + 1, 1))
        points[:, momenta] = 0.0
        points[range(len(momenta)), momenta] = 1.0
        velocities = gradients_at(system, points[None], np.array([t]))[0][:, momenta]
        M = velocities[:-1] - velocities[-1]
        sizes = np.sqrt(np.abs(np.diagonal(M)))
        scale = np.where(sizes > 0.0, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
        scaled = np.linalg.pinv(scale[:, None] * M * scale, rcond=RANK, hermitian=True)
        return cls(momenta, scale[:, None] * scaled * scale, state)

    def along(self, energy: EnergyDerivative, directions: Floats) -> Floats:
        """Return the directions (k, n) of the state for those of a parameter, (k, size)."""
        rows = np.zeros((len(self.momenta), len(self.state)))
        rows[range(len(rows)), self.momenta] = 1.0
        changes = np.array([energy.along(self.state, row) for row in rows]).reshape(len(rows), energy.size)
        found = np.zeros((len(directions), len(self.state)))
        found[:, self.momenta] = -directions @ changes.T @ self.inverse
        return found

    def pull(self, energy: EnergyDerivative, of_x: Floats) -> Floats:
        """Return the cotangents of a parameter, (size,), for those of the state, (n,)."""
        w = np.zeros(len(self.state))
        w[self.momenta] = -self.inverse @ of_x[self.momenta]
        return energy.along(self.state, w)


# Binary exponents of the imaginary parts, relative to the entries, and the least one. Their squares are no rounding.
STEP_EXPONENT, LEAST_EXPONENT = -100, -1000
# Entries of a parameter from which several are differentiated in one evaluation, if coefficients depend on one each.
MANY_ENTRIES = 8
# Largest difference of a coefficient from that of one entry, relative to its rounding.
AGREEMENT = 16 * UNIT_ROUNDOFF
SEED = 1993


def derivative_by_steps(
    coefficients_at: Callable[[NDArray[np.complex128]], EnergyCoefficients], value: Floats, symmetric: bool
) -> EnergyDerivative:
    """Return the derivative of an energy by the entries of a parameter, exact to round-off, from complex steps."""
    # Of a symmetric matrix, half of a change is that of the mirror image.
    steps = _steps(value)

    def changes(directions: Floats) -> EnergyCoefficients:
        """Return the imaginary parts of the coefficients."""
        along = 0.5 * (directions + directions.T) if symmetric else directions
        monomials, values = coefficients_at(value + 1j * along)
        return EnergyCoefficients(monomials, values.imag).where(values.imag != 0.0)

    if value.size > MANY_ENTRIES and not symmetric:
        together = _changes_together(changes, steps)
        if together is not None:
            entries, (monomials, values) = together
            return EnergyDerivative.of_coefficients(
                value.size, [(entries, EnergyCoefficients(monomials, values / steps.ravel()[entries]))]
            )
    pieces, direction = [], np.zeros(value.shape)
    for entry, index in enumerate(np.ndindex(value.shape)):
        direction[index] = steps[index]
        monomials, values = changes(direction)
        direction[index] = 0.0
        pieces.append((np.full(len(values), entry), EnergyCoefficients(monomials, values / steps[index])))
    return EnergyDerivative.of_coefficients(value.size, pieces)


def functions_by_steps(
    function_at: Callable[[NDArray[np.complex128]], FunctionOfConstants], value: Floats
) -> tuple[FunctionDerivative, ...]:
    """Return the derivative of a function by those entries of a parameter on which its constants depend, if any."""
    all_steps, moved, entries = _steps(value), [], []
    for entry, index in enumerate(np.ndindex(value.shape)):
        here = np.array(value, dtype=np.complex128)
        here[index] += 1j * all_steps[index]
        function = function_at(here)
        if function.constants.imag.any():
            moved.append(function.constants)
            entries.append(entry)
    if not entries:
        return ()
    constants, steps, count = np.array(moved), all_steps.ravel()[entries], len(entries)
    values, slopes = function.value, function.gradient

    def by_entries(y: Any) -> Any:
        return np.array([values(y + 0j, constants[k]).imag / steps[k] for k in range(count)])

    def gradient(y: Any) -> Any:
        result = np.zeros((count, len(y)))
        for k in range(count):
            change = slopes(y + 0j, constants[k])
            for n in range(len(y)):
                result[k, n] = change[n].imag / steps[k]
        return result

    return (FunctionDerivative(function.coordinates, np.array(entries), by_entries, gradient),)


def _steps(value: Floats) -> Floats:
    """Return the imaginary parts by which entries are moved."""
    _, exponents = np.frexp(sizes_of_entries(value))
    return np.ldexp(1.0, np.maximum(exponents + STEP_EXPONENT, LEAST_EXPONENT))


def _changes_together(
    changes: Callable[[Floats], EnergyCoefficients], steps: Floats
) -> tuple[Integers, EnergyCoefficients] | None:
    """Return the entry on which each coefficient depends, and its change; None if some depend on several entries."""
    # The coefficients that change with all entries change as much with half of them, or not at all: those with one
    # binary digit of their numbers. Random changes confirm the entries that are found.
    found, numbers = changes(steps), np.arange(steps.size)
    entries = np.zeros(len(found.values), dtype=np.int64)
    for digit in range((steps.size - 1).bit_length()):
        part = changes(steps * (numbers >> digit & 1).reshape(steps.shape))
        if Monomials.joined([found.monomials, part.monomials]).size > found.monomials.size:
            return None
        at = found.monomials.positions(part.monomials)
        if not np.array_equal(found.values[at], part.values):
            return None
        entries[at] += 1 << digit
    weights = np.random.default_rng(SEED).uniform(1.0, 2.0, steps.shape)
    weighted = changes(steps * weights)
    if np.any(entries >= steps.size) or weighted.monomials.size != found.monomials.size:
        return None
    expected = found.values * weights.ravel()[entries]
    if np.any(np.abs(weighted.values - expected) > AGREEMENT * np.abs(expected)):
        return None
    return entries, found


@ignore_overflow
def gradients_at(system: Any, x: Floats, times: Floats) -> Floats:
    """Return grad H at states (points, members, n) and times (points,)."""
    if system.is_batch:
        members = [gradients_at(member, x[:, m : m + 1], times) for m, member in enumerate(system)]
        return np.concatenate(members, axis=1)
    system = system.unforced
    H = system.hamiltonian
    if system.has_matrices and not system.timed:
        return np.asarray(H.gradient(x))
    terms = H.terms()
    if not terms:
        return np.array(
            [[H.gradient(state, t) for state in states] for states, t in zip(x, times.tolist(), strict=True)]
        )
    total = np.zeros(x.shape)
    for term in terms:
        term.add_gradients(total, x, times.tolist())
    return total
