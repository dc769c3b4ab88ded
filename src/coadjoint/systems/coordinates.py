"""Coordinates of systems: their names, groups with units of their own, and canonical pairs beside an algebra."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import coordinate_names as default_names
from coadjoint.algebra.polynomials.monomials import names_of_basis, numbers_by_name
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import MEMBERS, STATE_DIMENSIONS, by_labels
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.registry import gallery_entry_of
from coadjoint.validation import read_choice, read_finite

Function = TypeVar("Function")

KINDS = ("momentum", "axis", "direction", "position", "angle", "constant", "memory", "carried field")
"""Kinds of coordinates; forces act on momenta unless they say otherwise."""
SPREAD = 256.0  # ratio of sizes of groups of coordinates from which each has its own unit


def coordinate_names(system: Any, count: int | None = None) -> tuple[str, ...]:
    """Return `count` (default: `dim`) names that the system or its algebra declares, else x1, x2, ..."""
    system = system.unforced
    return declared_names(system.name, system.algebra, system.dim if count is None else count)


def declared_names(title: str | None, algebra: Any, count: int) -> tuple[str, ...]:
    """Return the names of `count` coordinates of the system of this name on an algebra, or on none."""
    entry = None if title is None else gallery_entry_of(title)
    names = () if entry is None else entry.names(count)
    if names:
        return names
    basis = getattr(algebra, "basis", ())
    return names_of_basis(basis) if len(basis) == count else tuple(default_names(count))


def number_of_coordinate(names: Sequence[str], name: str) -> int:
    """Return the number of a coordinate by its name, or by one of x1, x2, ... if these name no other coordinate."""
    known = numbers_by_name(names)
    return known[name if name in known else read_choice(name, "coordinate", names)]


def coordinates_of(system: Any) -> tuple[str, ...]:
    """Return the names of the coordinates, for events and polynomials; empty for matrices, which have none."""
    return () if system.has_matrices else coordinate_names(system)


def names_for(system: Any, function: Any) -> tuple[str, ...] | None:
    """Return the names of the coordinates if a function is a text, or may have been written in names; else None."""
    written = getattr(function, "_written_names", None) is not None or hasattr(function, "summands")
    return coordinate_names(system) if written or isinstance(function, str) else None


def states_by_label(system: Any, x: Any, what: str = "x") -> Any:
    """Return labelled states of a system as an array, by the names of dimensions and coordinates; others unchanged."""
    if isinstance(x, np.ndarray | list | tuple):
        return x
    axes = STATE_DIMENSIONS[len(system.shape) - 1]
    return by_labels(x, what, axes, {"component": coordinate_names(system), **MEMBERS})


def in_coordinates_of(system: Any, function: Function) -> Function:
    """Return a function of the state; if it is a polynomial, it is printed with the coordinate names of the system."""
    named: Callable[[Sequence[str]], Any] | None = getattr(function, "named", None)
    return function if named is None else named(coordinate_names(system))


def all_in_coordinates_of(system: Any, functions: Mapping[str, Any]) -> dict[str, Any]:
    """Return functions of the state by name; polynomials are printed with the coordinate names of the system."""
    names = cache(lambda: coordinate_names(system))
    return {name: one.named(names()) if hasattr(one, "named") else one for name, one in functions.items()}


@lru_cache(maxsize=64)
def kinds_of(system: Any) -> NDArray[np.str_] | None:
    """Return the kind of each coordinate, (dim,), by the layout of the system; None if all are momenta."""
    system = system.unforced
    if len(getattr(system, "matrix_shape", ())) == 3 and not system.independent_layers:
        # Two fields: the one that the flow carries, and the vorticity.
        return np.repeat(["carried field", "momentum"], system.dim // 2)
    declared = system.layout.get("coordinates")
    if not declared:
        return None
    names = coordinate_names(system)
    return np.array([declared.get(one, declared.get(numberless(one), ("momentum",)))[0] for one in names])


def momenta_of(system: Any) -> NDArray[np.bool_] | None:
    """Return which coordinates are momenta, (dim,); None if all are."""
    kinds = kinds_of(system)
    return None if kinds is None else kinds == "momentum"


def numberless(name: str) -> str:
    """Return the name of a coordinate up to its first number: gamma of gamma3, L of L2[5]."""
    return re.split(r"[\d\[]", name, maxsplit=1)[0]


def rest_of(system: Any) -> NDArray[np.float64] | None:
    """Return the state of matrices at rest in the frame; None if it is zero, and for states that are vectors."""
    absolute = getattr(system, "absolute", None)
    rest = None if absolute is None else np.asarray(absolute(np.zeros(system.matrix_shape)))
    return None if rest is None or not rest.any() else np.asarray(system.to_vector(rest))


def check_moved(what: str, system: Any, moved: NDArray[np.bool_]) -> None:
    """Raise ValueError if any coordinate is moved that a force may not change."""
    if not moved.any():
        return
    names, kinds = coordinate_names(system), kinds_of(system)
    assert kinds is not None
    momenta = [name for name, kind in zip(names, kinds, strict=True) if kind == "momentum"]
    first = int(np.argmax(moved))
    raise ValueError(
        f"{what} changes {names[first]} of {system.name}, a coordinate of the kind {kinds[first]}; forces act on "
        f"momenta ({', '.join(momenta[:3])}{', ...' if len(momenta) > 3 else ''}), so let it be zero for the others"
    )


@lru_cache(maxsize=16)
def moving_others(system: Any) -> NDArray[np.bool_] | None:
    """Return the coordinates whose brackets change others than momenta, (n,); None if all are momenta."""
    momenta = momenta_of(system)
    if momenta is None:
        return None
    moving, (i, j, _, _) = np.zeros(system.dim, dtype=bool), system.algebra.triples
    moving[j[~momenta[i]]] = moving[i[~momenta[j]]] = True
    for k, inertia in enumerate(getattr(system, "inertias", ())):
        if not inertia.tensor.any():  # of points, which do not turn
            moving[turned_by_bracket(system, k)] = True
    return moving


def turned_by_bracket(system: Any, body: int) -> slice:
    """Return the coordinates with which the bracket turns a body: its axes, or without them its momentum."""
    return slice(12 * body + 3, 12 * (body + 1)) if system.has_attitude else slice(0, 3)


def moved_by(system: Any, used: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the coordinates other than momenta that brackets with these coordinates change."""
    momenta: Any = momenta_of(system)
    moved, (i, j, _, _) = np.zeros(system.dim, dtype=bool), system.algebra.triples
    moved[i[used[j]]] = moved[j[used[i]]] = True
    return np.asarray(moved & ~momenta)


class Spins(NamedTuple):
    """The coordinates of each spin, (spins, 3) ascending, by their first, and c of its brackets [e_a, e_b] = c e_d."""

    coordinates: NDArray[np.int64]
    constants: NDArray[np.float64]
    rounded: bool
    """Whether the constants of the brackets of a spin differ by rounding."""


@lru_cache(maxsize=16)
def spins_in(algebra: Any) -> Spins | None:
    """Return the spins of a sum of copies of so(3) and commuting coordinates; None for any other algebra."""
    spins = _skew_triples(algebra)
    disjoint = spins is not None and len(np.unique(spins.coordinates)) == spins.coordinates.size
    return spins if disjoint else None


def has_skew_actions(algebra: Any) -> bool:
    """Return whether all brackets preserve the sum of squares, so that orbits are compact."""
    return _skew_triples(algebra) is not None


def _skew_triples(algebra: Any) -> Spins | None:
    """Return the sets of three coordinates with brackets if all constants are totally antisymmetric, else None."""
    i, j, k, c = (np.asarray(column) for column in algebra.triples)
    rows = np.sort(np.stack([i, j, k], axis=1), axis=1)
    # The constant c of [e_a, e_b] = c e_d, made invariant under cyclic permutations.
    cyclic = c * np.sign((j - i) * (k - j) * (k - i))
    sets, triple, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    triple = triple.ravel()
    constants = cyclic[np.unique(triple, return_index=True)[1]]
    equal = np.abs(cyclic - constants[triple]) <= 8 * UNIT_ROUNDOFF * np.abs(cyclic)
    if not (len(sets) and np.all(cyclic != 0) and np.all(count == 3) and np.all(equal)):
        return None
    return Spins(sets, constants.astype(np.float64), not np.array_equal(cyclic, constants[triple]))


@lru_cache(maxsize=16)
def independent_groups(algebra: Any) -> NDArray[np.int64]:
    """Return the number of the independent group of each coordinate, by their first coordinates: the brackets of
    different groups vanish, as those of different spins. Coordinates without brackets are in none, -1.
    """
    triples = np.stack([np.asarray(column) for column in algebra.triples[:3]])
    labels, changed = np.arange(algebra.dim), True
    while changed:
        before = labels.copy()
        for column in triples:
            np.minimum.at(labels, column, labels[triples].min(axis=0))
        labels = labels[labels]
        changed = not np.array_equal(labels, before)
    found = np.full(algebra.dim, -1)
    inside = np.unique(triples)
    found[inside] = np.unique(labels[inside], return_inverse=True)[1].ravel()
    return found


class CoordinateGroups:
    """The coordinates of a system in groups whose sizes may differ by any factor: momentum, position, each spin."""

    # Brackets with basis elements turn the coordinates of a group into each other; they lead from one group to others
    # never both ways. The groups are the finest sets between successive ideals that basis elements span. Without
    # structure constants, and for matrices, all coordinates are one group.

    def __init__(self, system: Any) -> None:
        self._system = system.unforced
        factors = getattr(self._system.algebra, "factors", None)
        if factors is None or len(factors) != self._system.dim or not factors.any():
            self.labels, self.count = np.zeros(self._system.dim, dtype=np.int64), 1
            return
        self.labels, self.count = factors, int(factors.max()) + 1
        self._order = np.argsort(factors, kind="stable")
        self._starts = np.flatnonzero(np.diff(factors[self._order], prepend=-1))
        self._sorted = bool((factors[:-1] <= factors[1:]).all())

    def norms(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the norms of the groups of states (..., dim), shape (..., count)."""
        if self.count == 1:
            return np.linalg.norm(states, axis=-1, keepdims=True)
        ordered = states if self._sorted else states[..., self._order]
        return np.sqrt(np.add.reduceat(ordered**2, self._starts, axis=-1))

    def sizes(self, motion: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sizes (..., count) of the groups in a motion (times, ..., dim): their largest norms."""
        # What starts at zero has at least the size of groups with its name: p2 that of p1.
        norms = self.norms(motion)
        sizes = np.max(norms, axis=0)
        if self.count > 1:
            of_kind = np.stack([sizes[..., same].max(axis=-1) for same in self._of_kind], axis=-1)
            sizes = np.where(norms[0] > 0.0, sizes, of_kind)
        return np.asarray(sizes)

    @cached_property
    def _of_kind(self) -> list[NDArray[np.int64]]:
        """For each group those whose first coordinate has the same name without its first number."""
        names = np.array(coordinate_names(self._system), dtype=object)[self._order][self._starts]
        kinds = np.array([re.sub(r"\d+", "", name, count=1) for name in names])
        return [np.flatnonzero(kinds == kind) for kind in kinds]

    def ratios(self, vectors: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest norm of a group of vectors (..., dim) relative to its size (..., count) if not zero."""
        return np.asarray(np.max(self.norms(vectors) / np.where(sizes > 0.0, sizes, np.inf), axis=-1))

    def matrix_norms(self, matrices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the norms of the blocks of matrices (..., dim, dim) on the groups, shape (..., count, count)."""
        if self.count == 1:
            return np.linalg.norm(matrices, axis=(-2, -1), keepdims=True)
        rows = np.swapaxes(self.norms(np.swapaxes(matrices, -1, -2)), -1, -2)
        return self.norms(rows)

    def units(self, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return powers of two as units of the coordinates for sizes of the groups; one if these are similar or 0."""
        found = sizes[sizes > 0.0]
        if not found.size or found.max() < SPREAD * found.min():
            return np.ones(len(self.labels))
        return np.asarray(np.exp2(np.round(np.log2(np.where(sizes > 0.0, sizes, 1.0))))[self.labels])

    def names(self) -> tuple[str, ...]:
        """Return the names of the groups, by those of their coordinates: L for L1, L2, L3; x for all coordinates."""
        if self.count == 1:
            return ("x",)
        all_names = np.array(coordinate_names(self._system), dtype=object)[self._order]
        members = [part.tolist() for part in np.split(all_names, self._starts[1:])]
        stems = [_stem(names) for names in members]
        counts = Counter(stems)
        return tuple(
            stem if stem and counts[stem] == 1 else _listed(names) for stem, names in zip(stems, members, strict=True)
        )


def _stem(names: Sequence[str]) -> str:
    """Return the common name of coordinates without their first numbers; empty if there is none."""
    if len(names) == 1:
        return names[0]
    stems = {re.sub(r"\d+", "", name, count=1) for name in names}
    return stems.pop() if len(stems) == 1 else ""


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]}, ..., {names[-1]}"


@suggest_keywords
def canonical_state(q: Any, p: Any, x: Any = ()) -> NDArray[np.float64]:
    """Return the state (q, p, 1, x) of a system whose algebra adds canonical pairs to g.

    Parameters
    ----------
    q, p : number or (pairs,)
        Positions and momenta.
    x : (g.dim,)
        Coordinates on g*.

    Returns
    -------
    (2 pairs + 1 + g.dim,) array

    Raises
    ------
    TypeError, ValueError
        Numbers that are not finite, or different numbers of positions and momenta.

    Examples
    --------
    >>> canonical_state([1, 2], [3, 4], [5])
    array([1., 2., 3., 4., 1., 5.])
    """
    positions, momenta = np.atleast_1d(read_finite(q, "q")), np.atleast_1d(read_finite(p, "p"))
    if positions.shape != momenta.shape or positions.ndim > 1:
        raise ValueError(f"q has shape {positions.shape} and p {momenta.shape}; give one number for each pair")
    return np.concatenate([positions, momenta, [1.0], read_finite(x, "x").ravel()])
