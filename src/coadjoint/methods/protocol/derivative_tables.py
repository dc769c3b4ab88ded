"""Tables of loops that differentiate whole runs: tangent vectors forward and cotangents backward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.tables.structures import unrecorded

if TYPE_CHECKING:
    from coadjoint.program.added_part import CoefficientMap
    from coadjoint.program.sources import Sources

EXACT = "exact"
ADDED_PART = "added part"
DIFFERENCES = "differences"

Kernel = str | Callable[[Any, Any, int, int], None]


class DerivativeTables(NamedTuple):
    """Tables of a scheme by step (and inputs), their kernels, and maps from coefficients to entries of parameters."""

    # `factors`: of Casimirs subtracted from H; `of_members`: those of a batch; `located`: differentiated fields.

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
    monomials: Mapping[str, tuple[CoefficientMap, CoefficientMap]] = {}
    of_members: NDArray[np.float64] | None = None
    sources: Callable[[], Sources] = unrecorded
