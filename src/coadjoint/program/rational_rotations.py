"""Rational rotations, tan(phi/2) := angle/2 in place of the angle, and conditions for a Poisson map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.blocks import BlockKind
from coadjoint.program.numbers import Number, array_of, is_exact, roundoff
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import Rows, SparseRows, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.lie_poisson import LiePoissonSystem


def rational_frequencies(system: LiePoissonSystem, parts: Parts, state: Action, number: Number) -> NDArray[Any]:
    """Return the frequency w of each angle for 2/w atan(w angle/2), in exact numbers w^2, and 0 for exact angles. This
    is the exact flow of another function of l.x if the generator has the one frequency w and the angle depends on l.x
    alone; otherwise raise ValueError, unless the generator is nilpotent.
    """
    least, largest, known, _ = _frequencies(state, parts, number, squared=is_exact(number))
    # Frequencies are roots of sums of some products, rounded alike.
    known = known & np.asarray(largest - least <= 64 * roundoff(number) * largest, dtype=bool)
    turning = known & np.asarray(largest != 0, dtype=bool)
    wrong = np.flatnonzero(~known | (turning & _coupled(parts)))
    if len(wrong):
        entries = slice(*parts.forms.start[[wrong[0], wrong[0] + 1]])
        names = coordinate_names(system)
        name = " + ".join(names[i] for i in parts.forms.coordinate[entries])
        reason = "is a rotation whose angle depends on other quantities too"
        if not known[wrong[0]]:
            reason = "is neither nilpotent nor a rotation of a single frequency"
        raise ValueError(
            f'rotation="rational" would not be a Poisson map for {system.name}: the flow along {name} '
            f'{reason}; take rotation="exact"'
        )
    return largest


def _frequencies(action: Action, parts: Parts, number: Number, squared: bool = False) -> tuple[NDArray[Any], ...]:
    """Return for each angle the smallest and largest frequency of its blocks, whether all of them are nilpotent or
    rotations, and whether there are any.
    """
    run = np.repeat(np.arange(len(action.kind)), action.angles)
    q = np.arange(len(run)) - np.repeat(starts_of(action.angles)[:-1], action.angles)
    part = np.repeat(np.arange(len(parts)), np.diff(action.run))[run]
    angle, kind = parts.angle[part] + action.angle[run] + q, action.kind[run]
    first_constant = action.constant[run].astype(np.int64)
    is_rotation = kind == BlockKind.ROTATE
    first = action.constants[first_constant + np.where(is_rotation, q, 0)]
    cubic = (kind == BlockKind.CUBIC) & np.asarray(first < 0, dtype=bool)
    nilpotent = (kind == BlockKind.SHEAR) | ((kind == BlockKind.SERIES) & np.asarray(first == 0, dtype=bool))
    frequency = np.where(is_rotation, first**2 if squared else first, 0 * first)
    frequency[cubic] = -first[cubic] if squared else action.constants[first_constant[cubic] + 1]
    known, acting = np.ones(len(parts.offset), dtype=bool), np.zeros(len(parts.offset), dtype=bool)
    acting[angle] = True
    known[angle[~(is_rotation | cubic | nilpotent)]] = False
    largest = array_of(number, np.zeros(len(parts.offset), dtype=np.int64))
    np.maximum.at(largest, angle, frequency)
    least = largest.copy()
    np.minimum.at(least, angle, frequency)
    return least, largest, known, acting


def _coupled(parts: Parts) -> NDArray[np.bool_]:
    """Test for each angle whether it depends on more than its own form."""
    coupled = ~_is_along_form(parts.forms, parts.weights)
    for s, share in parts.nonlinear_shares.items():
        angles = slice(int(parts.row[s]), int(parts.row[s + 1]))
        if share.polynomial is not None:
            mixed = [e for e in share.polynomial.monomials if sum(1 for power in e if power) > 1]
            coupled[angles] = [any(e[i] for e in mixed) for i in share.coordinates]
        else:
            coupled[angles] = angles.stop - angles.start > 1
    return coupled


def _is_along_form(forms: SparseRows, weights: Rows) -> NDArray[np.bool_]:
    """Test whether the weights of each angle are a multiple of its form, up to rounding."""
    length = np.diff(weights.start)
    is_along = np.asarray((length == 0) | (length == np.diff(forms.start)))
    same = np.flatnonzero(is_along & (length > 0))
    form, weight = forms.take(same), weights.take(same)
    first = form.start[:-1][form.owner]
    left, right = weight.value * form.value[first], weight.value[first] * form.value
    # Weights and forms are rounded twice each.
    agree = np.asarray(abs(left - right) <= 8 * UNIT_ROUNDOFF * abs(left), dtype=bool)
    agree &= form.coordinate == weight.coordinate
    is_along[same[form.owner[~agree]]] = False
    return is_along


def rational_angle(angle: Any, frequency: Any, atan: Any) -> Any:
    """Return the angle 2/w atan(w angle/2) of a rational rotation of frequency w, or the angle itself for w = 0."""
    return angle if frequency == 0 else 2 / frequency * atan(frequency * angle / 2)


def rational_angle_series(angle: Any, squared_frequency: Any, count: int) -> Any:
    """Return the angle of a rational rotation for a power series of `count` terms, the first of them zero. It depends
    on the square of the frequency alone: 2/w atan(w angle/2) = angle (1 - z/3 + z^2/5 - ...), z = (w angle/2)^2.
    """
    if squared_frequency == 0:
        return angle
    z = angle * angle * (squared_frequency / 4)
    power = total = angle
    for k in range(3, count, 2):
        power = power * z * -1
        total = total + power / k
    return total


def acts_rationally(action: Action, parts: Parts, frequency: NDArray[Any]) -> NDArray[np.bool_]:
    """Test for each part whether its blocks in a representation have the frequencies of the coadjoint ones."""
    least, largest, known, acting = _frequencies(action, parts, float)
    difference = np.maximum(np.abs(least - frequency), np.abs(largest - frequency))
    agree = np.ones(len(parts), dtype=bool)
    agree[parts.part_of_angle[acting & ~(known & (difference <= 64 * UNIT_ROUNDOFF * np.abs(frequency)))]] = False
    return agree
