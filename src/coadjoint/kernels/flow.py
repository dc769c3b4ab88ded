"""Tables of the loop over steps for flow methods."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.term_table import Terms


class FlowTables(NamedTuple):
    """The arrays of a program; the coefficients of the rows are already multiplied by `step`, and the loops rescale
    them.

    A part has at most `longest` angles; only[p] is the row of a part with a single, linear one, else -1. bent[p] is 1
    if the blocks of part p on the group have other frequencies, frequency[row], than on the momentum, so that they need
    the angle itself. Rational rotations are marked in the kinds of the actions. called[k] is the index of the free body
    of share k, else -1; `body_column` has its triple and the other triple of a bond (the same one without a bond),
    `body` its constants. direct[p] has bit 1 if all blocks of a body part rotate by the angle itself, bit 2 if it
    consists of bonds of unit scale.
    """

    longest: int
    only: NDArray[np.int64]
    bent: NDArray[np.uint8]
    frequency: NDArray[np.float64]
    part: NDArray[np.uint32]
    tau: NDArray[np.float64]
    moment: NDArray[np.float64]
    section: NDArray[np.uint32]
    share: NDArray[np.uint32]
    terms: Terms
    addresses: NDArray[np.int64]
    state: Action
    group: Action
    compensated: bool
    called: NDArray[np.int64]
    body_column: NDArray[np.uint32]
    body: NDArray[np.float64]
    direct: NDArray[np.uint8]
    step: float


FLOW_LOOP = "flow_advance"
"""Name of the loop. Between calls the state is unfinished: the last flow of a step is merged with the first of the
next, and *finish* acts on a copy.
"""
