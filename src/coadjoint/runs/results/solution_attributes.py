"""The attributes of solutions with the motion of bodies, and members that are not computed to the last saved point."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.runs.events import RecordedEvents, TerminalEvent
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.system import System
from coadjoint.validation import read_numbers

if TYPE_CHECKING:
    import xarray
    from scipy.spatial.transform import Rotation

    from coadjoint.runs.results.solution import Solution
    from coadjoint.runs.start import Start
    from coadjoint.runs.times import Times

Floats = NDArray[np.float64]
AnyClass = TypeVar("AnyClass")

ORTHOGONALITY = 1e-6
"""Largest deviation from orthogonality of attitudes that are taken for rotations."""


@dataclass(frozen=True)
class Statistics:
    """Work of a run.

    Parameters
    ----------
    steps : int
        Steps of each member; of a failed run of one member those before the failure, and of an interrupted one those up
        to its last saved point.
    evaluations : int
        Elementary flows (splitting) or evaluations of the vector field, summed over members. An interrupted run has not
        counted those since the last update of its progress, nor its iterations.
    iterations : int
        Iterations of implicit schemes, summed over members.
    seconds : float
        Wall-clock time in the loop over the steps, including compilation at the first call; in an ensemble in blocks
        summed over the workers.
    elapsed : float
        Wall-clock time of the call: validation, preparation, steps, and writing of an archive. NaN if it is not known.
    matrix_products : float, optional
        Products of matrices of the steps of `IsospectralGauss`, in the precision of the states, summed over members;
        those of recorded Casimirs are not counted. An inverse counts as one, and a skew-Hermitian product as the part
        that is computed. None for other schemes, whose steps have none; with forces, whose products are not counted;
        for runs with events or that have not taken all of their steps, since what they repeated is not stored; and for
        files of systems whose functions are not stored.
    lower_products : float, optional
        Those in single precision, at most: each step that corrected its midpoint is counted with the last correction.
        None like `matrix_products`.
    """

    steps: int
    evaluations: int
    iterations: int
    seconds: float
    elapsed: float = math.nan
    matrix_products: float | None = None
    lower_products: float | None = None


def with_products(statistics: Statistics, solution: Any) -> Statistics:
    """Return the statistics of a solution with its products of matrices, if its counts determine them."""
    if type(solution.method).matrix_products is Method.matrix_products:
        return statistics
    if solution.events is not None or solution.incomplete is not None or solution.system.forces:
        return statistics
    steps = member_count(solution) * statistics.steps
    system, counts = solution.system.of_member(0), (statistics.evaluations, statistics.iterations)
    found = solution.method.matrix_products(system, steps, *counts)
    return replace(statistics, matrix_products=found[0], lower_products=found[1]) if found else statistics


@dataclass_transform(frozen_default=True, eq_default=False)
def read_only(kind: type[AnyClass]) -> type[AnyClass]:
    """Return a class unchanged, whose attributes type checkers take for read-only."""
    return kind


def declared(description: str) -> Any:
    """Return an attribute of solutions, which their classes have as a field, or compute or read on first use."""

    def missing(solution: Any) -> Any:
        raise NotImplementedError

    missing.__doc__ = description
    return cached_property(missing)


@read_only
class SolutionAttributes:
    """Attributes of a `Solution`; its classes have them as fields, or compute or read them on first use."""

    # Force and invariant of each column of recorded work.
    _work_integrals: tuple[tuple[str, str], ...]
    # Largest deviation of each invariant in each tenth of the run, then, with forces, those of the balances,
    # (tenths, k) or (members, tenths, k).
    _worst: Floats
    # Of all but copies.
    _times: Times
    _ending: TerminalEvent | None
    _start: Start
    # Of stored runs only.
    path: Path | str
    attributes: dict[str, Any]
    dataset: xarray.Dataset
    inputs: Callable[..., dict[str, Any]]
    check_complete: Callable[[], None]
    finished: bool
    reached: int
    status: NDArray[np.int64]
    blocks: Sequence[Any]
    progress_text: str

    system: System | Batch = declared("The system, with the inputs of the run.")
    method: Method = declared("The scheme.")
    watched: bool = declared("Whether invariants were computed after every step.")
    t: Floats = declared("The saved times, (k,): t0, every save_every-th step, and the last; or `t_eval`.")
    x: NDArray[Any] = declared("The states (momenta), (k, n) or (k, members, n).")
    x0: NDArray[Any] = declared("The initial state, without the axis of times, whether it was saved or not.")
    t_eval: Floats | None = declared("The argument of the run.")
    energy: Floats = declared("The Hamiltonian, (k,) or (k, members).")
    casimirs: Mapping[str, Floats] = declared("Name -> Casimir, (k,) or (k, members).")
    initial: Mapping[str, Any] = declared('Initial energy and Casimirs: "energy" or name -> number, or (members,).')
    work: Mapping[str, Mapping[str, Floats]] = declared(
        'Work of each force since the start: its label -> "energy", or a Casimir that it changes -> values.'
    )
    observed: Mapping[str, Floats] = declared("Name -> quantity of `observe`, over the saved times.")
    attitude: Floats | None = declared(
        "Group elements (attitudes), (k, d, d) or (k, members, d, d); None if they were not computed."
    )
    attitude0: Floats | None = declared(
        "The initial group element, without the axis of times; None if none was computed."
    )
    carried: str | None = declared(
        'Matrices in which the group element is stored: "representation", "coadjoint", or None.'
    )
    failed: NDArray[np.bool_] | None = declared(
        "Which members of an ensemble failed, (members,); None for a single run."
    )
    events: RecordedEvents | None = declared("Crossings of the events given to the run.")
    stats: Statistics = declared("Steps, evaluations, iterations, seconds.")
    incomplete: str | None = declared(
        'Why the run has not reached its end: "failed", "unfinished" (an archive), or what interrupted it; or None.'
    )
    t_span: tuple[float, float] = declared(
        "Start and end; the end is before that of `asked_span` if an event ended the run."
    )
    asked_span: tuple[float, float] = declared("The argument `t_span` of the run.")
    step: float = declared("The argument of the run.")
    save_every: int = declared("The argument of the run.")
    choice: Any = declared("For runs with `accuracy`: the result of `choose`; or None.")

    @property
    def positions(self) -> Floats:
        """The positions of the centres of bodies in space.

        Returns
        -------
        ndarray, shape (times, k, 3) or (times, members, k, 3)

        Raises
        ------
        TypeError
            The system is not one of bodies with positions, such as `gravitating_bodies`.
        """
        return self._of_bodies("positions", "positions; take co.systems.bodies or gravitating_bodies")

    @property
    def velocities(self) -> Floats:
        """The velocities of the centres of bodies in space.

        Returns
        -------
        ndarray, shape (times, k, 3) or (times, members, k, 3)

        Raises
        ------
        TypeError
            The system is not one of bodies with positions, such as `gravitating_bodies`.
        """
        return self._of_bodies("velocities", "velocities; take co.systems.bodies or gravitating_bodies")

    @property
    def angular_velocity(self) -> Floats:
        """The angular velocity in the frame of the body, in radians per time.

        That of classical bodies and tops is the derivative of the energy by the momentum. For components in space take
        ``sol.in_space(sol.angular_velocity)``.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError
            The system is not a body, such as `body` or `gravitating_bodies`.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.body((1.0, 2.0, 2.5))
        >>> x0 = body.state(angular_velocity=(0.0, 0.0, 90.0), degrees=True)
        >>> co.integrate(body, x0, (0, 1), 0.1).angular_velocity[-1].round(6)
        array([0.      , 0.      , 1.570796])
        """
        return self._of_bodies("angular_velocity", "angular velocity; take co.systems.body")

    @property
    def angular_momentum(self) -> Floats:
        """The angular momentum about the centre of mass, in the frame of the body.

        For components in space take ``sol.in_space(sol.angular_momentum)``. That of classical bodies and tops is the
        first part of the state, and that of a fluid on a sphere its own.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError
            The system is not a body, such as `body` or `gravitating_bodies`.
        """
        return self._of_bodies("angular_momentum", "angular momentum of bodies; take co.systems.body")

    @property
    def rotation(self) -> Rotation:
        """The attitude as rotations of SciPy, from the body to space: the group element, or its first block.

        Systems with attitudes in their states, such as `body`, have it in every run. For other bodies and tops it is
        the group element, or its first block, of runs with ``attitude=True``.

        Returns
        -------
        scipy.spatial.transform.Rotation
            One rotation for each saved time; for an ensemble one for each time and member, (times * members,), the
            members at the first time first; for k bodies one for each of them, the last axis, (times * k,).

        Raises
        ------
        TypeError
            The run has no attitude, or the attitude is not a rotation in three dimensions.
        ValueError
            Members have no attitude at some times.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0, 0), t_span=(0, 1), step=0.1, attitude=True)
        >>> sol.rotation[-1].as_rotvec().round(12)
        array([1., 0., 0.])
        """
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(self._rotations().reshape(-1, 3, 3))

    def in_space(self, vectors: npt.ArrayLike) -> Floats:
        """Return vectors in the frame of the body as components in space, by the attitude at the saved times.

        Parameters
        ----------
        vectors : (3,), or the shape of `angular_velocity`
            A direction fixed in the body, such as that of an instrument, or vectors at the saved times.

        Returns
        -------
        ndarray, shape (times, 3), (times, k, 3), or with an axis of members after the times

        Raises
        ------
        TypeError, ValueError
            As for `rotation`, and for vectors of another shape.

        Examples
        --------
        The angular momentum of a free body is constant in space:

        >>> import coadjoint as co
        >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
        >>> sol = co.integrate(body, (1.0, 0.2, 0.5), t_span=(0, 1), step=0.1, attitude=True)
        >>> sol.in_space(sol.angular_momentum)[-1].round(12)
        array([1. , 0.2, 0.5])
        """
        A, v = self._rotations(), read_numbers(vectors, "vectors")
        if v.shape not in ((3,), A.shape[:-1]):
            raise ValueError(f"vectors has shape {v.shape}; give (3,) or {A.shape[:-1]}")
        return np.einsum("...ij,...j->...i", A, v)

    def _rotations(self) -> Floats:
        """Return the attitudes from the body to space, (times, 3, 3), with axes of members and bodies inside."""
        if self.system.unforced.has_attitude:
            A: Any = self._of_bodies("attitudes", "attitude")
        else:
            if self.carried is None:
                raise TypeError(f"no rotation is known: {missing_attitude(self)}")
            A = rotations_of(self.attitude) if self.carried == "representation" else None
            if A is None:
                carried = "coadjoint matrices" if self.carried == "coadjoint" else "group elements"
                raise TypeError(
                    f"the {carried} of {self.system.name} are no rotations in three dimensions; integrate a body or a "
                    "top with attitude=True"
                )
        members = member_count(self)  # type: ignore[arg-type]
        lost = ~np.isfinite(A.reshape(len(A), members, -1)).all(axis=(0, -1))
        if lost.any():
            raise ValueError(
                f"attitudes of {members_text(lost)} are missing at some times, since these have not run so "
                "far, have failed, or were ended by events; take Rotation.from_matrix of attitude[:, m] of the others"
            )
        return np.asarray(A)

    def _of_bodies(self, name: str, what: str) -> Floats:
        """Return what the system of each member reads from its states, over times (and members)."""
        functions = [
            getattr(one.unforced, name, None) for one in (self.system if self.system.is_batch else (self.system,))
        ]
        if None in functions:
            raise TypeError(f"the states of {self.system.name} have no {what}")
        if not self.system.is_batch:
            return np.asarray(functions[0](self.x))  # type: ignore[misc]
        return np.stack([read(self.x[:, m]) for m, read in enumerate(functions)], axis=1)  # type: ignore[misc]


def missing_attitude(solution: Any) -> str:
    """Explain why a run has no group element, and where its attitude is found."""
    what = f"the run of {solution.system.name} has no"
    if solution.system.unforced.has_attitude:
        return f"{what} group element, since attitudes are part of its states; take sol.rotation"
    return f"{what} attitude; give attitude=True to integrate"


def member_count(solution: Solution) -> int:
    """Return the number of members, 1 of a single run."""
    return 1 if solution.failed is None else len(solution.failed)


def unfinished_members(solution: Solution) -> NDArray[np.bool_]:
    """Return which members, (members,), are not at the last saved point, without having failed."""
    members = member_count(solution)
    if solution.failed is None or not solution.incomplete or not len(solution.t):
        return np.zeros(members, dtype=bool)
    if (pending := solution._pending_members) is not None:
        return pending
    waiting = ~np.isfinite(solution.x[-1]).reshape(members, -1).all(axis=1) & ~solution.failed
    return waiting if solution.events is None else waiting & np.isnan(solution.events.ends(members))


def ends_by_events(solution: Solution) -> Floats:
    """Return the times at which events ended the members; NaN where none did, and for a single run."""
    if solution.failed is None or solution.events is None:
        return np.full(member_count(solution), np.nan)
    return solution.events.ends(member_count(solution))


def last_times(solution: Solution, unfinished: NDArray[np.bool_], direction: float) -> Floats:
    """Return the last saved times of unfinished members, (members,); before all times where none is, and of others."""
    ends = np.full(len(unfinished), -direction * np.inf)
    for m in np.flatnonzero(unfinished).tolist():
        saved = np.flatnonzero(np.isfinite(solution.x[:, m]).reshape(len(solution.t), -1).all(axis=1))
        if len(saved):
            ends[m] = solution.t[saved[-1]]
    return ends


def members_text(mask: NDArray[np.bool_]) -> str:
    """Describe members for messages: all, or their numbers."""
    numbers = np.flatnonzero(mask).tolist()
    return "all members" if len(numbers) == len(mask) else f"the members {short(numbers)}"


def rotations_of(attitude: Any) -> Floats | None:
    """Return group elements (..., d, d), or their rotation block, as matrices (..., 3, 3); None if it is none."""
    d = attitude.shape[-1]
    if d not in (3, 4, 5) or np.iscomplexobj(attitude) or (d == 5 and np.any(np.abs(attitude[..., 1:, 0]) > 0.0)):
        return None
    A = np.asarray(attitude)[..., 1:4, 1:4] if d == 5 else np.asarray(attitude)[..., :3, :3]
    ends = np.stack([A[0], A[-1]])
    with np.errstate(all="ignore"):
        products = ends @ np.swapaxes(ends, -1, -2)
    finite = products[np.isfinite(products).all(axis=(-1, -2))]  # members that have failed are not tested
    return A if np.abs(finite - np.eye(3)).max(initial=0.0) < ORTHOGONALITY else None


@ignore_overflow
def are_rotations(matrices: Floats) -> npt.NDArray[np.bool_]:
    """Return which matrices (..., 3, 3) are rotations; those of failed members and other states are none."""
    defect = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    return (defect < ORTHOGONALITY) & (np.linalg.det(np.nan_to_num(matrices)) > 0.0)
