"""Derivatives of energies by entries of parameters: complex steps of the function that a ready-made system declares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coefficients import Coefficients, Monomials
from coadjoint.systems.energy_derivatives import EnergyDerivative, FunctionDerivative
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.parameter_differences import sizes_of_entries
from coadjoint.systems.user_functions import callable_from_compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Binary exponents of the imaginary parts, relative to the entries, and the least one. Their squares are no rounding.
STEP_EXPONENT, LEAST_EXPONENT = -100, -1000
# Entries of a parameter from which several are differentiated in one evaluation, if coefficients depend on one each.
MANY_ENTRIES = 8
# Largest difference of a coefficient from that of one entry, relative to its rounding.
AGREEMENT = 16 * UNIT_ROUNDOFF
SEED = 1993


def derivative_by_steps(
    coefficients_at: Callable[[NDArray[np.complex128]], Coefficients], value: Floats, symmetric: bool
) -> EnergyDerivative:
    """Return the derivative of an energy by the entries of a parameter, exact to round-off, from complex steps."""
    # Of a symmetric matrix, half of a change is that of the mirror image.
    steps = _steps(value)

    def changes(directions: Floats) -> Coefficients:
        """Return the imaginary parts of the coefficients."""
        along = 0.5 * (directions + directions.T) if symmetric else directions
        monomials, values = coefficients_at(value + 1j * along)
        return Coefficients(monomials, values.imag).where(values.imag != 0.0)

    if value.size > MANY_ENTRIES and not symmetric:
        together = _changes_together(changes, steps)
        if together is not None:
            entries, (monomials, values) = together
            return EnergyDerivative.of_coefficients(
                value.size, [(entries, Coefficients(monomials, values / steps.ravel()[entries]))]
            )
    pieces, direction = [], np.zeros(value.shape)
    for entry, index in enumerate(np.ndindex(value.shape)):
        direction[index] = steps[index]
        monomials, values = changes(direction)
        direction[index] = 0.0
        pieces.append((np.full(len(values), entry), Coefficients(monomials, values / steps[index])))
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
    values, slopes = callable_from_compiled(function.value), callable_from_compiled(function.gradient)

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


def _changes_together(changes: Callable[[Floats], Coefficients], steps: Floats) -> tuple[Integers, Coefficients] | None:
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
