"""Parts: commuting linear forms, and the piece of the Hamiltonian that depends on them alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.sparse_rows import Rows, SparseRows, joined_starts, run_starts, starts_of
from coadjoint.program.term_table import derivative_of
from coadjoint.systems.hamiltonians.repeated_rows import values_at
from coadjoint.systems.hamiltonians.terms import FunctionTerm


@dataclass(frozen=True)
class GradientShare:
    """Angles that are derivatives of a polynomial or a term's user function, which may be `divided` into vectors."""

    coordinates: tuple[int, ...]
    polynomial: Polynomial | None = None
    term: FunctionTerm | None = None
    divided: FunctionTerm | None = None

    @property
    def copies(self) -> int:
        """The number of vectors that the gradient is the sum of."""
        return 1 if self.divided is None else len(self.divided.coordinates) // len(self.coordinates)

    def derivatives(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the gradient and Hessian at a state by its own coordinates, at the time zero."""
        own = np.array(self.coordinates)
        if self.term is not None:
            gradient, hessian = (derivative_of(self.term, order, x[own], 0.0) for order in (1, 2))
        else:
            assert self.polynomial is not None
            gradient, hessian = self.polynomial.gradient(x)[own], self.polynomial.hessian(x)[np.ix_(own, own)]
        return np.asarray(gradient, dtype=np.float64), np.asarray(hessian, dtype=np.float64)


@dataclass(frozen=True)
class BodyShare:
    """Flow of a free body with energy x.M.x/2 on a triple, or of a bond, where M acts on its sum with `other`.

    `scale` times the basis elements have the brackets of so(3). Rows are linear: coordinates 3, 1, 2, 3, the first
    without weights, in the order of the rotations of the compiled flow.
    """

    coordinates: tuple[int, int, int]
    matrix: tuple[tuple[float, ...], ...]
    scale: tuple[float, float, float]
    other: tuple[int, int, int] | None = None


COMPUTED = -1
"""Source of shares that are no copies of a term of H: completed squares, bodies, and other choices of parts."""


Form = tuple[tuple[int, ...], tuple[Any, ...]]
"""A linear form by its coordinates and their coefficients."""


@dataclass(eq=False, repr=False)
class Parts(Sequence[tuple[Form, ...]]):
    """Parts by columns: part p has the shares share[p] to share[p + 1], share s the angles row[s] to row[s + 1], each
    with one row of `forms` and the angle offset + weights.x, except for shares in `gradients` and `bodies`. `source` is
    the term of H that a share is a copy of, or COMPUTED; `pivots` (angles, 3) are those of `Squares` with forms in
    floats, else -1.
    """

    forms: SparseRows
    offset: NDArray[Any]
    weights: Rows
    row: Integers
    gradients: Mapping[int, GradientShare]
    share: Integers
    timed: NDArray[np.bool_]
    source: Integers = None  # type: ignore[assignment]
    pivots: NDArray[np.int64] | None = None
    bodies: Mapping[int, BodyShare] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.source is None:
            self.source = np.full(len(self.row) - 1, COMPUTED)

    @classmethod
    def linear(
        cls, forms: SparseRows, offset: NDArray[Any], weights: Rows, row: Integers, source: int = COMPUTED
    ) -> Parts:
        """Construct parts with one linear share each, of the angles row[p] to row[p + 1]."""
        count = len(row) - 1
        shares = np.arange(count + 1), np.zeros(count, dtype=bool), np.full(count, source)
        return cls(forms, offset, weights, row, {}, *shares)

    @classmethod
    def single(cls, share: GradientShare, timed: bool = False) -> Parts:
        size, ends = len(share.coordinates), np.array([0, 1])
        forms = SparseRows.units(np.array(share.coordinates, dtype=np.int64))
        rest = size * ends, {0: share}, ends, np.array([timed]), np.zeros(1, dtype=np.int64)
        return cls(forms, np.zeros(size), SparseRows.empty(size), *rest)

    @classmethod
    def concatenate(cls, pieces: Sequence[Parts]) -> Parts:
        if len(pieces) == 1:
            return pieces[0]
        if not pieces:
            return cls.linear(SparseRows.empty(0), np.zeros(0), SparseRows.empty(0), np.zeros(1, dtype=np.int64))
        shares = np.cumsum([0] + [len(piece.row) - 1 for piece in pieces]).tolist()
        pivots = None
        if any(piece.pivots is not None for piece in pieces):
            pivots = np.concatenate([np.full((len(p.offset), 3), -1) if p.pivots is None else p.pivots for p in pieces])
        return cls(
            SparseRows.concatenate([piece.forms for piece in pieces]),
            np.concatenate([piece.offset for piece in pieces]),
            SparseRows.concatenate([piece.weights for piece in pieces]),
            joined_starts([piece.row for piece in pieces]),
            {
                first + s: one
                for first, piece in zip(shares, pieces, strict=False)
                for s, one in piece.gradients.items()
            },
            joined_starts([piece.share for piece in pieces]),
            np.concatenate([piece.timed for piece in pieces]),
            np.concatenate([piece.source for piece in pieces]),
            pivots,
            {first + s: one for first, piece in zip(shares, pieces, strict=False) for s, one in piece.bodies.items()},
        )

    @property
    def nonlinear(self) -> list[int]:
        return [*self.gradients, *self.bodies]

    def of_term(self, number: int) -> Parts:
        """Return parts of one term as those of the term of this number."""
        if number:
            self.source = np.where(self.source == COMPUTED, COMPUTED, number)
        return self

    def __len__(self) -> int:
        return len(self.timed)

    @property
    def angle(self) -> Integers:
        """First angle of each part, shape (parts + 1,)."""
        return self.row[self.share]

    @property
    def part_of_angle(self) -> Integers:
        return np.repeat(np.arange(len(self)), np.diff(self.angle))

    @property
    def first_coordinate(self) -> NDArray[np.uint32]:
        """The smallest coordinate in the forms of each part; requires a form in every part."""
        return np.minimum.reduceat(self.forms.coordinate, self.forms.start[self.angle[:-1]])

    def take(self, chosen: NDArray[Any]) -> Parts:
        if np.array_equal(chosen, np.arange(len(self))):
            return self
        first, last = self.share[chosen], self.share[chosen + 1]
        _, shares = expand(first, last)
        begin, end = self.row[shares], self.row[shares + 1]
        _, angles = expand(begin, end)
        new_index = dict(zip(shares.tolist(), range(len(shares)), strict=True)) if self.nonlinear else {}
        forms, weights = self.forms.take(angles), self.weights.take(angles)
        if self.weights.target is self.forms.coordinate:
            weights = weights.with_target(forms.coordinate)
        return Parts(
            forms,
            values_at(self.offset, angles),
            weights,
            starts_of(end - begin),
            {new_index[s]: share for s, share in self.gradients.items() if s in new_index},
            starts_of(last - first),
            self.timed[chosen],
            self.source[shares],
            None if self.pivots is None else self.pivots[angles],
            {new_index[s]: body for s, body in self.bodies.items() if s in new_index},
        )

    def joined(self, label: NDArray[Any]) -> Parts:
        """Join (commuting) parts with equal labels into one part each, in the order of their first members."""
        first = np.full(int(label.max(initial=-1)) + 1, len(self))
        np.minimum.at(first, label, np.arange(len(self)))
        order = np.argsort(first[label], kind="stable")
        ordered, group = self.take(order), first[label][order]
        begins = np.flatnonzero(run_starts(group))
        timed = np.logical_or.reduceat(ordered.timed, begins) if len(begins) else ordered.timed
        share = np.append(ordered.share[begins], ordered.share[-1])
        return replace(ordered, share=share, timed=timed)

    @overload
    def __getitem__(self, index: int) -> tuple[Form, ...]: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[tuple[Form, ...]]: ...

    def __getitem__(self, index: int | slice) -> tuple[Any, ...]:
        if isinstance(index, slice):
            return tuple(self[p] for p in range(len(self))[index])
        p = range(len(self))[index]
        first, last = self.row[self.share[p : p + 2]]
        edges = pairwise(self.forms.start[first : last + 1].tolist())
        coordinate, value = self.forms.coordinate, self.forms.value
        return tuple((tuple(coordinate[a:b].tolist()), tuple(value[a:b].tolist())) for a, b in edges)
