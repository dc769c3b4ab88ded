"""Flow of free bodies in any number type: Taylor series of the motion, with the exact tangent map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.blocks import MOST_SUBSTEPS

if TYPE_CHECKING:
    from coadjoint.program.actions import Action
    from coadjoint.program.interpreter import Interpreter

Vectors = NDArray[Any]
PIECE = 0.25  # largest norm of tau times the generator in one series
MAX_TERMS = 4096  # of a series, which converges after some hundred in thousands of digits


class FlowState(NamedTuple):
    """State of a flow, or a term of its series: momentum, and optionally a group element (rows) and tangent vectors."""

    x: Vectors
    group: Vectors | None
    tangent: Vectors | None


def apply_body_flow(interpreter: Interpreter, part: int, tau: Any, state_of_flow: FlowState) -> None:
    """Apply the flow of a part of free bodies over the time `tau`, in place.

    In x' = sum_a theta_a(x) D_a x with linear theta_a, each term of the time series is bilinear in the earlier ones.
    Raises ValueError if the rotation angle is too large.
    """
    body = _Bodies(interpreter, part)
    count = interpreter.substeps(lambda: abs(tau) * body.speed(state_of_flow.x) / PIECE)
    for _ in range(count):
        terms = [state_of_flow]
        while len(terms) <= MAX_TERMS:
            terms.append(body.next_term(terms, tau / count))
            if interpreter.negligible(terms):
                break
        for start, *more in zip(*terms, strict=True):
            if start is not None:
                start[...] = sum(reversed(more), 0 * start) + start


class _Entries(NamedTuple):
    """Sparse entries of several matrices, one after the other; `owner` is the generator of each entry."""

    owner: NDArray[np.int64]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    value: NDArray[Any]

    def times(self, rates: NDArray[Any], vectors: Vectors) -> Vectors:
        """Apply sum_a rate_a D_a to vectors (n,) or (n, m)."""
        factors = rates[self.owner] * self.value
        moved = vectors[self.column] * (factors if vectors.ndim == 1 else factors[:, None])
        result = 0 * vectors
        np.add.at(result, self.row, moved)
        return result


class _Bodies:
    """Generators and angular velocities of one part."""

    def __init__(self, interpreter: Interpreter, part: int) -> None:
        program = interpreter.program
        first, last = (program.terms.row[program.share[p]] for p in (part, part + 1))
        self.terms = program.terms
        # The first row of a body has no weights, and is not an angular velocity.
        self.rows = [r for r in range(int(first), int(last)) if self.terms.entry[r] < self.terms.entry[r + 1]]
        angles = [r - int(first) for r in self.rows]
        self.state = _entries(interpreter, program.state, part, angles)
        self.group = None if program.group is None else _entries(interpreter, program.group, part, angles)

    def speed(self, x: Vectors) -> Any:
        """Bound the angular speed of vectors."""
        return sum(abs(rate) * max(abs(self.state.value), default=0) for rate in self.rates(x))

    def rates(self, x: Vectors) -> NDArray[Any]:
        """Return the angular velocities along the generators, or their derivatives along the columns of x."""
        terms, rates = self.terms, np.empty((len(self.rows), *x.shape[1:]), dtype=x.dtype)
        for a, r in enumerate(self.rows):
            entries = range(terms.entry[r], terms.entry[r + 1])
            rates[a] = sum((terms.weight[e] * x[terms.column[e]] for e in entries), 0 * x[0])
        return rates

    def next_term(self, terms: Sequence[FlowState], tau: Any) -> FlowState:
        """Return the next term of the series, times its power of tau."""
        n = len(terms)
        sums: list[Any] = [None if item is None else 0 * item for item in terms[0]]
        for k, term in enumerate(terms):
            before, rates = terms[n - 1 - k], self.rates(term.x)
            for slot, entries in enumerate((self.state, self.group, self.state)):
                vectors = before[slot]
                if vectors is not None and entries is not None:
                    sums[slot] = sums[slot] + entries.times(rates, vectors)
            if term.tangent is not None:
                changes, state = self.rates(term.tangent), self.state
                np.add.at(sums[2], state.row, (state.value * before.x[state.column])[:, None] * changes[state.owner])
        x, group, tangent = (None if item is None else item * tau / n for item in sums)
        assert x is not None
        return FlowState(x, group, tangent)


def _entries(interpreter: Interpreter, action: Action, part: int, angles: Sequence[int]) -> _Entries:
    matrices = [interpreter.generator(action, part, q) for q in angles]
    entries = [(a, *position, value) for a, matrix in enumerate(matrices) for position, value in matrix.items()]
    owner, row, column = (np.array([entry[k] for entry in entries], dtype=np.int64) for k in range(3))
    return _Entries(owner, row, column, np.array([entry[3] for entry in entries]))


def largest_of(term: Iterable[Vectors | None]) -> Any:
    """Return the largest absolute entry of each array of a term."""
    return [np.max(np.abs(item), initial=0) for item in term if item is not None]


def substep_count(reach: Any, ceil: Callable[[Any], int]) -> int:
    """Return the number of substeps of a flow of length `reach`; raise ValueError if it is too long."""
    if not reach <= MOST_SUBSTEPS:
        raise ValueError(
            f"a free body turns too far in one step: it would take {float(reach):.3g} substeps, and at most "
            f"{MOST_SUBSTEPS} are allowed; take a smaller step, or start nearer to the origin"
        )
    return max(1, ceil(reach))
