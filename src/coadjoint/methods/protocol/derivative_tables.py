"""Tables of loops that differentiate whole runs: tangent vectors forward and cotangents backward."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from coadjoint.kernels.tables.structures import unrecorded

if TYPE_CHECKING:
    from coadjoint.program.added_part import CoefficientMap
    from coadjoint.program.sources import Sources
    from coadjoint.systems.energy_derivatives import EnergyDerivative

EXACT = "exact"
ADDED_PART = "added part"
DIFFERENCES = "differences"

Kernel = str | Callable[[Any, Any, int, int], None]


class DerivativeTables(NamedTuple):
    """Tables of a scheme, and the coefficients in them that depend on parameters.

    `tables_at(h)` are those of a step h, or `tables_at(h, values)` with inputs, and `forward` and `backward` names of
    kernels for them, or functions of tables, run, and the first and last of its members. `keepalive` must live as long
    as the tables. Derivatives by `coefficient_count` coefficients are mapped to those by the entries of the parameters
    by `coefficients`, and derivatives by the factors of Casimirs subtracted from the energy, `shift`, by `factors`. The
    `rules` are those above. `reversible` steps can be undone from their end.

    Systems that differ in coefficients share tables: `of_members` are the `coefficients` of each, and `tables_at`
    gives a list. `maps(energies)` are the `coefficients` for energies of the same monomials with other factors.

    The coefficients are all entries of the fields `located`, one after the other; if there are none, they are those of
    the derivative of the energy only. `sources` are those of the tables.
    """

    tables_at: Callable[..., Any]
    keepalive: tuple[Any, ...]
    forward: Kernel
    backward: Kernel
    coefficient_count: int
    coefficients: Mapping[str, CoefficientMap]
    factors: Mapping[str, CoefficientMap]
    rules: Mapping[str, str]
    shift: tuple[Any, ...]
    reversible: bool
    located: tuple[str, ...] = ()
    maps: Callable[[Mapping[str, EnergyDerivative]], Mapping[str, CoefficientMap]] | None = None
    of_members: Sequence[Mapping[str, CoefficientMap]] = ()
    sources: Callable[[], Sources] = unrecorded
