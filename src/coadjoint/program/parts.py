"""Parts: commuting linear forms and the piece of the Hamiltonian that depends on them alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.joins import Integers, expand
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.sparse_rows import SparseRows, fresh, joined_starts, starts_of
from coadjoint.systems.terms import FunctionTerm


@dataclass(frozen=True)
class PolynomialShare:
    """Angles are the derivatives of a polynomial with respect to the given coordinates."""

    coordinates: tuple[int, ...]
    polynomial: Polynomial


@dataclass(frozen=True)
class FunctionShare:
    """Angles are the gradient of a user function of the term's coordinates."""

    term: FunctionTerm


@dataclass(frozen=True)
class BodyShare:
    """The flow of a free rigid body, or of a bond: its forms do not commute, and its angles change on the way.

    The rows of the share are linear like others, and their forms and weights are the energy. They are the coordinates
    3, 1, 2, 3 of the triple, the first without weights: the turns that compiled loops write the flow as. A bond turns
    two triples about their sum: its forms are sums of two coordinates, one of each.

    Parameters
    ----------
    coordinates : (int, int, int)
        The triple.
    matrix : tuple of tuples, (3, 3)
        The energy is x.M.x/2 on the triple; of a bond on the sum of both, and three equal moments.
    scale : (float, float, float)
        The basis elements times these have the brackets [1, 2] = 3, [2, 3] = 1, [3, 1] = 2.
    other : (int, int, int), optional
        The other triple of a bond, with the same scale.
    """

    coordinates: tuple[int, int, int]
    matrix: tuple[tuple[float, ...], ...]
    scale: tuple[float, float, float]
    other: tuple[int, int, int] | None = None


SpecialShare = PolynomialShare | FunctionShare | BodyShare


@dataclass(frozen=True)
class Part:
    """The commuting forms of one exact flow, to be shown.

    Parameters
    ----------
    forms : tuple of (coordinates, values)
        The linear forms l_a, sparse.
    """

    forms: tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]


class Parts(Sequence[Part]):
    """Parts stored by columns, since there may be very many. An item is a `Part`, which is made when it is asked for.

    Part p has the shares share[p] to share[p + 1], share s the angles row[s] to row[s + 1], and every angle one form.

    Parameters
    ----------
    forms : SparseRows
        The forms l_a of all angles.
    offset : ndarray, shape (angles,)
        An angle of a linear share is offset + weights . x.
    weights : SparseRows
        One row for each angle; the row is empty in other shares.
    row : ndarray of int64, shape (shares + 1,)
        Where the angles of each share begin.
    special : mapping of int to PolynomialShare, FunctionShare or BodyShare
        The shares that are not linear, or whose forms do not commute. A part has shares of free bodies alone, or none.
    share : ndarray of int64, shape (parts + 1,)
        Where the shares of each part begin.
    timed : ndarray of bool, shape (parts,)
        Which parts depend on time.

    Attributes
    ----------
    pivots : ndarray of int64, shape (angles, 3), or None
        Of completed squares with forms in floats: see `Squares`; -1 for other angles.
    """

    pivots: NDArray[np.int64] | None = None

    def __init__(
        self,
        forms: SparseRows,
        offset: NDArray[Any],
        weights: SparseRows,
        row: Integers,
        special: Mapping[int, SpecialShare],
        share: Integers,
        timed: NDArray[np.bool_],
    ) -> None:
        self.forms, self.offset, self.weights = forms, offset, weights
        self.row, self.special, self.share, self.timed = row, special, share, timed

    @classmethod
    def linear(cls, forms: SparseRows, offset: NDArray[Any], weights: SparseRows, row: Integers) -> Parts:
        """Return parts of one linear share each, which have the angles row[p] to row[p + 1]."""
        count = len(row) - 1
        return cls(forms, offset, weights, row, {}, np.arange(count + 1), np.zeros(count, dtype=bool))

    @classmethod
    def single(cls, share: PolynomialShare | FunctionShare, coordinates: Sequence[int], timed: bool = False) -> Parts:
        """Return one part of one share that is not linear."""
        size, ends = len(coordinates), np.array([0, 1])
        forms = SparseRows.units(np.array(coordinates, dtype=np.int64))
        return cls(forms, np.zeros(size), SparseRows.empty(size), size * ends, {0: share}, ends, np.array([timed]))

    @classmethod
    def concatenate(cls, pieces: Sequence[Parts]) -> Parts:
        """Return the parts of all pieces, one after the other."""
        if len(pieces) == 1:
            return pieces[0]
        if not pieces:
            return cls.linear(SparseRows.empty(0), np.zeros(0), SparseRows.empty(0), np.zeros(1, dtype=np.int64))
        shares = np.cumsum([0] + [len(piece.row) - 1 for piece in pieces]).tolist()
        whole = cls(
            SparseRows.concatenate([piece.forms for piece in pieces]),
            np.concatenate([piece.offset for piece in pieces]),
            SparseRows.concatenate([piece.weights for piece in pieces]),
            joined_starts([piece.row for piece in pieces]),
            {
                first + s: share
                for first, piece in zip(shares, pieces, strict=False)
                for s, share in piece.special.items()
            },
            joined_starts([piece.share for piece in pieces]),
            np.concatenate([piece.timed for piece in pieces]),
        )
        if any(piece.pivots is not None for piece in pieces):
            none = [np.full((len(piece.offset), 3), -1) for piece in pieces]
            own = [one if piece.pivots is None else piece.pivots for one, piece in zip(none, pieces, strict=True)]
            whole.pivots = np.concatenate(own)
        return whole

    @property
    def bodies(self) -> dict[int, BodyShare]:
        """The shares that are free bodies."""
        return {s: share for s, share in self.special.items() if isinstance(share, BodyShare)}

    def with_rules(self, offset: NDArray[Any], weights: SparseRows) -> Parts:
        """Return the same forms with other angles."""
        return Parts(self.forms, offset, weights, self.row, self.special, self.share, self.timed)

    def __len__(self) -> int:
        return len(self.timed)

    @property
    def angle(self) -> Integers:
        """Where the angles of each part begin, shape (parts + 1,)."""
        return self.row[self.share]

    @property
    def part_of_angle(self) -> Integers:
        """The part of each angle."""
        return np.repeat(np.arange(len(self)), np.diff(self.angle))

    @property
    def first_coordinate(self) -> NDArray[np.uint32]:
        """The smallest coordinate in the forms of each part; every part must have a form."""
        return np.minimum.reduceat(self.forms.coordinate, self.forms.start[self.angle[:-1]])

    def take(self, chosen: NDArray[Any]) -> Parts:
        """Return the chosen parts, each at most once, in the order given."""
        if np.array_equal(chosen, np.arange(len(self))):
            return self
        first, last = self.share[chosen], self.share[chosen + 1]
        _, shares = expand(first, last)
        begin, end = self.row[shares], self.row[shares + 1]
        _, angles = expand(begin, end)
        place = dict(zip(shares.tolist(), range(len(shares)), strict=True)) if self.special else {}
        taken = Parts(
            self.forms.take(angles),
            self.offset[angles],
            self.weights.take(angles),
            starts_of(end - begin),
            {place[s]: share for s, share in self.special.items() if s in place},
            starts_of(last - first),
            self.timed[chosen],
        )
        taken.pivots = None if self.pivots is None else self.pivots[angles]
        return taken

    def joined(self, label: NDArray[Any]) -> Parts:
        """Return the parts with equal labels, which must commute, as one part; in the order of their first members."""
        first = np.full(int(label.max(initial=-1)) + 1, len(self))
        np.minimum.at(first, label, np.arange(len(self)))
        order = np.argsort(first[label], kind="stable")
        moved, group = self.take(order), first[label][order]
        begins = np.flatnonzero(fresh(group))
        timed = np.logical_or.reduceat(moved.timed, begins) if len(begins) else moved.timed
        share = np.append(moved.share[begins], moved.share[-1])
        joined = Parts(moved.forms, moved.offset, moved.weights, moved.row, moved.special, share, timed)
        joined.pivots = moved.pivots
        return joined

    @overload
    def __getitem__(self, index: int) -> Part: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Part]: ...

    def __getitem__(self, index: int | slice) -> Part | Sequence[Part]:
        if isinstance(index, slice):
            return tuple(self[p] for p in range(len(self))[index])
        p = range(len(self))[index]
        first, last = self.row[self.share[p : p + 2]]
        edges = pairwise(self.forms.start[first : last + 1].tolist())
        coordinate, value = self.forms.coordinate, self.forms.value
        return Part(tuple((tuple(coordinate[a:b].tolist()), tuple(value[a:b].tolist())) for a, b in edges))
