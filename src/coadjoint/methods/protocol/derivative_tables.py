"""Tables of loops that differentiate whole runs: tangent vectors forward and cotangents backward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.tables.structures import unrecorded

if TYPE_CHECKING:
    from coadjoint.program.multiples import Multiples
    from coadjoint.program.sources import Sources

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

    `monomials` are `coefficients` and `factors` by the monomials of the derivatives of the energy, with factors of one.
    The members of a batch may differ in coefficients of H: then `of_members` are the factors of the Casimirs, (members,
    casimirs), `coefficients` and `factors` those of each, and `tables_at` returns the ranges of members that share
    tables, (first, last, tables).

    The coefficients are all entries of the fields `located`, one after the other; if there are none, they are those of
    the derivative of the energy only. `sources` are those of the tables.
    """

    tables_at: Callable[..., Any]
    keepalive: tuple[Any, ...]
    forward: Kernel
    backward: Kernel
    coefficient_count: int
    coefficients: Mapping[str, Multiples]
    factors: Mapping[str, Multiples]
    rules: Mapping[str, str]
    shift: tuple[Any, ...]
    reversible: bool
    located: tuple[str, ...] = ()
    monomials: Mapping[str, tuple[Multiples, Multiples]] = {}
    of_members: NDArray[np.float64] | None = None
    sources: Callable[[], Sources] = unrecorded
