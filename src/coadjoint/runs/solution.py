"""What a run leaves: states, invariants, attitude, drifts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.base import Method
from coadjoint.systems.batch import Batch
from coadjoint.systems.kinds import System
from coadjoint.wording import short

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from coadjoint.runs.saved import Saved


@dataclass(frozen=True)
class Statistics:
    """Work of a run.

    Parameters
    ----------
    steps : int
        Steps of each member.
    evaluations : int
        Elementary flows (splitting) or evaluations of the vector field, of all members.
    iterations : int
        Iterations of implicit schemes, of all members.
    seconds : float
        Wall-clock time in the loop, compilation in it included where it was the first call.
    """

    steps: int
    evaluations: int
    iterations: int
    seconds: float


class Drift(float):
    """The largest absolute deviation of an invariant from its start; a float with the course of it.

    Attributes
    ----------
    tenths : ndarray, shape (10,) or (members, 10)
        The largest deviation in each tenth of the run.
    members : ndarray or None
        For an ensemble the largest deviation of each member; the float is the largest of all.
    initial : float or ndarray
        The value at the start.
    """

    tenths: NDArray[np.float64]
    members: NDArray[np.float64] | None
    initial: Any

    def __new__(cls, tenths: NDArray[np.float64], initial: Any) -> Drift:
        """Make the float from its tenths."""
        drift = super().__new__(cls, np.max(tenths))
        drift.tenths = tenths
        drift.members = None if tenths.ndim == 1 else tenths.max(axis=-1)
        drift.initial = initial
        return drift

    @property
    def growth(self) -> Any:
        """The last tenth over the first: 1 for a bounded error, 10 for linear growth, infinite where the first is 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.divide(self.tenths[..., -1], self.tenths[..., 0])


@dataclass(frozen=True)
class Solution:
    """A run: arrays over the saved times, k of them, for one member or (k, members, ...) for an ensemble.

    Parameters
    ----------
    t : ndarray, shape (k,)
        t0, every save_every-th step, and the last.
    x : ndarray, shape (k, n) or (k, members, n)
        Momentum.
    energy : ndarray, shape (k,) or (k, members)
        The Hamiltonian.
    casimirs : dict
        Name -> array of the same shape.
    attitude : ndarray, shape (k, d, d) or (k, members, d, d), or None
        Group element, if one was carried.
    observed : dict
        Name -> array: what `observe` asked for.
    stats : Statistics
        Steps, evaluations, iterations, seconds.
    failed : ndarray of bool, shape (members,), or None
        For an ensemble: which members failed.
    system, method, t_span, step, save_every, watched
        What was run.
    carried : {"representation", "coadjoint"} or None
        In which matrices the group element is.

    Notes
    -----
    Of a run, each part is made when it is first asked for, and kept.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> sol.x.shape, sorted(sol.drift())
    ((11, 3), ['energy', '|x|^2'])
    """

    t: NDArray[np.float64]
    x: NDArray[np.float64]
    energy: NDArray[np.float64]
    casimirs: Mapping[str, NDArray[np.float64]]
    attitude: NDArray[np.float64] | None
    observed: Mapping[str, NDArray[np.float64]]
    stats: Statistics
    failed: NDArray[np.bool_] | None
    system: System | Batch
    method: Method
    t_span: tuple[float, float]
    step: float
    save_every: int
    watched: bool
    carried: str | None
    _worst: NDArray[np.float64] = field(repr=False)

    @classmethod
    def of(cls, saved: Saved) -> Solution:
        """Return the solution of a run; each part is made when it is first asked for, and kept."""
        solution = object.__new__(cls)
        solution.__dict__["_saved"] = saved
        return solution

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name not in PARTS or "_saved" not in self.__dict__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return self.__dict__.setdefault(name, getattr(self._saved, name))

    def __getstate__(self) -> dict[str, Any]:
        """Return all parts, for copies and for `pickle`."""
        return {name: getattr(self, name) for name in PARTS}

    def drift(self) -> dict[str, Drift]:
        """Return how far each invariant strayed from its start.

        Returns
        -------
        dict
            ``"energy"`` and the name of each Casimir -> `Drift`: a float, the largest absolute deviation over every
            step (with ``watch=False`` over the saved points), with `tenths`, the same for each tenth of the run.
        """
        series = {"energy": self.energy, **self.casimirs}
        return {name: Drift(self._worst[..., i], values[0]) for i, (name, values) in enumerate(series.items())}

    def to_xarray(self) -> xarray.Dataset:
        """Return the run as a dataset whose attributes make it repeatable.

        Returns
        -------
        xarray.Dataset
            Variables over ``time`` (and ``member``), to be written as NetCDF or Zarr.
        """
        from coadjoint.files.export import dataset_of

        return dataset_of(self)

    def plot(self) -> Figure:
        """Return a figure: drift, components, and for three dimensions the orbit on its coadjoint orbit.

        Returns
        -------
        matplotlib.figure.Figure
            Not shown, not saved.
        """
        from coadjoint.pictures.solution import draw_solution

        return draw_solution(self)


def check_solution(solution: Any) -> None:
    """Refuse what is no solution of a run, before it fails somewhere else."""
    if not isinstance(solution, Solution):
        raise TypeError(f"solution is {short(solution)}; it must be a Solution, from co.integrate")


PARTS = frozenset(part.name for part in fields(Solution))
