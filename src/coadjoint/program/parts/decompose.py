"""Choice of a splitting: parts, their order, and multiples of quadratic Casimirs to subtract from H."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import note_progress
from coadjoint.program.generators import NotSplittable
from coadjoint.program.parts.casimir_shifts import (
    QuadraticCasimir,
    Shift,
    candidate_shifts,
    count_parts,
    quadratic_casimirs,
    shifted_terms,
    without_squares,
)
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.second_order import IMPROVEMENT_FACTOR, best_orders
from coadjoint.program.parts.split import check_splits, split
from coadjoint.program.parts.squares import with_linear_offsets
from coadjoint.program.sparse_rows import sparse_row
from coadjoint.short_repr import plain, short
from coadjoint.systems.coefficients import linear_of, with_linear, with_placeholders
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_integer, read_list, read_number

SEED = 1993  # of the points at which orders are compared, the same on every machine
SAMPLES = 16  # of these points: the mean of h^2 terms is known to a quarter
# Larger dimensions keep the natural order: comparing orders costs n^3 operations.
MAX_COMPARED_DIMENSION = 24
# Multiplications allowed for trying shifts; above about 100 fully coupled coordinates, only the first are tried.
MAX_WORK = 1 << 26
MIN_SHIFTS = 8  # tried whatever they cost
WORK_PER_CONSTANT = 16  # multiplications per structure constant of a trial, measured
BODY_FLOW_CHOICES = ("free_body", "bonds")
"""Choices whose first parts rotate momenta by an attitude, not about fixed axes."""


@dataclass(frozen=True)
class ChosenParts:
    """Explicit parts: those of "auto" after a `shift`, in an `order`; `linear` coefficients count even if zero.

    With values `at` of these coefficients, each system has the shift and the order that "auto" chooses for them.
    """

    order: tuple[int, ...] = ()
    shift: tuple[tuple[str, float], ...] = ()
    linear: tuple[int, ...] = ()
    at: tuple[float, ...] = ()

    def __repr__(self) -> str:
        if self.at:
            return f"ChosenParts(linear={self.linear}, at={self.at})"
        more = f", linear={self.linear}" if self.linear else ""
        return f"ChosenParts(order={self.order}, shift={self.shift}{more})"

    def __post_init__(self) -> None:
        order = [
            read_integer(k, "a part", 0) for k in read_list(self.order, "the order of parts", "give numbers of parts")
        ]
        if sorted(order) != list(range(len(order))):
            raise ValueError(f"the order of parts {short(order)} is not a permutation of 0, 1, ...")
        object.__setattr__(self, "order", tuple(order))
        rule = "give pairs of the name of a Casimir and a factor"
        pairs = [read_list(pair, "a shift", rule) for pair in read_list(self.shift, "the shift", rule)]
        if any(len(pair) != 2 or not isinstance(pair[0], str) for pair in pairs):
            raise TypeError(f"the shift is {short(self.shift)}; {rule}")
        shift = tuple((name, read_number(factor, f"the factor of {short(name)}")) for name, factor in pairs)
        object.__setattr__(self, "shift", shift)
        linear = read_list(self.linear, "the linear coefficients that are present", "give coordinates")
        object.__setattr__(self, "linear", tuple(read_integer(k, "a coordinate", 0) for k in linear))
        at = read_list(self.at, "the values of linear coefficients", "give numbers")
        object.__setattr__(self, "at", tuple(read_number(one, "a linear coefficient") for one in at))
        if at and (order or shift or len(at) != len(linear)):
            raise ValueError(
                f"parts has {len(at)} values `at` for {len(linear)} coordinates `linear`; give as many values and no "
                "order or shift, which they choose, or no values"
            )

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> ChosenParts:
        """Construct a choice from ``{"order": [...], "shift": {...}, "linear": [...]}``, or "linear" and "at"."""
        unknown = set(mapping) - {"order", "shift", "linear", "at"}
        if unknown or not mapping.keys() & {"order", "at"}:
            raise ValueError(
                f"parts has the keys {short(list(mapping))}; it must have 'order' and may have 'shift' and 'linear', "
                "or have 'linear' and 'at'"
            )
        shift = mapping.get("shift", {})
        if not isinstance(shift, Mapping):
            raise TypeError(f"the shift is {short(shift)}; give a mapping from the name of a Casimir to a factor")
        return cls(mapping.get("order", ()), tuple(shift.items()), mapping.get("linear", ()), mapping.get("at", ()))

    def to_mapping(self) -> dict[str, Any]:
        if self.at:
            return {"linear": list(self.linear), "at": list(self.at)}
        present = {"linear": list(self.linear)} if self.linear else {}
        return {"order": list(self.order), "shift": dict(self.shift), **present}


@dataclass(frozen=True)
class Decomposition:
    """Parts in the order of a forward sweep, adding up to H - sum c C over the pairs (C, c) of `shift`.

    `shift` is None if it has too many terms. Passing `choice` as `parts` reproduces the decomposition.
    """

    parts: Parts
    shift: tuple[tuple[Polynomial, float], ...] | None
    choice: ChosenParts


def decompose(system: LiePoissonSystem, choice: Any) -> Decomposition:
    """Split H, deterministically, by the algebra and H alone; "auto" joins commuting coordinates, subtracts Casimirs if
    that removes a part or reduces the h^2 term, and orders the parts for the smallest one.
    """
    if isinstance(choice, ChosenParts):
        return _explicit_decomposition(system, choice)
    if choice in BODY_FLOW_CHOICES:
        known = _BODY_FLOW_CACHE[choice]
        if system not in known:
            from coadjoint.program.parts.free_bodies import bonds, free_bodies

            parts, shift = bonds(system) if choice == "bonds" else (free_bodies(system), ())
            known[system] = Decomposition(parts, shift, ChosenParts(tuple(range(len(parts)))))
        return known[system]
    if choice != "auto":
        parts = split(system, choice)
        return Decomposition(parts, (), ChosenParts(tuple(range(len(parts)))))
    if system not in _AUTOMATIC_CACHE:
        _AUTOMATIC_CACHE[system] = best_decomposition(system, sample_points(system.dim))
    return _AUTOMATIC_CACHE[system]


def remember(system: LiePoissonSystem, shift: Shift, parts: Parts, order: tuple[int, ...]) -> None:
    """Cache an automatic decomposition that was chosen together with those of other systems."""
    _AUTOMATIC_CACHE[system] = _decomposition(parts, quadratic_casimirs(system), ChosenParts(order, shift))


# Systems are immutable, so decompositions are cached for the lifetime of the system.
_AUTOMATIC_CACHE: WeakKeyDictionary[LiePoissonSystem, Decomposition] = WeakKeyDictionary()
_BODY_FLOW_CACHE: Mapping[str, WeakKeyDictionary[LiePoissonSystem, Decomposition]] = {
    choice: WeakKeyDictionary() for choice in BODY_FLOW_CHOICES
}
_CHECKED_CACHE: WeakKeyDictionary[LiePoissonSystem, set[Any]] = WeakKeyDictionary()
_CHOSEN_CACHE: WeakKeyDictionary[LiePoissonSystem, dict[ChosenParts, ChosenParts]] = WeakKeyDictionary()


def best_decomposition(system: LiePoissonSystem, points: NDArray[np.float64]) -> Decomposition:
    """Return the decomposition with the fewest parts, then the smallest h^2 term at `points` (k, n).

    A Casimir that is a sum of terms of H is always subtracted: in other units its flows may be the fastest ones, with
    errors that cancel only in part.
    """
    alternatives = candidates(system, len(points) > 0)
    orders = best_orders(system, [parts for _, parts in alternatives], points)

    @cache
    def angles(k: int) -> list[tuple[Any, NDArray[Any]]]:
        _, parts = alternatives[k]
        return angles_of(parts, parts.offset, parts.weights.value)

    def leaves_out(k: int, other: int) -> bool:
        fewer = len(alternatives[k][1].offset) < len(alternatives[other][1].offset)
        return fewer and bool(leave_out(angles(k), angles(other)))

    best, (order, least) = 0, orders[0]
    for k, (other_order, size) in enumerate(orders[1:], start=1):
        if leaves_out(k, best) or (size < least * IMPROVEMENT_FACTOR and not leaves_out(best, k)):
            best, order, least = k, other_order, size
    shift, parts = alternatives[best]
    return _decomposition(parts, quadratic_casimirs(system) if shift else {}, ChosenParts(order, shift))


def angles_of(parts: Parts, offset: NDArray[Any], weight: NDArray[Any]) -> list[tuple[Any, NDArray[Any]]]:
    """Return (form with columns of weights, numbers (1 + k, ...), offset first) by linear angle."""
    found, weights = [], parts.weights
    for angle in range(len(offset)):
        entries = slice(int(weights.start[angle]), int(weights.start[angle + 1]))
        coordinates, values = sparse_row(parts.forms, angle)
        key = tuple(coordinates), tuple(values), tuple(weights.coordinate[entries].tolist())
        found.append((key, np.concatenate([offset[angle : angle + 1], weight[entries]])))
    return found


def leave_out(fewer: Sequence[tuple[Any, NDArray[Any]]], more: Sequence[tuple[Any, NDArray[Any]]]) -> Any:
    """Return whether angles are other ones with some left out, by member if their numbers are."""
    held: Any = np.bool_(len(fewer) < len(more))
    for key, numbers in fewer if held else ():
        equal: Any = np.False_
        for other, others in more:
            equal = equal | np.all(numbers == others, axis=0) if key == other else equal
        held = held & equal
    return held


def candidates(system: LiePoissonSystem, comparing: bool = True) -> list[tuple[Shift, Parts]]:
    """Return the shifts that leave the fewest parts, with these parts; only one if `comparing` is False."""
    terms, casimirs = system.hamiltonian.terms(), quadratic_casimirs(system)
    unshifted = split(system, "auto")
    best: list[tuple[Shift, Parts]] = [((), unshifted)]
    fewest = len(unshifted)
    tried = fewest > 1
    if tried and not comparing and all(casimir.diagonal for casimir in casimirs.values()):
        tried = len(split(system, "auto", without_squares(terms))) < fewest
    shifts = list(candidate_shifts(system, unshifted, casimirs)) if tried else []
    # For many shifts of a large system the parts are counted without being built.
    counts = [0] * len(shifts) if comparing else count_parts(system, casimirs, shifts)
    work, spent = _shift_work(system, unshifted), 0
    for number, (shift, count) in enumerate(zip(shifts, counts, strict=True)):
        if count >= fewest:
            continue
        note_progress(f"the parts after shift {number + 1} of {len(shifts)} by Casimirs", number / len(shifts))
        spent += work
        if spent > max(MAX_WORK, MIN_SHIFTS * work) and not comparing:
            break
        parts = split(system, "auto", shifted_terms(terms, casimirs, shift))
        if len(parts) < fewest:
            best, fewest = [], len(parts)
        if not best or (comparing and len(parts) == fewest):
            best.append((shift, parts))
    return best


def _shift_work(system: LiePoissonSystem, parts: Parts) -> int:
    """Estimate the multiplications to build parts: elimination of each square, and commutators of the algebra."""
    return int(np.sum(np.diff(parts.forms.start) ** 2)) + WORK_PER_CONSTANT * system.algebra._constant_count


def check_parts(system: LiePoissonSystem, choice: Any, scheme: str) -> None:
    """Raise ValueError, naming the scheme, if a system does not split or the chosen parts do not fit it."""
    key = choice if isinstance(choice, str | tuple | ChosenParts) else None
    if key is not None and key in _CHECKED_CACHE.get(system, ()):
        return
    try:
        if choice in ("auto", "coordinates"):
            check_splits(system)
        else:
            decompose(system, choice)
    except NotSplittable as reason:
        raise ValueError(f"{scheme} cannot be used for {system.name}: {reason}") from None
    if key is not None:
        _CHECKED_CACHE.setdefault(system, set()).add(key)


def check_body_flow_inputs(system: Any, choice: str, coordinates: Sequence[int]) -> None:
    """Raise ValueError for inputs that change the axis of a part: on the coordinates of free bodies and bonds."""
    if system.has_structure_constants:
        check_parts(system, choice, "Splitting")
        bodies = decompose(system, choice).parts.bodies.values()
        occupied = {i for body in bodies for i in (*body.coordinates, *(body.other or ()))}
        affected = sorted(occupied.intersection(coordinates))
        if affected:
            name = coordinate_names(system)[affected[0]]
            raise ValueError(
                f'parts="{choice}" takes no inputs for {name} (coordinate {affected[0]}) '
                f'of {system.name}, whose axis of rotation they would move; take parts="auto"'
            )


def _explicit_decomposition(system: LiePoissonSystem, choice: ChosenParts) -> Decomposition:
    if choice.linear and max(choice.linear) >= system.dim:
        raise ValueError(f"parts names coordinate {max(choice.linear)}; {system.name} has {system.dim} of them")
    casimirs, extended, choice = quadratic_casimirs(system), system, with_order(system, choice)
    if choice.linear:
        extended = with_placeholders(system, choice.linear)
    parts = split(extended, "auto", shifted_terms(extended.hamiltonian.terms(), casimirs, choice.shift))
    if extended is not system:
        parts = with_linear_offsets(parts, linear_of(system.hamiltonian))
    if len(parts) != len(choice.order):
        raise ValueError(
            f"parts orders {len(choice.order)} parts, but {system.name} has {len(parts)} of them; "
            "choose again with Splitting.tuned"
        )
    return _decomposition(parts, casimirs, choice)


def with_order(system: LiePoissonSystem, choice: ChosenParts) -> ChosenParts:
    """Return the choice, or that of "auto" at the values of its linear coefficients."""
    if not choice.at:
        return choice
    known = _CHOSEN_CACHE.setdefault(system, {})
    if choice not in known:
        known[choice] = replace(decompose(at_linear_values(system, choice), "auto").choice, linear=choice.linear)
    return known[choice]


def at_linear_values(system: LiePoissonSystem, choice: ChosenParts) -> LiePoissonSystem:
    """Return the system for which "auto" chooses, where the linear coefficients have the values of a choice."""
    linear = linear_of(system.hamiltonian)
    linear[list(choice.linear)] = choice.at
    return with_placeholders(with_linear(system, linear), choice.linear)


def _decomposition(parts: Parts, casimirs: Mapping[str, QuadraticCasimir], choice: ChosenParts) -> Decomposition:
    shift = tuple((casimirs[name].polynomial, factor) for name, factor in choice.shift)
    return Decomposition(parts.take(np.array(choice.order, dtype=np.int64)), shift, choice)


@lru_cache(maxsize=32)
def sample_points(size: int) -> NDArray[np.float64]:
    """Return fixed points of unit length, shape (samples, n): the choice must not depend on a state."""
    if size > MAX_COMPARED_DIMENSION:
        return np.zeros((0, size))
    points = np.random.default_rng(SEED).standard_normal((SAMPLES, size))
    points /= np.sqrt(np.sum(points**2, axis=1, keepdims=True))
    points.flags.writeable = False
    return points


@plain.register(ChosenParts)
def _(value: ChosenParts) -> dict[str, Any]:
    return value.to_mapping()
