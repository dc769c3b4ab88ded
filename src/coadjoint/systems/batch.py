"""Batches: ensembles whose members are systems of the same structure with different constants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import product, repeat
from math import prod
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.shortcuts import of
from coadjoint.systems.coefficients import linear_of
from coadjoint.systems.forces.base import Force
from coadjoint.systems.lie_poisson import LiePoissonSystem, known_or_found_casimirs
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.system import System
from coadjoint.validation import read_list

SUFFIX = "_values"
"""Ending of a variable of a dataset that has the name of an axis, such as ``energy_values`` beside ``energy``."""
DIMENSIONS = frozenset(
    ("time", "component", "row", "column", "layer", "part", "invariant", "tenth", "account", "crossing")
)
"""Dimensions of datasets, whose names no axis can have."""


class Axis(NamedTuple):
    """Length of a named axis of a batch, and its coordinates: an array of numbers or text, or None."""

    length: int
    values: NDArray[Any] | None = None


class Batch:
    """Systems of the same structure, one for each member of an ensemble; `batch` makes it."""

    # Member m is distinct[owners[m]]; the last of `axes` is the fastest; unless `combined`, each has every state.
    is_batch: Literal[True] = True
    has_matrices = False
    # Members have them in common, up to parameters.
    dim = of("first.dim")
    shape = of("first.shape")
    sign = of("first.sign")
    unforced = of("first.unforced")
    forces = of("first.forces")
    labels = of("first.labels")
    flows = of("first.flows")
    has_noise = of("first.has_noise")
    has_samples = of("first.has_samples")
    states_of = of("first.states_of")
    rows_of = of("first.rows_of")

    def __init__(
        self, systems: Iterable[System], axes: Mapping[str, Axis] | None = None, combined: bool = True
    ) -> None:
        rule = "give a list of systems, one for each member"
        if isinstance(systems, System | Batch):
            raise TypeError(f"the systems of a batch are {short(systems)}; {rule}")
        self.systems: tuple[Any, ...] = read_list(systems, "systems", rule)
        if not self.systems:
            raise ValueError("the batch is empty; give at least one system")
        self.first = self.systems[0]
        numbers = dict[int, int]()
        self.owners = np.array([numbers.setdefault(id(system), len(numbers)) for system in self.systems])
        firsts = np.unique(self.owners, return_index=True)[1].tolist()
        self.distinct: tuple[Any, ...] = tuple(self.systems[m] for m in firsts)
        for m, system in zip(firsts, self.distinct, strict=True):
            if not isinstance(system, LiePoissonSystem | PoissonSystem):
                raise TypeError(
                    f"member {m} of the batch is {short(system)}; it must be a LiePoissonSystem or a PoissonSystem"
                )
            difference = _difference(self.first, system)
            if difference:
                raise ValueError(f"member {m} of the batch {difference}; members may differ only in their constants")
        self.axes, self.combined = dict(axes or {}), combined
        lengths = [axis.length for axis in self.axes.values()]
        if self.axes and prod(lengths) != len(self.systems):
            raise ValueError(f"the axes have the lengths {lengths}, and there are {len(self.systems)} systems")

    @property
    def in_numbers(self) -> Batch:
        return self

    def of_member(self, member: int) -> Any:
        return self.systems[member]

    def among(self, first: int, last: int) -> Batch:
        """Return the batch of members `first` to `last` - 1; noise keeps the numbering of this batch."""
        return selected(self, np.arange(first, last), first)

    @property
    def name(self) -> str:
        """Names of the members (the first two if they differ) and their number."""
        names = list(dict.fromkeys(system.name for system in self.distinct))
        shown = ", ".join(names[:2]) + (", ..." if len(names) > 2 else "")
        return f"batch of {len(self)} ({shown})"

    def __len__(self) -> int:
        return len(self.systems)

    def __getitem__(self, member: int) -> System:
        return self.systems[member]

    def __iter__(self) -> Iterator[System]:
        return iter(self.systems)

    def __repr__(self) -> str:
        return f"<{self.name}>"


def selected(batch: Batch, members: NDArray[np.int64], first: int = 0) -> Batch:
    """Return the batch of some members, without axes; their noise is numbered from `first`."""
    part: Batch = object.__new__(Batch)
    _, firsts, places = np.unique(batch.owners[members], return_index=True, return_inverse=True)
    # In the order of their first members.
    order = np.argsort(firsts)
    chosen = [batch.systems[m] for m in members[firsts[order]].tolist()]
    part.distinct = tuple(system.among(first, first + len(members)) for system in chosen)
    part.owners = np.argsort(order)[places]
    part.systems = tuple(part.distinct[owner] for owner in part.owners.tolist())
    part.first = part.systems[0]
    part.axes, part.combined = {}, True
    return part


def with_state_axes(batch: Batch, axes: Mapping[str, Axis]) -> Batch:
    """Return a batch with further axes, the fastest ones: each member is repeated for all their combinations."""
    count = prod(axis.length for axis in axes.values())
    repeated = [system for member in batch.systems for system in repeat(member, count)]
    return Batch(repeated, {**batch.axes, **axes})


def _difference(first: Any, other: Any) -> str:
    """Describe how the structure of a system differs from that of the first member; empty if it does not."""
    if other._kind is not first._kind:
        return f"is a {type(other).__name__} and member 0 a {type(first).__name__}"
    if other.dim != first.dim:
        return f"has dimension {other.dim} and member 0 has {first.dim}"
    if other.sign != first.sign:
        return f"has sign={other.sign:+d} and member 0 has {first.sign:+d}"
    if first.forces or other.forces:
        if first.labels != other.labels:
            own, others = (", ".join(one.labels) or "no forces" for one in (other, first))
            return f"has {own}, and member 0 has {others}"
        if [force.casimirs for force in first.forces] != [force.casimirs for force in other.forces]:
            return "has forces that keep other Casimirs than those of member 0"
        for label, force, one in zip(first.labels, first.forces, other.forces, strict=True):
            if force.random != one.random:
                own, others = ("has no noise", "has noise") if force.random else ("has noise", "has no noise")
                quiet = "member 0" if one.random else "this member"
                rule = f" (in {quiet} its temperature is 0; give a tiny one, such as 1e-30)"
                return f"{own} by {label}, and member 0 {others}{rule if hasattr(one, 'temperature') else ''}"
    if other.algebra is first.algebra is not None and other._casimirs is first._casimirs is None:
        return ""
    if first.algebra is not None and other.algebra is not first.algebra:
        if difference := _bracket_difference(first.algebra, other.algebra):
            return difference
    own_names, other_names = (
        known_or_found_casimirs(one.algebra) if one._casimirs is None else one._casimirs for one in (first, other)
    )
    if own_names.keys() != other_names.keys():
        return f"has the Casimirs {short(list(other_names))} and member 0 has {short(list(own_names))}"
    return ""


def _bracket_difference(first: Any, other: Any) -> str:
    """Describe the first bracket component that is zero in one of two algebras and not in the other; empty if none."""
    columns = first.triples[:3], other.triples[:3]
    if [one.tobytes() for one in columns[0]] == [one.tobytes() for one in columns[1]]:
        return ""
    entries, other_entries = (set(zip(*(column.tolist() for column in one), strict=True)) for one in columns)
    i, j, k = min(entries ^ other_entries)
    e, owner = first.basis, "member 0" if (i, j, k) in entries else "it"
    return f"has another algebra: only in {owner} has [{e[i]}, {e[j]}] a component along {e[k]}"


@suggest_keywords
def batch(systems: Iterable[System] | Callable[..., System], **axes: Any) -> Batch:
    """Combine systems of equal structure and different constants into one ensemble, for `integrate` and `prepare`.

    Choose it for scans over parameters: inertias, coupling constants, constants of the algebra. The result of every
    member is bit-identical to a run of it alone. For one system with many initial states give x0 of shape
    (members, n) instead; to compute an ensemble in blocks on many processors, use `integrate_ensemble`, which also
    takes a batch. A system that occurs many times in the list is prepared once.

    With named axes, a batch is a family: `integrate` and `integrate_ensemble` start every system from every state, and
    the dataset of the run has the axes as dimensions.

    Parameters
    ----------
    systems : iterable of LiePoissonSystem, or of PoissonSystem; or callable
        One for each member. They must have the same type, dimension and sign, the same nonzero brackets, and Casimirs
        of the same names. Structure constants, Hamiltonians (also functions), Casimirs and representations may differ,
        and so may the parameters of forces of the same types. With axes, a function of one value of each axis, passed
        by name, that returns a system.
    **axes : sequence
        Name -> values, such as ``inertia=[(1, 2, 2.5), (1, 2, 3)]``. Every combination is a member, the last axis the
        fastest. Values that are numbers or text are the coordinates of the axis in the dataset.

    Returns
    -------
    Batch
        For `integrate` in place of a system. Without axes x0 has shape (members, n), or (n,) if shared by all. With
        axes, x0 of shape (k, n) are states for every system, with the axis ``member`` of the dataset; x0 with the shape
        of the axes in front, (..., k, n), has states for each system. An `xarray.DataArray` names further axes: all its
        dimensions but those of a state.

    Raises
    ------
    ValueError, TypeError
        No systems, or a member of a different structure; the message names the member and the difference.

    Examples
    --------
    >>> import coadjoint as co
    >>> bodies = co.batch([co.systems.rigid_body(inertia=(1, 2, third)) for third in (2.5, 2.75, 3)])
    >>> sol = co.integrate(bodies, (0.1, 1.0, 0.1), t_span=(0, 10), step=0.1)
    >>> sol.x.shape, sol.energy.shape
    ((101, 3, 3), (101, 3))
    >>> alone = co.integrate(bodies[2], (0.1, 1.0, 0.1), t_span=(0, 10), step=0.1)
    >>> bool((sol.x[:, 2] == alone.x).all())
    True

    Parameters and initial states, with names:

    >>> family = co.batch(lambda third: co.systems.rigid_body((1, 2, third)), third=[2.5, 2.75, 3])
    >>> states = [(0.1, 1.0, 0.1), (1.0, 0.1, 0.1)]
    >>> dataset = co.integrate(family, states, t_span=(0, 10), step=0.1).to_xarray()
    >>> dataset.x.dims, dataset.x.sel(third=2.75, member=1, time=10.0).shape
    (('time', 'third', 'member', 'component'), (3,))
    """
    if not axes:
        if callable(systems) and not isinstance(systems, Iterable):
            raise TypeError(f"the systems of a batch are {short(systems)}, a function; give the values of its axes too")
        return Batch(systems)
    if not callable(systems):
        raise TypeError(
            f"batch was given the axes {', '.join(axes)} and {short(systems)}; with axes give a function of "
            "one value of each, which returns a system"
        )
    values = {name: read_list(listed, name, "give a list of values") for name, listed in axes.items()}
    for name in axes:
        check_axis_name(name)
    empty = next((name for name, listed in values.items() if not listed), None)
    if empty is not None:
        raise ValueError(f"the axis {empty} is empty; give at least one value")
    settings = [dict(zip(values, combination, strict=True)) for combination in product(*values.values())]
    named = {name: Axis(len(listed), axis_coordinates(listed)) for name, listed in values.items()}
    return Batch([systems(**setting) for setting in settings], named, combined=False)


def axis_coordinates(values: Any) -> NDArray[Any] | None:
    """Return values as coordinates of an axis: an array (k,) of numbers or text; None for anything else."""
    try:
        array = np.asarray(values)
    except ValueError:  # lists of different lengths
        return None
    if array.ndim != 1 or array.dtype.kind not in "iufbU":
        return None
    return array.astype({"b": np.int64, "u": np.int64, "i": np.int64, "f": np.float64}.get(array.dtype.kind, str))


def check_axis_name(name: str, others: Iterable[str] = ()) -> None:
    """Raise ValueError for the name of an axis that is no identifier, a dimension of every dataset, or taken."""
    if not name.isidentifier() or name.endswith(SUFFIX):
        raise ValueError(f"{short(name)} is no name of an axis; give letters, digits and underscores, no end {SUFFIX}")
    if name in DIMENSIONS or name in others:
        raise ValueError(f"the axis {name!r} has the name of another dimension of the dataset; take another name")


def differing_numbers(batch: Batch) -> dict[str, NDArray[Any]]:
    """Return the numbers in which the systems differ, over the members, by their places such as forces[0].rate."""
    numbers_of_systems = [dict(_numbers_of(system)) for system in batch.distinct]
    found = dict[str, NDArray[Any]]()
    for name in numbers_of_systems[0]:
        values = [numbers.get(name) for numbers in numbers_of_systems]
        shapes = {_shape_of_numbers(value) for value in values}
        if len(shapes) == 1 and None not in shapes:
            array = np.array(values)[batch.owners]
            for indices in np.ndindex(*array.shape[1:]):
                found[f"{name}{''.join(f'[{k}]' for k in indices)}"] = array[(slice(None), *indices)]
    return {name: values for name, values in found.items() if np.any(values != values[0])}


def _numbers_of(system: Any) -> Iterator[tuple[str, Any]]:
    """Yield the parameters of a system, the linear term of a run with inputs, and the parameters of its forces."""
    plain = system.unforced
    base = plain._base_parameters
    known = plain.parameters if base is None else {**base, "linear": linear_of(plain.hamiltonian)}
    yield from ((f"system.parameters.{name}", value) for name, value in (known or {}).items())
    for k, force in enumerate(system.forces):
        yield from _numbers_of_force(f"forces[{k}]", force)


def _numbers_of_force(place: str, force: Force) -> Iterator[tuple[str, Any]]:
    for name, value in force.parameters().items():
        if isinstance(value, Force):
            yield from _numbers_of_force(f"{place}.{name}", value)
        elif name == "arguments":
            yield from ((f"{place}.{name}.{one}", number) for one, number in value)
        else:
            yield f"{place}.{name}", value


def _shape_of_numbers(value: Any) -> tuple[int, ...] | None:
    """Return the shape of a number or of an array of numbers; None for anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged lists
        return None
    return array.shape if array.dtype.kind in "iuf" else None
