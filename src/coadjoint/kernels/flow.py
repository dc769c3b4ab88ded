"""The loop over steps for programs: flow methods read from their table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.actions import Action
from coadjoint.program.term_table import Terms


class FlowTables(NamedTuple):
    """The arrays of a program, the rows' coefficients already multiplied by the step.

    A part has at most `longest` angles; only[p] is the row of a part with a single, linear one, and -1 for the others.
    Rational rotations are marked in the kinds of the actions; bent[p] is 1 where the blocks of a part on the group have
    other frequencies than on the momentum, frequency[row], so that they need the angle itself. called[k] is the number
    of the free body that share k calls, -1 where it calls none; `body_column` has its triple and the other one of
    a bond (else the same again), `body` its constants.
    direct[p] has the bit 1 where all blocks of such a part turn by the angle itself, and the bit 2 where it is made of
    bonds between triples of unit scale.
    `step` is the step that `tau` belongs to; the loops scale it for steps of another length.
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
"""The name of the loop. The state is unfinished between its calls: the outer flow of a step is merged with the next
one, and *finish* acts on a copy.
"""
