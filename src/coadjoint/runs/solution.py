"""The result of a run: states, invariants, attitude, drifts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import FrozenInstanceError, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.short_repr import short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.batch import Batch
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system_checks import System, unforced

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from coadjoint.kernels.arrays import NamedArrays
    from coadjoint.runs.events import RecordedEvents, TerminalEvent
    from coadjoint.runs.loops import GroupCorrection
    from coadjoint.runs.observables import Observed
    from coadjoint.runs.run import Run
    from coadjoint.runs.start import Start
    from coadjoint.runs.state_at import StateAt
    from coadjoint.runs.times import Times

# Arrays that a solution copies from a large state of a run; a small state is shared, since copying takes a step's time.
REPORTED_ARRAYS = ("worst", "status", "evaluations", "iterations")
MAX_STATE_NUMBERS = 2**20


@dataclass(frozen=True)
class Statistics:
    """Work of a run.

    Parameters
    ----------
    steps : int
        Steps of each member.
    evaluations : int
        Elementary flows (splitting) or evaluations of the vector field, summed over members.
    iterations : int
        Iterations of implicit schemes, summed over members.
    seconds : float
        Wall-clock time in the loop, including compilation at the first call.
    """

    steps: int
    evaluations: int
    iterations: int
    seconds: float


class Drift(float):
    """The largest absolute deviation of an invariant from its initial value: a float with the deviations in detail.

    Attributes
    ----------
    tenths : ndarray, shape (10,) or (members, 10)
        Largest deviation in each tenth of the run.
    members : ndarray or None
        For an ensemble, the largest deviation of each member; the float is the largest over all members.
    initial : float or ndarray
        Initial value.
    """

    tenths: NDArray[np.float64]
    members: NDArray[np.float64] | None
    initial: Any

    def __new__(cls, tenths: NDArray[np.float64], initial: Any) -> Drift:
        """Construct the drift from its tenths."""
        drift = super().__new__(cls, np.max(tenths))
        drift.tenths = tenths
        drift.members = None if tenths.ndim == 1 else tenths.max(axis=-1)
        drift.initial = initial
        return drift

    @property
    def growth(self) -> Any:
        """Ratio of the last tenth to the first: 1 for bounded error, 10 for linear growth, inf if the first is 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.divide(self.tenths[..., -1], self.tenths[..., 0])


class Solution:
    """The result of a run: arrays over the k saved times, (k, ...) for one member, (k, members, ...) for an ensemble.

    Attributes
    ----------
    t : ndarray, shape (k,)
        t0, every save_every-th step, and the last; or `t_eval`.
    x : ndarray, shape (k, n) or (k, members, n)
        Momentum.
    energy : ndarray, shape (k,) or (k, members)
        The Hamiltonian.
    casimirs : dict
        Name -> array of the same shape.
    attitude : ndarray, shape (k, d, d) or (k, members, d, d), or None
        Group element, if it was computed.
    observed : dict
        Name -> array: the quantities of `observe`.
    events : RecordedEvents or None
        Crossings of the events given to the run.
    stats : Statistics
        Steps, evaluations, iterations, seconds.
    failed : ndarray of bool, shape (members,), or None
        For an ensemble, which members failed.
    system, method, t_span, step, save_every, watched
        System, scheme and arguments of the run.
    carried : {"representation", "coadjoint"} or None
        Matrices in which the group element is stored.
    choice : Choice or None
        For runs with `accuracy`: the result of `choose`.
    error_estimate : float, or ndarray of shape (members,)
        For runs with `accuracy`: the error of the final momentum, relative to the largest momentum during the run.

    Notes
    -----
    Returned by `integrate`. Attributes are computed lazily and cached; the tables of the run are not kept alive.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 1), step=0.1)
    >>> sol.x.shape, sorted(sol.drift())
    ((11, 3), ['energy', '|x|^2'])
    """

    method: Method
    watched: bool
    observed: Mapping[str, NDArray[np.float64]]
    choice: Any
    _error: NDArray[np.float64] | None
    _began: NDArray[np.float64] | None
    events: RecordedEvents | None
    _ending: TerminalEvent | None
    _saved: NamedArrays
    _state: NamedArrays
    _saved_points: int
    _seconds: float
    _times: Times
    _start: Start
    _names: list[str]
    _accounts: tuple[tuple[str, str], ...]
    _initial: NDArray[np.float64] | None
    _corrected_groups: GroupCorrection
    _system: System | Batch | partial[System | Batch]

    def __init__(self, run: Run, saved_points: int, observed: Observed | None) -> None:
        loops, state = run.loops, run.state.arrays
        self.__dict__.update(
            method=run.method,
            watched=run.watching,
            observed={},
            choice=None,
            _error=None,
            _began=None,
            events=run.events,
            _ending=run.ending,
            _saved=run.saved,
            _state=state if state.numbers.size <= MAX_STATE_NUMBERS else state.subset(REPORTED_ARRAYS),
            _saved_points=saved_points,
            _seconds=run.seconds,
            _times=run.times,
            _start=run.start,
            _names=loops.names,
            _accounts=loops.accounts,
            _corrected_groups=loops.corrected_groups,
            _system=run.system,
            _initial=run.initial,
        )
        if observed is not None:
            # Observed quantities do not use the accounts that may follow the coordinates.
            series = observed.along(self.t, self._series("x"))
            self.__dict__["observed"] = {name: self._without_member_axis(values) for name, values in series.items()}

    def __setattr__(self, name: str, value: Any) -> None:
        raise FrozenInstanceError(f"cannot assign to field {name!r}: a Solution cannot be changed")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            # If the computation of an attribute failed, raise that error.
            if name in PICKLED_ATTRIBUTES or hasattr(type(self), name):
                return object.__getattribute__(self, name)
            from coadjoint.keyword_hints import unknown_solution_attribute

            raise unknown_solution_attribute(name, dir(self))

    def __delattr__(self, name: str) -> None:
        raise FrozenInstanceError(f"cannot delete field {name!r}: a Solution cannot be changed")

    def __repr__(self) -> str:
        points = f"{len(self.t)} points from t = {self.t_span[0]:g} to {self.t_span[1]:g}"
        members = "" if self.failed is None else f", {len(self.failed)} members"
        return f"<solution of {self.system.name} by {self.method}: {points}, step {self.step:g}{members}>"

    def _repr_html_(self) -> str:
        from coadjoint.runs.summary import table_of_run

        return table_of_run(self)

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes, for copies and for `pickle`."""
        return {name: getattr(self, name) for name in PICKLED_ATTRIBUTES}

    def _series(self, name: str) -> NDArray[Any]:
        return self._saved[name][: self._saved_points]

    def _without_member_axis(self, series: NDArray[Any]) -> NDArray[Any]:
        """Drop the axis of members for a single run."""
        return series[:, 0] if self._start.single else series

    @cached_property
    def system(self) -> System | Batch:
        """The system; for a run with inputs, the system with these inputs."""
        return self._system() if isinstance(self._system, partial) else self._system

    @cached_property
    def t(self) -> NDArray[np.float64]:
        """The saved times."""
        times = self._times.saved_times[: self._saved_points]
        if self._ending is not None:
            times[-1] = self._ending.t
        return times

    @cached_property
    def x(self) -> NDArray[np.float64]:
        """The states (momenta) at the saved times."""
        # Accounts of forces may follow the coordinates.
        return self._states(self._without_member_axis(self._series("x"))[..., : self._start.momenta.shape[1]])

    def _states(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        plain = unforced(self._system)
        if isinstance(plain, MatrixSystem):
            return plain.states(rows)
        return rows.reshape(*rows.shape[:-1], *self._start.shape)

    @cached_property
    def x0(self) -> NDArray[np.float64]:
        """Initial momentum, (n,) or (members, n), whether it was saved or not."""
        return self._states(self._start.momenta[0] if self._start.single else self._start.momenta)

    @cached_property
    def attitude0(self) -> NDArray[np.float64] | None:
        """Initial group element, (d, d) or (members, d, d), if it was computed."""
        if self._start.representation is None:
            return None
        return self._start.groups[0] if self._start.single else self._start.groups

    @cached_property
    def t_eval(self) -> NDArray[np.float64] | None:
        """Output times given by `t_eval`; None if steps were saved."""
        return None if self._times.between is None else self.t

    @cached_property
    def initial(self) -> Mapping[str, NDArray[np.float64]]:
        """Initial energy and Casimirs: "energy" or name -> number, or (members,)."""
        values = self._saved["values"][0] if self._initial is None else self._initial
        return {name: values[0, i] if self._start.single else values[:, i] for i, name in enumerate(self._names)}

    @cached_property
    def energy(self) -> NDArray[np.float64]:
        """The energy at the saved times."""
        return self._without_member_axis(self._series("values")[..., 0])

    @cached_property
    def casimirs(self) -> Mapping[str, NDArray[np.float64]]:
        """The Casimirs at the saved times: name -> values."""
        values = self._series("values")
        return {name: self._without_member_axis(values[..., i + 1]) for i, name in enumerate(self._names[1:])}

    @cached_property
    def work(self) -> Mapping[str, Mapping[str, NDArray[np.float64]]]:
        """Work of each force on the invariants since the start: its label -> "energy", or a Casimir -> values.

        A force that keeps the Casimirs does not list them. Empty without forces.
        """
        states, dim = self._series("x"), self._start.momenta.shape[1]
        by_force: dict[str, dict[str, NDArray[np.float64]]] = {}
        for column, (force, invariant) in enumerate(self._accounts):
            by_force.setdefault(force, {})[invariant] = self._without_member_axis(states[..., dim + column])
        return by_force

    @cached_property
    def attitude(self) -> NDArray[np.float64] | None:
        """Group elements (attitudes) at the saved times."""
        if self._start.representation is None:
            return None
        groups = self._corrected_groups(self._start, self._times, self._saved, self._saved_points)
        if self._ending is not None:
            groups[-1] = self._ending.attitude
        return groups[:, 0] if self._start.single else groups

    @cached_property
    def stats(self) -> Statistics:
        """Work of the run, such as numbers of steps and evaluations."""
        return Statistics(
            steps=int(self._times.steps if self._ending is None else self._ending.steps),
            evaluations=int(self._state["evaluations"].sum()),
            iterations=int(self._state["iterations"].sum()),
            seconds=self._seconds,
        )

    @cached_property
    def failed(self) -> NDArray[np.bool_] | None:
        """Which members of an ensemble failed."""
        return None if self._start.single else self._state["status"] != 0

    @cached_property
    def t_span(self) -> tuple[float, float]:
        """Start and end."""
        return self._times.t0, self._times.end if self._ending is None else self._ending.t

    @cached_property
    def asked_span(self) -> tuple[float, float]:
        """The requested start and end: equal to `t_span`, unless an event ended the run."""
        return self._times.t0, self._times.end

    @cached_property
    def step(self) -> float:
        """The size of the step."""
        return abs(self._times.h)

    @cached_property
    def save_every(self) -> int:
        """The argument save_every, at most the number of steps."""
        return self._times.save_every

    @cached_property
    def carried(self) -> str | None:
        """The kind of matrices in which the group element is stored."""
        return self._start.carried

    @cached_property
    def _worst(self) -> NDArray[np.float64]:
        worst = self._state["worst"]
        return worst[0] if self._start.single else worst

    def drift(self) -> dict[str, Drift]:
        """Return the largest deviation of each invariant from its initial value.

        Returns
        -------
        dict
            ``"energy"`` and the name of each Casimir -> `Drift`: a float, the largest absolute deviation over every
            step (with ``watch=False`` over the saved points, or the steps at or before the times of `t_eval`), with
            `tenths`, the same for each tenth of the run.
        """
        if self.work:
            raise TypeError(
                f"energy and Casimirs of {self.system.name} are changed by its forces; take balance(), the change "
                "minus the work of the forces, or change()"
            )
        return self._deviations(0)

    def balance(self) -> dict[str, Drift]:
        """Return the change of each invariant minus the work of the forces: the error of the scheme.

        The work of a force is the difference of the invariant before and after each flow of the force, added up over
        the run with compensated sums; `work` has it at the saved points. If the Hamiltonian depends on time, the
        balance also contains the energy that this brings in.

        Returns
        -------
        dict
            As `drift`, for ``invariant - work of all forces``. Without forces it is `drift`. For matrices it has the
            energy and the Casimirs of degree two, since work is recorded for these only.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.1), t_span=(0, 10), step=0.125, method=co.GaussLegendre(2))
        >>> lost, done = sol.energy[-1] - sol.energy[0], sol.work["LinearDamping"]["energy"][-1]
        >>> bool(lost < -0.4), bool(abs(lost - done) < 1e-15), bool(sol.balance()["energy"] < 1e-15)
        (True, True, True)
        """
        if not self.work:
            return self._deviations(0)
        accounted = {invariant for _, invariant in self._accounts}
        all_casimirs = accounted == {"energy"}  # the forces keep all Casimirs
        deviations = self._deviations(1 + len(self.casimirs))
        return {name: drift for name, drift in deviations.items() if all_casimirs or name in accounted}

    def change(self) -> dict[str, Drift]:
        """Return the largest change of each invariant from its initial value, by forces and scheme.

        Returns
        -------
        dict
            As `drift`; without forces it is `drift`.
        """
        return self._deviations(0)

    @property
    def error_estimate(self) -> Any:
        """The estimated error of the last state, relative to the largest momentum during the run.

        It is computed lazily, by a second run of 1.5 times as many steps. If both agree to rounding, a third run of
        1.75 times as many steps is compared. This takes 1.5 or 3.25 times as long as the run. The estimate is accurate
        within a factor of 10. If the error is below the expected rounding, the estimate is that rounding. If a finer
        run fails, another is tried, four at most; if all fail, the estimate is infinite.

        Returns
        -------
        float, or ndarray of shape (members,)
            Error relative to the same scale as `accuracy`.

        Raises
        ------
        TypeError
            The run was not given an `accuracy`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.5), (0, 100), accuracy=1e-6)
        >>> sol.error_estimate <= 1e-6
        True
        """
        error = self._error
        if error is None:
            error = self.__dict__["_error"] = shortcut("error_at_end")(self)
        return float(error[0]) if self.failed is None else error

    def _deviations(self, first: int) -> dict[str, Drift]:
        # Balances have the initial values of the invariants.
        return {name: Drift(self._worst[..., first + i], value) for i, (name, value) in enumerate(self.initial.items())}

    def spectrum(self) -> NDArray[Any]:
        """Return the eigenvalues of the saved matrices of a `MatrixSystem`, invariants of isospectral schemes.

        Returns
        -------
        ndarray, shape (k, N) or (k, members, N)
            As returned by `MatrixSystem.spectrum`; NaN where a member has failed.

        Raises
        ------
        TypeError
            The states are not matrices.

        Examples
        --------
        >>> import coadjoint as co
        >>> import numpy as np
        >>> s = co.MatrixSystem(co.MatrixAlgebra("gl", 3), lambda W: W.T)
        >>> sol = co.integrate(s, np.diag([1.0, 2.0, 3.0]) + 0.1, t_span=(0, 1), step=0.1)
        >>> bool(abs(sol.spectrum() - sol.spectrum()[0]).max() < 1e-13)
        True
        """
        if not isinstance(self.system, MatrixSystem):
            raise TypeError(f"the states of {self.system.name} are no matrices, and have no spectrum")
        x = self.x.reshape(-1, *self.x.shape[1 if self._start.single else 2 :])
        finite = np.isfinite(x).reshape(len(x), -1).all(axis=1)
        values = self.system.spectrum(x[finite])
        spectra = np.full((len(x), values.shape[-1]), np.nan, dtype=values.dtype)
        spectra[finite] = values
        return spectra.reshape(*self.x.shape[: 1 if self._start.single else 2], -1)

    def modified_energy(self, order: int = 4) -> NDArray[np.float64]:
        """Return the modified Hamiltonian of the scheme and the step of the run, at the saved points.

        The steps are the exact motion of a slightly different system, and this is the energy of that system. It is
        constant up to O(step^order), while `energy` oscillates.

        Parameters
        ----------
        order : int
            Terms below step^order are included; see `coadjoint.modified_hamiltonian`. For a scheme of order 2, order=2
            gives `energy`.

        Returns
        -------
        ndarray, shape (k,) or (k, members)
            As `energy`.

        Raises
        ------
        TypeError, ValueError
            The scheme or the system has no modified Hamiltonian; see `coadjoint.modified_hamiltonian`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
        >>> modified = sol.modified_energy(order=6)
        >>> float(max(abs(modified - modified[0])) / max(abs(sol.energy - sol.energy[0]))) < 1e-4
        True
        """
        modified_hamiltonian = shortcut("modified_hamiltonian")
        h = self.step if self.t_span[1] > self.t_span[0] else -self.step
        if isinstance(self.system, Batch):
            hamiltonians = [modified_hamiltonian(member, self.method, order) for member in self.system]
            return np.stack([H(self.x[:, m], h) for m, H in enumerate(hamiltonians)], axis=1)
        return np.asarray(modified_hamiltonian(self.system, self.method, order)(self.x, h))

    def at(self, t: Any) -> StateAt:
        """Return the states at any times within the run, as accurate as those at its steps.

        From the saved point before a time, whole steps are recomputed, followed by a partial step of the same scheme.
        So the state has the order and the conservation properties of the scheme, unlike an interpolating polynomial.
        For many times, ``integrate(..., t_eval=times)`` is faster. Members of an ensemble that were ended by events are
        NaN after their ends.

        Parameters
        ----------
        t : float or array_like, shape (k,)
            Times within the run, in any order.

        Returns
        -------
        StateAt
            A named tuple of ``t, x, energy, casimirs, attitude``, with the same shapes as at the saved points; without
            the first axis if t is a single time.

        Raises
        ------
        ValueError
            A time outside the run or after the ends of all members; too many steps from the saved points; a member that
            has failed; a force that is a noise, which is defined for whole steps only.
        IntegrationError
            A step fails.

        Examples
        --------
        >>> import coadjoint as co
        >>> body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1)
        >>> sol = co.integrate(body, x0, (0, 10), 0.1, co.GaussLegendre(3), save_every=20)
        >>> bool(abs(sol.at(3.14159).x - body.exact(x0, 3.14159)).max() < 1e-10)
        True
        >>> sol.at([0.5, 9.99]).energy.shape
        (2,)
        """
        from coadjoint.runs.state_at import state_at

        return state_at(self, t)

    def to_xarray(self) -> xarray.Dataset:
        """Return the run as an xarray dataset, with everything needed to repeat it.

        Returns
        -------
        xarray.Dataset
            Variables over ``time`` (and ``member``), to be written as NetCDF or Zarr.
        """
        return shortcut("dataset_of")(self)

    def plot(self, panels: Any = None, components: Any = None, axes: Any = None, members: Any = None) -> Figure:
        """Plot drift, components, and the pictures that the system declares.

        Lines are drawn only where the motion between the points is known. If the saved points are too far apart, `at`
        computes states between them, at most 10 000 and for about 1.5 s. If that is not enough, dots are drawn. If
        there are more oscillations than a printed line can show, an envelope is drawn.

        Parameters
        ----------
        panels : sequence of str or Picture, optional
            Kinds of pictures instead, such as ``["drift", "body axis"]``; see
            `coadjoint.pictures.solution.draw_solution`.
        components : sequence of int or str, optional
            Coordinates plotted over time, by number from 0 or by name.
        axes : Axes or sequence of Axes, optional
            Existing axes to draw into, one for each panel.
        members : sequence of int, optional
            Members of an ensemble to draw, from 0; at most 20.

        Returns
        -------
        matplotlib.figure.Figure
            The figure, neither shown nor saved.

        Raises
        ------
        TypeError, ValueError
            Unknown panel or coordinate, with the nearest name; or a panel that this run cannot show, with the reason.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (0.01, 1.0, 0.01), (0, 40), 0.05, attitude=True)
        >>> [axes.get_title() for axes in sol.plot(["body axis"]).axes]
        ['body axis 2 in space']
        """
        return shortcut("draw_solution")(self, panels, components, axes, members)

    def movie(
        self,
        path: str | Path,
        picture: Any = None,
        frames: int = 240,
        fps: float = 24.0,
        size: tuple[int, int] = (960, 540),
    ) -> Path:
        """Write the run as a movie: a picture of one time, such as the vorticity of a fluid, at the saved times.

        Parameters
        ----------
        path : str or Path
            ``.mp4``, which needs the program ffmpeg, or ``.gif``.
        picture : str or Picture, optional
            The picture to show, such as ``Picture("vorticity", part="large")``. The default is the first picture of one
            time that the system declares. See `coadjoint.pictures.movie.frames_of`.
        frames : int
            Largest number of frames, from 2 to 5000. They show saved times, evenly spread, and are drawn one by one.
        fps : float
            Frames per second; at most 50 for a GIF.
        size : (int, int)
            Width and height in pixels, even numbers.

        Returns
        -------
        Path

        Raises
        ------
        TypeError, ValueError
            The system has no picture for a movie, ffmpeg is missing, or an argument is invalid.

        Examples
        --------
        >>> import coadjoint as co
        >>> sol = co.integrate(co.systems.rigid_body((1, 2, 3)), (1, 0.2, 0.1), (0, 1), 0.1)
        >>> sol.movie("body.gif")
        Traceback (most recent call last):
        coadjoint.pictures.register.CannotShow: rigid_body declares no picture that a movie can show; give one: ...
        """
        target = shortcut("check_movie")(path)
        rate = shortcut("check_speed")(fps, target)
        shortcut("write_movie")(shortcut("frames_of")(self, picture, frames, size), target, rate)
        return target


def with_choice(solution: Solution, choice: Any) -> Solution:
    """Attach the `Choice` of scheme and step to a solution; None if they were given."""
    if choice is not None:
        solution.__dict__.update(choice=choice, _began=solution._start.momenta)
    return solution


def check_solution(solution: Any) -> None:
    """Raise TypeError unless the argument is a `Solution`."""
    if not isinstance(solution, Solution):
        raise TypeError(f"solution is {short(solution)}; it must be a Solution, from co.integrate")


PICKLED_ATTRIBUTES = ("method", "watched", "observed", "events", "choice", "_error", "_began", "_accounts") + tuple(
    name for name, value in vars(Solution).items() if isinstance(value, cached_property)
)
"""Attributes of a copied or pickled solution."""
