"""What of a run is drawn? Its members, its names, and whether its points lie close enough for lines."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.given import read_choice, read_number, read_whole
from coadjoint.pictures.register import CannotShow
from coadjoint.pictures.style import coordinate
from coadjoint.runs.solution import Solution
from coadjoint.systems.batch import Batch
from coadjoint.systems.coordinate_names import coordinate_names
from coadjoint.systems.kinds import shape_of
from coadjoint.systems.points import QUIET
from coadjoint.systems.ready_made import telling_of
from coadjoint.systems.telling import Telling

Floats = npt.NDArray[np.float64]

MOST_MEMBERS = 20
MOST_POINTS = 20_000  # of a curve, more than a printed line can show
SAMPLED = 64  # stretches between points that are looked at
NUMBERS_SAMPLED = 2**19  # of large states fewer, but FEWEST_SAMPLED
FEWEST_SAMPLED = 4
FLAT = 0.04  # how far a motion may leave the chord, as a part of its range: a circle of 11 points does by as much


class Drawn:
    """A run as pictures see it: at most 20 members, evenly spread, by one axis of members, also where there is one.

    Parameters
    ----------
    solution : Solution
        The run.

    Attributes
    ----------
    solution : Solution
        As given.
    system : LiePoissonSystem or PoissonSystem
        That of the first member.
    family : LiePoissonSystem or PoissonSystem
        The same, without the forces that it may have.
    telling : Telling or None
        What is known of the system by its name.
    of_members : int
        How many members the run has.
    t : ndarray, shape (k,)
        All saved times.
    x : ndarray, shape (members, k, n)
        States of the members that are drawn.
    n : int
        How many numbers a state has.
    """

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        first = solution.system[0] if isinstance(solution.system, Batch) else solution.system
        self.system: Any = first
        # A system with forces wraps the one that has a name and parameters.
        self.family: Any = getattr(first, "system", first)
        self.telling: Telling | None = telling_of(self.family.name)
        self.single = solution.failed is None
        # A matrix of complex numbers is drawn as its real and imaginary parts, in turns.
        states = np.ascontiguousarray(solution.x)
        self._type = states.dtype
        states = states.view(np.float64) if np.iscomplexobj(states) else states
        self.n = int(np.prod(shape_of(first))) * (self._type.itemsize // states.dtype.itemsize)
        states = states.reshape(len(solution.t), -1, self.n)
        self.of_members = states.shape[1]
        self._chosen = spread(self.of_members, MOST_MEMBERS)
        self.t = solution.t
        # A crowd of few is seen, not copied: states may be large.
        seen = states if len(self._chosen) == self.of_members else states[:, self._chosen]
        self.x = np.swapaxes(seen, 0, 1)

    def of_each(self, series: npt.ArrayLike) -> Floats:
        """Return a series of the run, (k, ...) or (k, members, ...), for the members that are drawn, (members, k, ...).

        Parameters
        ----------
        series : array_like
            Such as the energy.

        Returns
        -------
        ndarray
        """
        values = np.asarray(series)
        values = values[:, None] if self.single else values
        return np.swapaxes(values[:, self._chosen], 0, 1)

    @cached_property
    def attitude(self) -> Floats | None:
        """Group elements in the representation of the system, (members, k, d, d)."""
        carried = self.solution.carried == "representation"
        return self.of_each(self.solution.attitude) if carried and self.solution.attitude is not None else None

    @cached_property
    def rotation(self) -> Floats | None:
        """Attitude as rotations of space, (members, k, 3, 3): of the group element itself, or of its first block."""
        g = self.attitude
        if g is None or g.shape[-1] not in (3, 4):
            return None
        A = g[..., :3, :3]
        products = A[:, :1] @ np.swapaxes(A[:, :1], -1, -2)
        turned = A[:, -1:] @ np.swapaxes(A[:, -1:], -1, -2)
        return A if max(np.abs(products - np.eye(3)).max(), np.abs(turned - np.eye(3)).max()) < 1e-6 else None

    @cached_property
    def invariants(self) -> Mapping[str, Floats]:
        """The energy and the Casimirs, name to (members, k)."""
        series = {"energy": self.solution.energy, **self.solution.casimirs}
        return {name: self.of_each(values) for name, values in series.items()}

    @property
    def driven(self) -> bool:
        """Whether the Hamiltonian depends on time, so that the energy is no invariant."""
        return bool(getattr(self.system.hamiltonian, "timed", False))

    @cached_property
    def left(self) -> Mapping[str, Floats] | None:
        """The change of each invariant less the work of the forces on it, which is an error; None without forces."""
        work = getattr(self.solution, "work", None)
        if not work:
            return None
        found = {}
        for name, values in self.invariants.items():
            done = [self.of_each(by[name]) for by in work.values() if name in by]
            found[name] = values - values[:, :1] - sum(done)
        return found

    @property
    def quantity(self) -> str:
        """What the coordinates are."""
        return "momentum" if self.telling is None else self.telling.quantity

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates as plain text: those of the system, those of the basis, or x1, x2, ..."""
        return coordinate_names(self.family, self.n)

    def label(self, i: int) -> str:
        """Return the name of a coordinate as mathematical text."""
        return coordinate(self.names[i])

    def place(self, chosen: Any) -> int:
        """Return the number of a coordinate that is given by number or by name.

        Parameters
        ----------
        chosen : int or str
            From 0; or one of `names`.

        Returns
        -------
        int

        Raises
        ------
        CannotShow
            There is no such coordinate; the nearest name is given.
        """
        try:
            if isinstance(chosen, str):
                return self.names.index(read_choice(chosen, "coordinate", self.names))
            return read_whole(chosen, "a coordinate", 0, self.n - 1)
        except ValueError as reason:
            raise CannotShow(str(reason)) from None

    @cached_property
    def kept(self) -> npt.NDArray[np.int64]:
        """The points of curves in space: all, or evenly some 20 000 and the last."""
        every = max(1, -(-len(self.t) // MOST_POINTS))
        return np.unique(np.append(np.arange(0, len(self.t), every), len(self.t) - 1))

    @cached_property
    def joined(self) -> bool:
        """Whether lines between the points of a curve show the motion. Where they do not, points are drawn as dots."""
        return self._flat(self.kept)

    @cached_property
    def close(self) -> bool:
        """The same for all saved points."""
        return self._flat(np.arange(len(self.t)))

    @QUIET
    def _flat(self, kept: npt.NDArray[np.int64]) -> bool:
        """Say whether nine of ten stretches between points are nearly straight, for the first member that is finite.

        The motion leaves the chord by about ``|f(x1) - f(x0)| dt / 8``, with its known field f.
        """
        if len(kept) < 3:
            return True
        finite = np.isfinite(self.x[:, kept]).all(axis=(1, 2))
        x = self.x[int(np.argmax(finite))][kept]
        size = float(np.linalg.norm(np.ptp(x[np.isfinite(x).all(axis=1)], axis=0)))
        if not size > 0.0:
            return True
        places = spread(len(kept) - 1, min(SAMPLED, max(FEWEST_SAMPLED, NUMBERS_SAMPLED // self.n)))
        leaves = [self._bend(x, self.t[kept], int(p)) for p in places]
        return bool(np.quantile(leaves, 0.9) <= FLAT * size)

    def _bend(self, x: Floats, t: Floats, p: int) -> float:
        dt = float(t[p + 1] - t[p])
        before, after = (self._slope(x[q], float(t[q])) for q in (p, p + 1))
        bend = float(np.linalg.norm(after - before)) * abs(dt) / 8.0
        missed = float(np.linalg.norm(0.5 * dt * (before + after) - (x[p + 1] - x[p])))
        found = max(bend, missed)
        return found if np.isfinite(found) else 0.0

    def at(self, part: Any) -> int:
        """Return the number of the saved point at a part of the span, 0 for the start and 1 for the end."""
        return round(min(max(read_number(part, "at"), 0.0), 1.0) * (len(self.t) - 1))

    def state(self, k: int) -> npt.NDArray[Any]:
        """Return a saved state of the first member, in its own shape."""
        return self._shaped(self.x[0, k])

    def of_state(self, function: Any, k: int) -> tuple[Floats, float]:
        """Return values of a saved state, and the largest of start, end and this one: a scale that pictures share.

        Parameters
        ----------
        function : callable
            Of the system, without the forces that it may have, and of a state.
        k : int
            Which saved point.

        Returns
        -------
        ndarray
        float
        """
        found = {j: np.asarray(function(self.family, self.state(j)), dtype=np.float64) for j in {0, k, len(self.t) - 1}}
        return found[k], max(float(np.nanmax(np.abs(values))) for values in found.values()) or 1.0

    def _shaped(self, x: Floats) -> npt.NDArray[Any]:
        return np.ascontiguousarray(x).view(self._type).reshape(shape_of(self.system))

    def _slope(self, x: Floats, t: float) -> Floats:
        state = self._shaped(x)
        found = np.ascontiguousarray(self.system.vector_field(state, t), dtype=self._type)
        return found.view(np.float64).ravel()


def spread(count: int, most: int) -> npt.NDArray[np.int64]:
    """Return at most so many of 0 ... count - 1, evenly spread.

    Examples
    --------
    >>> spread(9, 3).tolist(), spread(2, 3).tolist()
    ([0, 4, 8], [0, 1])
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
