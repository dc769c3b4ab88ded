"""Batches: ensembles whose members are systems of the same structure with different constants."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest
from typing import Any

from coadjoint.short_repr import short
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.validation import read_list

Member = LiePoissonSystem | PoissonSystem
KINDS = (LiePoissonSystem, PoissonSystem, ForcedSystem)


class Batch:
    """Systems of the same structure with different constants, one for each member of an ensemble; `batch` makes it.

    `systems` is the tuple of the members; `dim` and `sign` are common to all of them.
    """

    def __init__(self, systems: Iterable[Member | ForcedSystem]) -> None:
        rule = "give a list of systems, one for each member"
        if isinstance(systems, (*KINDS, Batch)):
            raise TypeError(f"the systems of a batch are {short(systems)}; {rule}")
        self.systems: tuple[Any, ...] = read_list(systems, "systems", rule)
        if not self.systems:
            raise ValueError("the batch is empty; give at least one system")
        for m, system in enumerate(self.systems):
            unforced = system.system if isinstance(system, ForcedSystem) else system
            if not isinstance(system, KINDS) or not isinstance(unforced, (LiePoissonSystem, PoissonSystem)):
                raise TypeError(
                    f"member {m} of the batch is {short(system)}; it must be a LiePoissonSystem or a PoissonSystem"
                )
            difference = _difference(self.systems[0], system)
            if difference:
                raise ValueError(f"member {m} of the batch {difference}; members may differ only in their constants")
        self.dim, self.sign = self.systems[0].dim, self.systems[0].sign

    def among(self, first: int, last: int) -> Batch:
        """Return the batch of members `first` to `last` - 1; noise keeps the numbering of this batch."""
        part: Batch = object.__new__(Batch)
        part.systems = tuple(
            system.numbered_from(first) if isinstance(system, ForcedSystem) else system
            for system in self.systems[first:last]
        )
        part.dim, part.sign = self.dim, self.sign
        return part

    @property
    def name(self) -> str:
        """Names of the members (the first two if they differ) and their number."""
        names = list(dict.fromkeys(system.name for system in self.systems))
        shown = ", ".join(names[:2]) + (", ..." if len(names) > 2 else "")
        return f"batch of {len(self)} ({shown})"

    def __len__(self) -> int:
        return len(self.systems)

    def __getitem__(self, member: int) -> Member:
        return self.systems[member]

    def __iter__(self) -> Iterator[Member]:
        return iter(self.systems)

    def __repr__(self) -> str:
        return f"<{self.name}>"


def _difference(first: Any, other: Any) -> str:
    """Describe how the structure of a system differs from that of the first member; empty if it does not."""
    if type(other) is not type(first):
        return f"is a {type(other).__name__} and member 0 a {type(first).__name__}"
    if other.dim != first.dim:
        return f"has dimension {other.dim} and member 0 has {first.dim}"
    if other.sign != first.sign:
        return f"has sign={other.sign:+d} and member 0 has {first.sign:+d}"
    if isinstance(first, ForcedSystem):
        inner = _difference(first.system, other.system)
        if inner or first.labels != other.labels:
            return inner or f"has the forces {', '.join(other.labels)} and member 0 has {', '.join(first.labels)}"
        preserved_casimirs = [[force.casimirs for force in system.forces] for system in (first, other)]
        if preserved_casimirs[0] != preserved_casimirs[1]:
            return "has forces that keep other Casimirs than those of member 0"
        return ""
    if first.algebra is not None and other.algebra is not first.algebra:
        difference = _bracket_difference(first.algebra, other.algebra)
        if difference:
            return difference
    for own_name, other_name in zip_longest(first.casimirs, other.casimirs):
        if own_name != other_name and set(first.casimirs) != set(other.casimirs):
            return f"has the Casimirs {short(list(other.casimirs))} and member 0 has {short(list(first.casimirs))}"
    return ""


def _bracket_difference(first: Any, other: Any) -> str:
    """Describe the first bracket component that is zero in one of two algebras and not in the other; empty if none."""
    entries, other_entries = (
        list(zip(*(a.triples[side].tolist() for side in range(3)), strict=True)) for a in (first, other)
    )
    if entries == other_entries:
        return ""
    i, j, k = min(set(entries).symmetric_difference(other_entries))
    e = first.basis
    owner = "member 0" if (i, j, k) in set(entries) else "it"
    return f"has another algebra: only in {owner} has [{e[i]}, {e[j]}] a component along {e[k]}"


def batch(systems: Iterable[Member | ForcedSystem]) -> Batch:
    """Combine systems of equal structure and different constants into one ensemble, for `integrate` and `prepare`.

    Choose it for scans over parameters: inertias, coupling constants, constants of the algebra. The result of every
    member is bit-identical to a run of it alone. For one system with many initial states give x0 of shape
    (members, n) instead; to compute an ensemble in blocks on many processors, use `integrate_ensemble`, which also
    takes a batch.

    Parameters
    ----------
    systems : iterable of LiePoissonSystem, of PoissonSystem, or of ForcedSystem
        One for each member. They must have the same type, dimension and sign, the same nonzero brackets, and Casimirs
        of the same names. Structure constants, Hamiltonians (also functions), Casimirs and representations may differ,
        and so may the parameters of forces of the same types.

    Returns
    -------
    Batch
        For `integrate` in place of a system; x0 has shape (members, n), or (n,) if shared by all.

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
    """
    return Batch(systems)
