"""Plot data of a run: selected members, names, refinement between saved points, and tests of their density."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.errors import IntegrationError
from coadjoint.pictures.register import CannotShow, coordinate_index
from coadjoint.pictures.style import coordinate
from coadjoint.runs.results.quantities import scales_of_invariants
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import member_count, rotations_of, unfinished_members
from coadjoint.runs.results.solution_output import is_driven
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.gallery_entry import GalleryEntry
from coadjoint.systems.registry import gallery_entry_of
from coadjoint.validation import read_integer, read_list, read_number

Floats = npt.NDArray[np.float64]

MAX_MEMBERS = 20  # more curves cannot be distinguished
MAX_CURVE_POINTS = 20_000  # more than printed lines resolve
SAMPLED = 64  # intervals examined
NUMBERS_SAMPLED = 2**19  # entries of the states examined; at least MIN_SAMPLED intervals
MIN_SAMPLED = 4  # intervals; fewer would be chance
REFINEMENTS = 4  # passes, while the refined motion is faster than estimated before
# Largest distance of a motion from the chord, relative to its range: for curves over time (11 points per circle), and
# for closed curves, whose repeated chords would form a ribbon (24 points per circle).
CHORD_TOLERANCE = 0.015
SPACE_CHORD_TOLERANCE = 0.003  # for closed curves
MAX_AXIS_TURN = 0.26  # radians between points of the path of an axis: 24 points per circle

REFINED_TOLERANCE = 1e-3
"""Largest distance of the motion from a chord, relative to its range: half a pixel of 500."""
REFINED_TURN = 0.14
"""Largest rotation of an attitude between points (radians): 45 points per turn."""
MAX_REFINED_POINTS = 10_000
"""Largest number of points of a refined curve: 16 per column of pixels."""
MAX_NUMBERS = 2**22
"""Largest number of state entries examined: 32 MB."""
MAX_SECONDS = 1.5
"""Largest estimated time (s) for computing states between the saved ones."""
COST_SECONDS = {"interval": 4e-4, "point": 2e-5, "state": 4e-6}
"""Cost model of intermediate states (s), besides the steps: per saved interval, time, and state of a member."""
SUFFICIENT_POINTS = 16
"""Number of saved points that suffice to measure a motion."""
DIFFERENCE_STEP = 1e-5
"""Relative displacement along the path for the finite difference of the field."""


class PlottedRun:
    """View of a run for plots: at most 20 members, evenly spread, always with an axis of members in `x`."""

    def __init__(self, solution: Solution, members: Any = None) -> None:
        self.solution = solution
        chosen = None if members is None else _read_members(solution, members)
        self.single = solution.failed is None
        states = np.ascontiguousarray(solution.x)
        self._type, states = states.dtype, _as_real(states)
        self.n = int(np.prod(solution.system.of_member(0).shape)) * (self._type.itemsize // states.dtype.itemsize)
        states = states.reshape(len(solution.t), -1, self.n)
        self.member_count = states.shape[1]  # of the run
        computed = np.arange(self.member_count)
        if solution.incomplete:
            waiting = unfinished_members(solution) & ~np.isfinite(states).all(axis=2).any(axis=0)
            _check_computed(waiting, chosen)
            computed = np.flatnonzero(~waiting)
        self.chosen = computed[spread(len(computed), MAX_MEMBERS)] if chosen is None else chosen
        self.system: Any = solution.system.of_member(int(self.chosen[0]))
        self.unforced: Any = self.system.unforced
        entry = gallery_entry_of(self.unforced.name)
        self.gallery_entry: GalleryEntry | None = None if entry is None else entry.of(self.unforced)
        self.t = solution.t
        self.x = self.select(states[:, 0] if self.single else states)

    @cached_property
    def refined(self) -> PlottedRun:
        """The run with states between the saved points (`Solution.at`), or itself for noise or too many states."""
        if not isinstance(self.solution, Solution) or self.random or len(self.t) < 2 or not np.isfinite(self.x).all():
            return self
        try:
            coarse = coarse_times(self)
            refined_run, result = self if coarse is None else self._with_times(coarse), self
            for _ in range(REFINEMENTS):
                times = times_between(self, refined_run)
                if times is None or len(times) <= len(result.t):
                    break
                refined_run = result = self._with_times(times)
        except (TypeError, ValueError, IntegrationError):
            return self
        return result

    @cached_property
    def random(self) -> bool:
        """Whether a force is noise, so that neither a field nor states between two steps exist."""
        return self.system.has_noise

    def _with_times(self, times: Floats) -> PlottedRun:
        """Return the same run at other times, which include the saved ones."""
        interpolated = self.solution.at(times)
        copied = copy.copy(self)
        for name in ("attitude", "rotation", "curve_indices", "joined", "axis_joined", "dense", "refined"):
            copied.__dict__.pop(name, None)
        copied.t = times
        copied.x = self.select(_as_real(interpolated.x).reshape(len(times), *(() if self.single else (-1,)), self.n))
        has_attitude = self.solution.carried == "representation" and interpolated.attitude is not None
        copied.__dict__["attitude"] = self.select(interpolated.attitude) if has_attitude else None
        copied.__dict__["refined"] = copied
        return copied

    def select(self, series: npt.ArrayLike) -> Floats:
        """Select the drawn members of a series (k, ...) or (k, members, ...); returns (members, k, ...)."""
        values = np.asarray(series)
        values = values[:, None] if self.single else values
        # A view if all members are drawn, since states may be large.
        all_drawn = np.array_equal(self.chosen, np.arange(self.member_count))
        return np.swapaxes(values if all_drawn else values[:, self.chosen], 0, 1)

    @cached_property
    def attitude(self) -> Floats | None:
        """Group elements in the representation of the system, (members, k, d, d)."""
        if self.solution.carried != "representation" or self.solution.attitude is None:
            return None
        return self.select(self.solution.attitude)

    @cached_property
    def rotation(self) -> Floats | None:
        """Rotation matrices (members, k, 3, 3): attitudes of states, group elements or their first block, or None."""
        if self.unforced.has_attitude:
            return None if self.unforced.bodies else self.unforced.attitudes(self.x)
        A = self.attitude
        if A is None:
            return None
        rotations = rotations_of(np.swapaxes(A, 0, 1))
        return None if rotations is None else np.swapaxes(rotations, 0, 1)

    @cached_property
    def invariants(self) -> Mapping[str, Floats]:
        """The energy and the Casimirs, {name: (members, k)}."""
        series = {"energy": self.solution.energy, **self.solution.casimirs}
        return {name: self.select(values) for name, values in series.items()}

    @property
    def x0(self) -> Floats:
        """The initial states (members, n), which `t_eval` may not save; real and imaginary parts as in `x`."""
        return _as_real(self.solution.x0).reshape(-1, self.n)[self.chosen]

    def at_start(self, invariant: str) -> Floats:
        """Return the values of an invariant at the start of the run, (members,), which `t_eval` may not save."""
        return np.atleast_1d(self.solution.initial[invariant])[self.chosen]

    @cached_property
    def changes(self) -> Mapping[str, Floats]:
        return {name: values - self.at_start(name)[:, None] for name, values in self.invariants.items()}

    @cached_property
    def scales(self) -> Mapping[str, Floats]:
        """The sizes of the invariants at the start, (members, 1), as in `Solution.drift`."""
        solution = self.solution
        sizes = scales_of_invariants(solution.system, solution.x0, solution.initial)
        return {name: np.atleast_1d(size)[self.chosen][:, None] for name, size in sizes.items()}

    @property
    def driven(self) -> bool:
        """Whether the Hamiltonian depends on time, so that the energy is not an invariant."""
        return is_driven(self.system)

    @cached_property
    def unexplained_change(self) -> Mapping[str, Floats] | None:
        """The change of each invariant minus the work of the forces on it, which is an error; None without forces."""
        work = getattr(self.solution, "work", None)
        if not work:
            return None
        done = {name: [self.select(by[name]) for by in work.values() if name in by] for name in self.changes}
        return {name: change - sum(done[name]) for name, change in self.changes.items()}

    @property
    def of_member(self) -> str:
        """For titles of pictures of the first drawn member: its number, if the run has several."""
        return "" if self.member_count == 1 else f" of member {int(self.chosen[0])}"

    @property
    def quantity(self) -> str:
        """Physical quantity of the coordinates."""
        return "momentum" if self.gallery_entry is None else self.gallery_entry.quantity

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates as plain text: those of the system, those of the basis, or x1, x2, ..."""
        return coordinate_names(self.unforced, self.n)

    def label(self, i: int) -> str:
        return coordinate(self.names[i])

    def index_of(self, chosen: Any) -> int:
        """Return the index of a coordinate given by number or name; raise CannotShow if there is none."""
        try:
            return coordinate_index(self.names, chosen)
        except ValueError as reason:
            raise CannotShow(f"coordinate {short(chosen)} is none of the {self.n} of the state: {reason}") from None

    @cached_property
    def curve_indices(self) -> npt.NDArray[np.int64]:
        """Indices of the points of curves in space: all, or 20 000 evenly spread ones."""
        return spread(len(self.t), MAX_CURVE_POINTS)

    @cached_property
    def joined(self) -> bool:
        """Whether lines between the points of a curve represent the motion; otherwise points are drawn as dots."""
        return self._flat(self.curve_indices, SPACE_CHORD_TOLERANCE)

    @cached_property
    def axis_joined(self) -> bool:
        """Whether lines between the points of the path of an axis represent the rotation of the attitude."""
        steps = np.abs(np.diff(self.t[self.curve_indices]))
        return self.joined and (not steps.size or float(np.quantile(steps, 0.9)) * fastest_turn(self) <= MAX_AXIS_TURN)

    @cached_property
    def dense(self) -> bool:
        """Whether lines between all saved points represent the motion over time."""
        return self._flat(np.arange(len(self.t)), CHORD_TOLERANCE)

    @ignore_overflow
    def _flat(self, indices: npt.NDArray[np.int64], tolerance: float) -> bool:
        """Test whether nine of ten intervals between points are nearly straight, for the first finite member."""
        if self.random or len(indices) < 3:
            return not self.random
        finite = np.isfinite(self.x[:, indices]).all(axis=(1, 2))
        m = int(np.argmax(finite))
        x = self.x[m][indices]
        size = float(np.linalg.norm(np.ptp(x[np.isfinite(x).all(axis=1)], axis=0)))
        if not size > 0.0:
            return True
        intervals = spread(len(indices) - 1, min(SAMPLED, max(MIN_SAMPLED, NUMBERS_SAMPLED // self.n)))
        distances = [self._chord_distance(x, self.t[indices], int(p), m) for p in intervals]
        return bool(np.quantile(distances, 0.9) <= tolerance * size)

    def _chord_distance(self, x: Floats, t: Floats, p: int, m: int) -> float:
        """Estimate the distance of the motion from a chord, ``|f(x1) - f(x0)| dt / 8`` with its field f."""
        dt = float(t[p + 1] - t[p])
        before, after = (self.slope(x[q], float(t[q]), m) for q in (p, p + 1))
        bend = float(np.linalg.norm(after - before)) * abs(dt) / 8.0
        # Large if the motion turns by about a period within the interval.
        mismatch = float(np.linalg.norm(0.5 * dt * (before + after) - (x[p + 1] - x[p])))
        distance = max(bend, mismatch)
        return distance if np.isfinite(distance) else 0.0

    def index_at(self, fraction: Any) -> int:
        """Return the index of the saved point nearest to a fraction of the span: 0 is the start, 1 the end."""
        time = self.t[0] + min(max(read_number(fraction, "at"), 0.0), 1.0) * (self.t[-1] - self.t[0])
        return int(np.argmin(np.abs(self.t - time)))

    def state(self, k: int) -> npt.NDArray[Any]:
        """Return a saved state of the first member, in its own shape."""
        return self._shaped(self.x[0, k])

    def evaluate(self, function: Any, k: int) -> tuple[Floats, float]:
        """Evaluate function(system, state) at saved point k, and its largest size at start, end and k."""
        fields = {
            j: np.asarray(function(self.unforced, self.state(j)), dtype=np.float64) for j in {0, k, len(self.t) - 1}
        }
        return fields[k], max(float(np.nanmax(np.abs(values), initial=0.0)) for values in fields.values()) or 1.0

    def _shaped(self, x: Floats) -> npt.NDArray[Any]:
        return np.ascontiguousarray(x).view(self._type).reshape(self.system.shape)

    def system_of(self, m: int) -> Any:
        return self.solution.system.of_member(int(self.chosen[m]))

    def slope(self, x: Floats, t: float, m: int = 0) -> Floats:
        """Return the field of a member at a state, as real numbers."""
        state = self._shaped(x)
        field = np.ascontiguousarray(self.system_of(m).vector_field(state, t), dtype=self._type)
        return field.view(np.float64).ravel()


def _as_real(states: npt.ArrayLike) -> Floats:
    """Return states as real numbers; complex matrices as interleaved real and imaginary parts."""
    values = np.ascontiguousarray(states)
    return values.view(np.float64) if np.iscomplexobj(values) else values


def _read_members(solution: Solution, members: Any) -> npt.NDArray[np.int64]:
    count = member_count(solution)
    listed = read_list(members, "members", "give numbers of members, such as [0, 3]")
    chosen = [read_integer(m, "a member", 0, count - 1) for m in listed]
    if not chosen or len(chosen) > MAX_MEMBERS or len(set(chosen)) < len(chosen):
        raise ValueError(f"members are {short(members)}; give from 1 to {MAX_MEMBERS} different numbers of members")
    return np.array(chosen, dtype=np.int64)


def _check_computed(waiting: npt.NDArray[np.bool_], chosen: npt.NDArray[np.int64] | None) -> None:
    """Raise ValueError if chosen members have not been computed, or none has."""
    missing = waiting if chosen is None else waiting[chosen]
    if missing.any() and (chosen is not None or missing.all()):
        numbers = np.flatnonzero(waiting) if chosen is None else chosen[missing]
        raise ValueError(
            f"members {short(numbers.tolist())} of the run have not been computed, and {np.sum(~waiting)} of "
            f"{len(waiting)} have; choose among these, or compute the others: `resume` continues an archive"
        )


def spread(count: int, max_count: int) -> npt.NDArray[np.int64]:
    """Return at most `max_count` of 0 ... count - 1, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).round().astype(np.int64))


def times_between(drawn: PlottedRun, refined_run: PlottedRun) -> Floats | None:
    """Return the times at which a smooth curve needs states; None if saved points suffice, or for too many."""
    run = drawn.solution
    length = min(_chord_duration(refined_run), REFINED_TURN / fastest_turn(refined_run))
    intervals = np.abs(np.diff(drawn.t))
    total = float(np.sum(np.maximum(1.0, intervals / length)))
    if total > MAX_REFINED_POINTS or total * run.x[0].size > MAX_NUMBERS:
        return None
    parts = np.maximum(1, np.ceil(intervals / length)).astype(np.int64)
    points = int(parts.sum())
    if points == len(intervals) or _seconds(run, int(np.count_nonzero(parts > 1)), points) > MAX_SECONDS:
        return None
    return _divided(drawn.t, parts)


def coarse_times(drawn: PlottedRun) -> Floats | None:
    """Return about 64 times that resolve a motion of a few periods; None if saved points suffice, or if expensive."""
    intervals = len(drawn.t) - 1
    if intervals >= SUFFICIENT_POINTS or _seconds(drawn.solution, intervals, SAMPLED) > MAX_SECONDS:
        return None
    return _divided(drawn.t, np.full(intervals, -(-SAMPLED // intervals)))


def _divided(t: Floats, parts: npt.NDArray[np.int64]) -> Floats:
    """Divide each interval into a number of parts; the times t have the same bits in the result."""
    inside = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(np.repeat(t[:-1], parts) + np.repeat(np.diff(t) / parts, parts) * inside, t[-1])


def _seconds(run: Solution, intervals: int, points: int) -> float:
    """Estimate the time for computing states at `points` times within `intervals` saved intervals."""
    members = member_count(run)
    # The steps are repeated, with a partial step for each state.
    steps = run.stats.seconds * (1.0 + points / max(1, run.stats.steps))
    point = COST_SECONDS["point"] + COST_SECONDS["state"] * members
    return steps + COST_SECONDS["interval"] * intervals + point * points


def _chord_duration(drawn: PlottedRun) -> float:
    """Return the longest time interval with a chord close to the motion: the distance is about |x''| dt^2 / 8."""
    shortest = np.inf
    sizes = np.linalg.norm(np.ptp(drawn.x, axis=1), axis=1).tolist()
    for m, x, t in _sampled_states(drawn):
        acceleration = _acceleration(drawn, m, x, t, sizes[m]) if sizes[m] > 0.0 else 0.0
        if acceleration > 0.0 and np.isfinite(acceleration):
            shortest = min(shortest, (8.0 * REFINED_TOLERANCE * sizes[m] / acceleration) ** 0.5)
    return shortest


def _sampled_states(drawn: PlottedRun) -> Iterator[tuple[int, Floats, float]]:
    """Yield about 64 states of the members, at least two of each: the number of the member, the state and its time."""
    count = min(max(2, SAMPLED // len(drawn.x)), len(drawn.t))
    for m, path in enumerate(drawn.x):
        for k in np.linspace(0, len(drawn.t) - 1, count).astype(np.int64).tolist():
            yield m, path[k], float(drawn.t[k])


def _acceleration(drawn: PlottedRun, m: int, x: Floats, t: float, size: float) -> float:
    """Return the size of the second derivative of the motion, by a finite difference of the field."""
    field = drawn.slope(x, t, m)
    speed = float(np.linalg.norm(field))
    if not speed > 0.0:
        return 0.0
    dt = DIFFERENCE_STEP * size / speed
    return float(np.linalg.norm(drawn.slope(x + dt * field, t + dt, m) - field)) / dt


@ignore_overflow
def fastest_turn(drawn: PlottedRun) -> float:
    """Return the largest angular speed of the attitude, in radians per unit of time; tiny without an attitude."""
    rho: Any = drawn.unforced.representation
    fastest = float(np.finfo(np.float64).tiny)
    if drawn.solution.carried != "representation" or rho is None:
        return fastest
    for m, x, t in _sampled_states(drawn):
        rate = np.tensordot(drawn.system_of(m).hamiltonian.gradient(x, t), rho, axes=1)
        # The matrix of an angular velocity has each component twice.
        fastest = max(fastest, float(np.linalg.norm(rate[:3, :3] if rate.shape[-1] == 4 else rate)) / 2.0**0.5)
    return fastest
