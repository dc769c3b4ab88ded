"""Runs repeated on other threads, prepared, watched, in another order or alone: the bits must be the same."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co

from .cases import REFUSALS, Case, case_of

SLOW = 2.0  # seconds; slower runs, near a blow-up, are only repeated


class Result(NamedTuple):
    """Results of a run: arrays by name, with members on the second axis unless the name has a star; and its failure.

    Crossings are rows of numbers for each member: time, event, direction, state. `failed` are the status and the step
    of members that failed, and zeros.
    """

    arrays: dict[str, np.ndarray]
    failure: tuple[Any, ...] | None
    crossings: tuple[np.ndarray, ...]
    failed: np.ndarray


def result_of(solution: co.Solution, failure: tuple[Any, ...] | None) -> Result:
    """Return every number of a solution; a single state is an ensemble of one."""
    along = {"x": solution.x, "energy": solution.energy, **{f"C {n}": v for n, v in solution.casimirs.items()}}
    if solution.attitude is not None:
        along["attitude"] = solution.attitude
    single = solution.x.ndim == 2
    arrays = {name: values[:, None] if single else values for name, values in along.items()}
    for name, drift in solution.drift().items():
        arrays[f"*{name}"] = np.atleast_2d(drift.tenths)
    state = solution.record.state
    failed = np.column_stack([state["status"], np.where(state["status"] != 0, state["step"], 0)])
    return Result(arrays, failure, crossings_of(solution.events, 1 if single else solution.x.shape[1]), failed)


def crossings_of(events: Any, members: int) -> tuple[np.ndarray, ...]:
    """Return the crossings of each member, one per row."""
    if events is None:
        return ()
    rows = np.column_stack([events.t, events.which, events.direction, events.x])
    return tuple(rows[events.member == m] for m in range(members))


def run(case: Case, members: Any = slice(None), **changes: Any) -> Result:
    """Run the case, or some of its members, with something changed."""
    chosen = np.arange(len(case.x0))[members]
    if case.batch:
        system = case.systems[int(chosen)] if chosen.ndim == 0 else co.batch([case.systems[m] for m in chosen])
    else:
        system = case.systems[0]
    arguments = {"attitude": case.attitude, "save_every": case.save_every, "watch": case.watch, "threads": 1}
    arguments |= {"events": case.events} | changes
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            solution = co.integrate(system, case.x0[chosen], case.t_span, case.step, case.method, **arguments)
            return result_of(solution, None)
    except co.IntegrationError as error:
        return result_of(error.partial, (error.step, error.time, repr(error.residual), str(error)))


def prepared_twice(case: Case) -> Result:
    """Run the case by a prepared run that was used for other states before."""
    system = co.batch(list(case.systems)) if case.batch else case.systems[0]
    ready = co.prepare(system, case.method, case.step, attitude=case.attitude, watch=case.watch, threads=1)
    with contextlib.suppress(co.IntegrationError):
        ready.run(0.7 * case.x0[::-1], case.t_span, 3)
    return prepared_by(ready, case)


def prepared_by(ready: co.PreparedRun, case: Case) -> Result:
    """Run the case by a prepared run."""
    try:
        return result_of(ready.run(case.x0, case.t_span, case.save_every, events=case.events), None)
    except co.IntegrationError as error:
        return result_of(error.partial, (error.step, error.time, repr(error.residual), str(error)))


def same(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two arrays have the same bits; all NaNs are equal."""
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    if one.shape != other.shape:
        return False
    none = np.isnan(one)
    return bool((none == np.isnan(other)).all()) and one[~none].tobytes() == other[~none].tobytes()


def differing(one: Result, other: Result, members: Any = slice(None), followed: bool = False) -> list[str]:
    """Return the names of arrays whose bits differ, of these members of the first.

    Multivalued Casimirs are `followed` between evaluations, and may differ by whole periods if these differ.
    """
    found = []
    if one.crossings and other.crossings:
        chosen = np.arange(len(one.crossings))[members]
        if not all(same(one.crossings[m], expected) for m, expected in zip(chosen, other.crossings, strict=True)):
            found.append("events")
    if not np.array_equal(one.failed[members], other.failed):
        found.append(f"steps of failures ({one.failed[members].tolist()} and {other.failed.tolist()})")
    for name in other.arrays.keys() & one.arrays.keys():
        actual, expected = one.arrays[name], other.arrays[name]
        actual = actual[members] if name.startswith("*") else actual[:, members]
        if not name.startswith("*") and other.failure is not None and expected.shape[1] == 1:
            actual = actual[: len(expected)]  # a single state ends at its failure
        if not same(actual, expected) and not (followed and name.startswith("C ") and "log" in name):
            found.append(name)
    return found


def at_any_time(case: Case, rng: np.random.Generator, every: Result) -> Iterator[str]:
    """Yield differences of the states between the steps of a successful run."""
    steps = round(abs(case.t_span[1] - case.t_span[0]) / case.step)
    way, count = (1.0 if case.t_span[1] >= case.t_span[0] else -1.0), len(case.x0)
    numbers = np.sort(np.append(rng.integers(0, steps + 1, 3), [0, steps]))
    inside = rng.integers(0, max(steps, 1), 5) + rng.uniform(0.05, 0.95, 5)
    times = case.t_span[0] + way * case.step * np.sort(np.append(numbers, inside if steps else []))
    at_steps = np.isin(times, case.t_span[0] + way * case.step * numbers)
    arguments = {"t_eval": times, "save_every": 1}
    checked = run(case, **arguments)
    if checked.failure is not None:
        # Noise has no states between steps, or the energy is not finite there.
        return
    if differing(checked, run(case, threads=3, **arguments)):
        yield "states at any time: other bits on threads"
    for name, values in every.arrays.items():
        if not name.startswith("*") and not (name.startswith("C ") and "log" in name):
            if not same(checked.arrays[name][at_steps], values[numbers]):
                yield f"states at any time: {name} has other bits at the steps"
    for m in sorted({0, count - 1}):
        names = differing(checked, run(case, m, **arguments), members=slice(m, m + 1))
        if names:
            yield f"states at any time: {', '.join(sorted(names))} of member {m} differ from those that it has alone"


def ended(case: Case, rng: np.random.Generator, expected: Result) -> Iterator[str]:
    """Yield differences of a run that is ended by one of its events."""
    chosen = int(rng.integers(len(case.events)))
    ending = dataclasses.replace(case.events[chosen], terminal=True)
    events = (*case.events[:chosen], ending, *case.events[chosen + 1 :])
    ensemble = run(case, events=events)
    if ensemble.failure is not None:
        return
    if differing(ensemble, run(case, events=events, threads=3)):
        yield "ended by an event: other bits on threads"
    for m in sorted({0, len(case.x0) - 1, int(rng.integers(len(case.x0)))}):
        at_end = ensemble.crossings[m][ensemble.crossings[m][:, 1] == chosen]
        over = len(at_end) == ending.until
        alone = run(case, m, events=events)
        points = len(alone.arrays["x"]) - over
        actual, second = ensemble.crossings[m], expected.crossings[m]
        agree = same(alone.crossings[0], actual)
        if over:
            # No value of g follows the last step, which may show pairs of crossings that the full run misses.
            agree &= any(same(actual[-1], row) for row in second)
            step = np.floor(abs(actual[:, 0] - case.t_span[0]) / case.step)
            actual = actual[step < step[-1]]
        if not agree or not same(second[: len(actual)], actual):
            yield f"ended by an event: other crossings of member {m}"
        for name in ("x", "energy"):
            actual = ensemble.arrays[name][:, m]
            if not same(actual[:points], alone.arrays[name][:points, 0]) or not same(
                actual[:points], expected.arrays[name][:points, m]
            ):
                yield f"ended by an event: {name} of member {m} has other bits before its end"
            if not np.isnan(actual[points:]).all():
                yield f"ended by an event: {name} of member {m} continues after its end"
        if over and not same(alone.arrays["x"][-1, 0].ravel(), at_end[-1, 3:]):
            yield f"ended by an event: the last state of member {m} is not that of the event"


def differences(seed: int) -> Iterator[str]:
    """Yield a description of every difference of bits in the case of a seed."""
    case, rng = case_of(seed)
    began = time.perf_counter()
    try:
        expected = run(case)
    except REFUSALS:
        return  # refused before the first step
    count = len(case.x0)

    def compared(
        label: str, other: Result, failing: bool = True, same_steps: bool = True, **where: Any
    ) -> Iterator[str]:
        names = differing(expected, other, **where)
        if names:
            yield f"{label}: {', '.join(sorted(names))} differ"
        # With other watched steps, a non-finite energy may occur in one run only.
        of_energy = not same_steps and any(left.failure and "energy" in left.failure[3] for left in (expected, other))
        # Own steps that are evaluated at other points within them fail there, with another last correction.
        parts = slice(None) if same_steps else slice(2)
        if failing and not of_energy and (expected.failure or ())[parts] != (other.failure or ())[parts]:
            yield f"{label}: failed as {other.failure}, not as {expected.failure}"

    yield from compared("again", run(case))
    if time.perf_counter() - began > 2 * SLOW:
        return
    yield from compared("threads", run(case, threads=int(rng.integers(2, 5))))
    yield from compared("with a progress bar, in pieces", run(case, progress=True))
    yield from compared("prepared, after other states", prepared_twice(case))
    unwatched = run(case, watch=not case.watch)
    arrays = {n: v for n, v in unwatched.arrays.items() if not n.startswith("*")}
    saved = unwatched._replace(arrays=arrays)
    yield from compared("watched or not", saved, same_steps=False, followed=True)
    steps = round(abs(case.t_span[1] - case.t_span[0]) / case.step)
    every = run(case, save_every=1)
    stored = sorted({*range(0, steps + 1, case.save_every), steps})
    within = {n: v[[k for k in stored if k < len(v)]] for n, v in every.arrays.items() if not n.startswith("*")}
    if case.watch:
        within |= {n: v for n, v in every.arrays.items() if n.startswith("*")}
    saved_every = every._replace(arrays=within)
    yield from compared("every step saved", saved_every, same_steps=False, followed=not case.watch)
    if expected.failure is None:
        yield from at_any_time(case, rng, every)
        if case.events:
            yield from ended(case, rng, expected)
    if case.attitude is not False and expected.failure is None:
        yield from compared("without attitude", run(case, attitude=False), failing=False)
    turned = rng.permutation(count)[: max(1, count // 2)]
    yield from compared("some, in another order", run(case, turned), failing=False, members=turned)
    backward = np.arange(count)[::-1]
    yield from compared("in the opposite order", run(case, backward), failing=False, members=backward)
    for m in sorted({0, count - 1, int(rng.integers(count))}):
        alone = run(case, m)
        yield from compared(f"member {m} alone", alone, failing=False, members=slice(m, m + 1))
        if count > 1 and (alone.failure is not None) != bool(np.isnan(expected.arrays["x"][-1, m]).any()):
            if not (alone.failure and "energy" in alone.failure[3]):
                yield f"member {m} alone: failed as {alone.failure}, other than in the ensemble"
