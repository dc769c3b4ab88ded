"""The error of a step, measured by two half steps at a few points of a run, and a warning if it is large."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import LargeStepWarning
from coadjoint.long_operations import warn_caller
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.passed_poles import passed_pole, states_in_memory
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.unfinished_members import ends_by_events
from coadjoint.runs.start import momenta_of, vector_size, with_group
from coadjoint.runs.times import Times
from coadjoint.systems.protocol import forces_of, is_batch, member_of, states_of

Floats = NDArray[np.float64]

# Largest number of points, and of members, at which the step is repeated.
POINTS, MEMBERS = 5, 64
# Largest number of entries of the states that are repeated; at least one state.
NUMBERS = 2**20
# Weight of the error of the single fastest step, beside that of the others in the root mean square.
FASTEST = 0.4
# Least speed of a passage, relative to the mean speed; below, the steps at the points represent all.
PASSAGE = 2.0
# Largest number of steps between two saved points that are repeated to find the fastest one, and part of the run.
STEPS, PART = 1000, 0.05
# Largest number of entries of the states in repeated steps, if they are not a small part of the run.
REPEATED = 2**18
# Differences between a step and two half steps by rounding alone, relative to the state.
ROUNDING = 64 * UNIT_ROUNDOFF
# Largest error of a step, relative to the change of the state in it, without a warning, and that of the step suggested.
# At rest all of the change is error; then the first is that of the whole run, relative to the state.
WARNED, SUGGESTED = 0.02, 0.002
# Largest change by the field in a step, relative to the error of a step, of a state that is at rest.
AT_REST = 0.01


def step_error(solution: Solution, prepared: PreparedRun | None = None) -> float:
    """Return the largest error of a step among the members, relative to the change of the state; see `Solution`."""
    return _worst(solution, prepared).error


class Worst(NamedTuple):
    """The largest error of a step among the members, with its member.

    Of a run at rest `total` is such an error in each of its steps, relative to the state, else infinite; `pole` is the
    time of a pole passed.
    """

    error: float
    member: int
    total: float
    pole: float | None = None


def _worst(solution: Solution, prepared: PreparedRun | None) -> Worst:
    # An archive need not know its scheme and system; that of a run with inputs has their values.
    described: Any = solution if prepared is None or prepared.takes_inputs else prepared
    method, system = described.method, described.system
    if method.own_steps:
        raise TypeError(f"{method} chooses its own steps, and controls their error; there is no step to measure")
    if any(force.random for _, force in forces_of(system)):
        raise TypeError(f"{system.name} has random forces, which are defined for whole steps only")
    # Loops of a run with attitudes need elements, and those with inputs their values.
    if prepared is None or prepared.representation is not None or prepared.takes_inputs:
        prepared = PreparedRun(system, method, solution.step, watch=False)
    h = math.copysign(solution.step, solution.t_span[1] - solution.t_span[0])
    members = _members(solution, system)
    points = _points(solution, system, members)
    if is_batch(system) and len(members) < len(system):
        prepared = prepared.sampled(members)
    if is_batch(system) or member_of(system).hamiltonian.timed or forces_of(system):
        pairs = [_squares(prepared, states, t, h) for t, states, _ in points]
    else:
        count = len(points[0][1])
        all_states = [states for _, states, _ in points]
        states = all_states[0] if len(points) == 1 else np.concatenate(all_states)
        squares = _squares(prepared, states, points[0][0], h)
        pairs = [squares[:, k * count : (k + 1) * count] for k in range(len(points))]
    errors, changes = np.sum([np.where(held, pair, 0.0) for pair, (_, _, held) in zip(pairs, points, strict=True)], 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(np.sqrt(errors / changes), nan=0.0)
    worst = int(np.argmax(relative))
    end = float(ends_by_events(solution)[members[worst]])
    steps = abs((solution.t_span[1] if math.isnan(end) else end) - solution.t_span[0]) / solution.step
    known = [states[worst] for _, states, held in points if held[worst]]
    mean = math.sqrt(errors[worst] / len(known))
    one, total = member_of(system, int(members[worst])), math.inf
    if relative[worst] > WARNED and (
        np.linalg.norm(one.vector_field(states_of(one, known[0]), points[0][0])) * abs(h) <= AT_REST * mean
    ):
        total = steps * mean / (math.sqrt(np.mean([np.sum(state**2) for state in known])) or 1.0)
    largest = Worst(float(relative[worst]), int(members[worst]), total)
    if states_in_memory(solution) and len(solution.t) > 1:
        passage, closest = _passages(solution, system, members)
        found = [] if passage is None else [(_error_of_passage(solution, prepared, members, *passage, h), passage[0])]
        found += _error_inside(solution, prepared, members, closest, h)
        for fastest, m in found:
            if FASTEST * fastest > largest.error:
                largest = Worst(FASTEST * fastest, int(members[m]), math.inf)
    pole = passed_pole(solution, system, method, members, h)
    return largest if pole is None else Worst(math.inf, int(members[pole.member]), math.inf, pole.t)


def _passages(solution: Solution, system: Any, members: NDArray[np.int64]) -> tuple[tuple[int, int] | None, int]:
    """Return the fastest passage, and the saved interval over which the states change least.

    The passage is the member, among the chosen ones, and the saved interval; None if no passage is much faster than the
    rest. Of long runs, first the fastest of many equal pieces is found.
    """
    count = len(solution.t) - 1
    stride = min(count, max(1, count * len(members) * system.dim // NUMBERS))

    def speeds(first: int, last: int, stride: int) -> Floats:
        """Speeds between every stride-th saved point, (intervals, members); NaN of members that have ended."""
        states = solution.x[first : last + 1 : stride]
        states = states.reshape(len(states), -1, states[0].size // max(1, _members_of(solution)))[:, members]
        elapsed = np.abs(np.diff(solution.t[first : last + 1 : stride]))[:, None]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            found = np.linalg.norm(np.diff(states, axis=0), axis=2) / elapsed
        return np.where(np.isfinite(found), found, np.nan)

    found = speeds(0, count, stride)
    known = ~np.isnan(found)
    mean = np.where(known, found, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    ratios = np.where(known, found / np.where(mean > 0.0, mean, np.inf), 1.0)
    m = int(np.argmax(ratios.max(axis=0)))
    closest = stride * int(np.argmin(ratios.sum(axis=1)))
    if ratios[:, m].max() < PASSAGE:
        return None, closest
    first = stride * int(np.argmax(ratios[:, m]))
    last = min(first + stride, count)
    inner = np.nan_to_num(speeds(first, last, 1)[:, m], nan=0.0) if stride > 1 else np.zeros(1)
    return (m, first + int(np.argmax(inner))), closest


def _error_inside(
    solution: Solution, prepared: PreparedRun, members: NDArray[np.int64], k: int, h: float
) -> list[tuple[float, int]]:
    """Return the error of the fastest step after saved point k, and its member, of the one with the fastest passage.

    The list is empty if no member has one. States that return between saved points do not show their passages.
    """
    steps = _steps_after(solution, k, h)
    states = _states_at(solution, members, k)
    if not 1 < steps <= _most_steps(solution, states.size, h):
        return []
    if is_batch(prepared.system) and len(members) < len(prepared.system):
        prepared = prepared.sampled(members)
    t = float(solution.t[k])
    path = _run(prepared, states, Times(t, h, steps, 1))
    # Steps after the end of a member are not in the run.
    left = (ends_by_events(solution)[members] - t) / h
    path[np.arange(steps + 1)[:, None] - 1.0 > np.where(np.isnan(left), np.inf, left)] = np.nan
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.nan_to_num(np.linalg.norm(np.diff(path, axis=0), axis=2), nan=0.0, posinf=0.0)
    mean = lengths.mean(axis=0)
    ratios = lengths.max(axis=0) / np.where(mean > 0.0, mean, np.inf)
    m = int(np.argmax(ratios))
    if ratios[m] < PASSAGE:
        return []
    j = int(np.argmax(lengths[:, m]))
    if is_batch(prepared.system):
        prepared = prepared.sampled(np.array([m]))
    errors, changes = _squares(prepared, path[j, m][None], t + j * h, h)
    return [(float(np.sqrt(errors[0] / changes[0])), m)] if changes[0] > 0.0 else []


def _steps_after(solution: Solution, k: int, h: float) -> int:
    """Return the number of steps to the next saved point, rounded up."""
    return math.ceil(abs(float(solution.t[k + 1] - solution.t[k])) / abs(h) * (1.0 - ROUNDING))


def _states_at(solution: Solution, members: NDArray[np.int64], k: int) -> Floats:
    """Return the momenta of the members at a saved point; of members that have ended or failed, those at the start."""
    states = np.where(np.isfinite(solution.x[k]), solution.x[k], solution.x0)
    return momenta_of(solution.system, states)[0][members]


def _most_steps(solution: Solution, numbers: int, h: float) -> int:
    """Return the largest number of steps that are repeated from so many numbers: few, or a small part of the run."""
    whole = abs(solution.t_span[1] - solution.t_span[0]) / abs(h)
    return max(min(STEPS, REPEATED // numbers), min(int(PART * whole), NUMBERS // numbers))


def _members_of(solution: Solution) -> int:
    return 1 if solution.failed is None else len(solution.failed)


def _error_of_passage(
    solution: Solution, prepared: PreparedRun, members: NDArray[np.int64], m: int, k: int, h: float
) -> float:
    """Return the error of the fastest step after saved point k of a chosen member, relative to the change in it."""
    system, t = prepared.system, float(solution.t[k])
    if is_batch(system):
        prepared = prepared.sampled(np.array([m]))
    state = _states_at(solution, members[m : m + 1], k)
    steps = _steps_after(solution, k, h)
    if 1 < steps <= max(STEPS, _most_steps(solution, state.size, h)):
        path = _run(prepared, state, Times(t, h, steps, 1))
        j = int(np.argmax(np.nan_to_num(np.linalg.norm(np.diff(path[:, 0], axis=0), axis=1), nan=0.0)))
        state, t = path[j], t + j * h
    errors, changes = _squares(prepared, state, t, h)
    return float(np.sqrt(errors[0] / changes[0])) if changes[0] > 0.0 else 0.0


def _members(solution: Solution, system: Any) -> NDArray[np.int64]:
    """Return the members whose steps are repeated: the first few of each system."""
    if not is_batch(system):
        return np.arange(min(1 if solution.failed is None else len(solution.failed), MEMBERS))
    order = np.argsort(system.owners, kind="stable")
    owners = system.owners[order]
    return np.sort(order[np.arange(len(order)) - np.searchsorted(owners, owners) < MEMBERS])


def _points(
    solution: Solution, system: Any, members: NDArray[np.int64]
) -> list[tuple[float, Floats, NDArray[np.bool_]]]:
    """Return a few times of a run, the start included, the states (members, n) of some members, and who has one."""
    size = vector_size(system)
    start = momenta_of(system, solution.x0)[0] if size is None else np.asarray(solution.x0).reshape(-1, size)
    start = start if len(start) == 1 else start[members]
    count = max(1, min(POINTS, NUMBERS // start.size, len(solution.t) - 1))
    points = [(solution.t_span[0], start, np.ones(len(start), dtype=bool))]
    if not states_in_memory(solution):
        return points
    for k in np.linspace(0, len(solution.t) - 1, count, endpoint=False).astype(int)[1:].tolist():
        # Members that have ended or failed need some state; their steps are left out.
        finite = np.isfinite(solution.x[k])
        states, _ = momenta_of(system, np.where(finite, solution.x[k], solution.x0))
        held = finite.reshape(_members_of(solution), -1).all(axis=1)
        points.append((float(solution.t[k]), states[members], held[members]))
    return points


def _squares(prepared: PreparedRun, states: Floats, t: float, h: float) -> Floats:
    """Return squared errors and changes of a step, (2, members); zeros where the step cannot be repeated."""
    with np.errstate(over="ignore", invalid="ignore"):
        middle, halved = _run(prepared, states, Times(t, 0.5 * h, 2, 1).with_saved_steps([1, 2]))
        change = np.linalg.norm(middle - states, axis=1)
    # Without the arrays of this run, of a large state.
    halved, middle = halved.copy(), None
    (full,) = _run(prepared, states, Times(t, h, 1, 1).with_saved_steps([1]))
    # The difference of two half steps from a step of order p is all but 2^-p of the error of the latter.
    factor = 1.0 / (1.0 - 0.5**prepared.method.order)
    with np.errstate(over="ignore", invalid="ignore"):
        errors = factor * np.linalg.norm(full - halved, axis=1)
        errors = np.maximum(0.0, errors - ROUNDING * np.linalg.norm(states, axis=1))
        changes = np.max([np.linalg.norm(full - states, axis=1), change], axis=0)
        squares: Floats = np.array([errors, changes]) ** 2
    squares[:, ~np.isfinite(squares).all(axis=0)] = 0.0
    return squares


def _run(prepared: PreparedRun, states: Floats, times: Times) -> Floats:
    run = prepared.begun(times, with_group(prepared.system, states, False, None, False))
    run.advance()
    x: Any = run.saved["x"][..., : states.shape[1]]
    x[:, run.state["status"] != 0] = np.nan
    return x


def warn_of_large_step(solution: Solution, prepared: PreparedRun) -> None:
    """Warn if the error of a step is a large part of the change of the state in it."""
    if prepared.method.own_steps or any(force.random for _, force in forces_of(prepared.system)):
        return
    try:
        error, member, total, pole = _worst(solution, prepared)
    except Exception:
        # Functions of the user may refuse half steps, which are no part of the run; `step_error` raises their errors.
        return
    solution.__dict__["_step_error"] = error
    motion = "this motion" if solution.failed is None else f"the motion of member {member}"
    if pole is not None:
        warn_caller(
            f"{motion} passed through a pole of {prepared.method} at t = {pole:g}: 1 - h/2 f'(x) is singular for a "
            f"shorter step than {solution.step:g}, the state goes through infinity, and later states are not those of "
            "the motion; take a smaller step, or end the run earlier if the motion itself goes to infinity there",
            LargeStepWarning,
        )
    elif error > WARNED and total > WARNED:
        suggested = solution.step * (SUGGESTED / min(error, total)) ** (1.0 / prepared.method.order)
        warn_caller(
            f"the step {solution.step:g} is too large for {motion}: the error of a step of {prepared.method} is "
            f"{error:.2g} of the change of the state, though invariants may be kept; take a step of about "
            f"{suggested:.1g}",
            LargeStepWarning,
        )
