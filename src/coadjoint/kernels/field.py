"""Tables of the vector field sign * J(x) u and of the group equation g' = -sign * g rho(u)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.term_table import Terms


class Field(NamedTuple):
    """The field x' = sign * J(x) grad H(x, t) in `size` coordinates.

    On a Lie algebra row i of J has the entries first[i] to first[i + 1], each a nonzero structure constant:
    `constant` = sign * c_ij^k with j = `column`, k = `state`. If `nonlinear`, `structure` holds the address of the
    compiled function x -> J(x). `longest` is the largest number of rows of a term of H.
    """

    size: int
    sign: float
    first: NDArray[np.uint32]
    column: NDArray[np.uint32]
    state: NDArray[np.uint32]
    constant: NDArray[np.float64]
    nonlinear: bool
    structure: NDArray[np.int64]
    terms: Terms
    addresses: NDArray[np.int64]
    longest: int


class GroupField(NamedTuple):
    """The equation g' = -sign * g rho(u) for d x d matrices; `size` is d, or 0 if no group element is computed.

    There are `entries` nonzeros: (rho_i)_ab with i = `element`, a = `row`, b = `column`, and `value` = -sign *
    (rho_i)_ab.
    """

    size: int
    entries: int
    element: NDArray[np.uint32]
    row: NDArray[np.uint32]
    column: NDArray[np.uint32]
    value: NDArray[np.float64]
