"""All pairs of arguments of the functions that run: each has its effect beside the other, or both are named."""

import inspect
import os
from collections.abc import Callable
from contextlib import contextmanager
from functools import cache
from itertools import combinations, combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from argument_cases import ACCURACY, LINEAR, MEMBERS, NEAR, STEP, WORLDS, Case
from coadjoint.files.archives import dask_blocks
from coadjoint.runs import prepared_run, run


class Argument(NamedTuple):
    """A value for a case, and a function that detects its effect in a result; None for values that are refused."""

    value: Callable[[Case], Any]
    seen: Callable[[Case, Any], bool] | None


def clock(x, t):
    return x[0] + 10.0 * t


def accurate(case, sol):
    if sol.choice is None:
        return False
    off = np.linalg.norm(sol.x[-1] - case.motion(sol.t[-1:])[0], axis=-1)
    largest = np.linalg.norm(case.motion(np.linspace(*case.span, 200)), axis=-1).max(axis=0)
    return sol.choice.accuracy == ACCURACY and bool(np.all(off <= ACCURACY * largest))


def every_third(case, sol):
    numbers = np.append(np.arange(0, sol.stats.steps, 3), sol.stats.steps)
    off = sol.t - (1.0 + case.way * sol.step * numbers) if len(sol.t) == len(numbers) else np.inf
    return bool(np.max(np.abs(off)) < 1e-12)


def turned(case, sol):
    """The elements begin where they were given, and K x (for so(3), R x) is constant."""
    if sol.attitude is None:
        return False
    start = case.start
    fixed = np.einsum("mij,mj->mi", start, case.world.x0)
    now = np.einsum("kmij,kmj->kmi", sol.attitude, sol.x)
    moved = np.abs(sol.attitude[-1] - start).max(axis=(1, 2)).min() > 0.1
    return bool(np.array_equal(sol.attitude0, start) and np.abs(now - fixed).max() < 1e-4 and moved)


@cache
def at_every_step(name, span, step, method, moved):
    """Return the energy drifts at every step."""
    world = WORLDS[name]
    ready = co.prepare(world.system, method, step, inputs=True if moved else None)
    energy = ready.run(world.x0, span, **({"linear": LINEAR[name]} if moved else {})).energy
    return np.abs(energy - energy[0])


def unwatched(case, sol):
    """Drifts are over all steps, or, unwatched, over the saved points."""
    off = at_every_step(case.name, case.span, sol.step, sol.method, "inputs" in case.given)
    # A time at a step is that step.
    numbers = np.unique(np.floor(np.abs(sol.t - 1.0) / sol.step + 1e-9).astype(int))
    expected = (off if sol.watched else off[numbers]).max(axis=0)
    assert np.array_equal(sol.drift(relative=False)["energy"].members, expected)
    return not sol.watched


def observed(case, sol):
    if set(sol.observed) != {"first", "clock"}:
        return False
    late = sol.x[..., 0] + 10.0 * sol.t[:, None]
    return np.array_equal(sol.observed["first"], sol.x[..., 0]) and np.allclose(sol.observed["clock"], late, 0, 1e-12)


def crossed(case, sol):
    """Each member crosses where its motion does."""
    if sol.events is None:
        return False
    t = np.linspace(*case.span, 4000)
    x = case.motion(t, "inputs" in case.given)[..., case.world.crossing]
    assert np.any(np.min(x, axis=0) * np.max(x, axis=0) < 0.0)
    for m in range(MEMBERS):
        wanted = t[1:][np.diff(np.sign(x[:, m])) != 0]
        found = sol.events.of(m)
        if len(found.t) != len(wanted) or np.abs(found.t - wanted).max(initial=0) > NEAR:
            return False
        assert np.abs(found.x[:, case.world.crossing]).max(initial=0.0) < 1e-13
    return True


def archived(case, sol):
    path = case.folder / "run.zarr"
    return path.exists() and sol.path == path and np.array_equal(co.open_archive(path).x, sol.x)


def two_threads(case, sol):
    if {"client", "workers"} & set(case.given):
        return {*case.client.threads, *case.cluster.threads} == {2}
    return set(case.threads) == {2}


def gauss(case, sol):
    return isinstance(sol.method, co.GaussLegendre) and sol.method.stages == 3 and sol.stats.iterations > 0


def initial_elements(case):
    """Return other elements than those of the case: transposed, or of the coadjoint action."""
    if not isinstance(case.world.attitude, str):
        return case.world.attitude.transpose(0, 2, 1)
    algebra = case.world.systems[0].algebra
    return np.stack([expm(0.3 * (m + 1) * algebra.coadjoint(np.eye(algebra.dim)[m])) for m in range(MEMBERS)])


def moved(case, sol):
    return np.abs(sol.x - case.motion(sol.t, moved=True)).max() < NEAR


def observe(case):
    n = case.world.x0.shape[1]
    return {"first": co.Polynomial({(1, *(0,) * (n - 1)): 1.0}), "clock": clock}


METHOD = Argument(lambda case: co.GaussLegendre(3), gauss)
STEPS = Argument(lambda case: STEP / 2, lambda case, sol: sol.step == STEP / 2)
THIRD = Argument(lambda case: 3, every_third)
AT_TIMES = Argument(lambda case: case.times, lambda case, sol: np.array_equal(sol.t, case.times))
ATTITUDE = Argument(lambda case: case.world.attitude, turned)
WATCH = Argument(lambda case: False, unwatched)
OBSERVED = Argument(observe, observed)
THREADS = Argument(lambda case: 2, two_threads)
PROGRESS = Argument(lambda case: True, lambda case, sol: "(100 %)" in case.printed)
EVENTS = Argument(lambda case: co.Event(case.world.crossing), crossed)
REFUSED = Argument(lambda case: 1e-6, None)


class Entry(NamedTuple):
    """A function, or two that belong together, and its arguments; `beside` are given in each call."""

    call: Callable[[Case], Any]
    signatures: tuple[Callable[..., Any], ...]
    beside: set[str]
    arguments: dict[str, Argument]
    refused: tuple[set[str], ...] = ()
    needs: tuple[tuple[str, str], ...] = ()


def integrate(case):
    given = dict(case.given) if "accuracy" in case.given else {"step": STEP} | case.given
    return co.integrate(case.world.system, case.world.x0, case.span, **given)


RUN = ("save_every", "t_eval", "progress", "events")


def prepare_and_run(case):
    """Backward the sample has slow motions only: each run with `accuracy` has a choice of its own."""
    given = {"step": STEP} | case.given
    if "accuracy" in given:
        sample = case.world.x0 if case.way > 0 else 0.1 * case.world.x0[:2]
        given |= {"x0": sample, "t_span": case.span}
        if "step" not in case.given:
            del given["step"]
    now = {name: given.pop(name) for name in RUN if name in given}
    if "run attitude" in given:
        now["attitude"] = given.pop("run attitude")
    if given.get("inputs"):
        now["linear"] = LINEAR[case.name]
    return co.prepare(case.world.system, **given).run(case.world.x0, case.span, **now)


def ensemble(case):
    return co.ensemble(case.world.system, case.world.x0, case.span, STEP, **case.given)


ENTRIES = {
    "integrate": Entry(
        integrate,
        (co.integrate,),
        {"system", "x0", "t_span"},
        {
            "step": STEPS,
            "method": METHOD,
            "accuracy": Argument(lambda case: ACCURACY, accurate),
            "save_every": THIRD,
            "t_eval": AT_TIMES,
            "attitude": ATTITUDE,
            "watch": WATCH,
            "observe": OBSERVED,
            "threads": THREADS,
            "progress": PROGRESS,
            "events": EVENTS,
            "archive": Argument(lambda case: case.folder / "run.zarr", archived),
            "rtol": REFUSED,
            "atol": REFUSED,
        },
        ({"step", "accuracy"}, {"save_every", "t_eval"}, {"archive", "t_eval"}, {"archive", "events"}),
    ),
    "prepare": Entry(
        prepare_and_run,
        (co.prepare, co.PreparedRun.run),
        {"self", "system", "x0", "t_span"},
        {
            "step": STEPS,
            "method": METHOD,
            "accuracy": Argument(lambda case: ACCURACY, accurate),
            "attitude": ATTITUDE,
            "watch": WATCH,
            "observe": OBSERVED,
            "threads": THREADS,
            "inputs": Argument(lambda case: True, moved),
            "run attitude": Argument(
                initial_elements, lambda case, sol: turned(case, sol) and "run attitude" in case.given
            ),
            "save_every": THIRD,
            "t_eval": AT_TIMES,
            "progress": PROGRESS,
            "events": EVENTS,
        },
        ({"step", "accuracy"}, {"save_every", "t_eval"}, {"accuracy", "inputs"}),
        (("run attitude", "attitude"),),
    ),
    "ensemble": Entry(
        ensemble,
        (co.ensemble,),
        {"system", "x0", "t_span", "step"},
        {
            "method": METHOD,
            "save_every": THIRD,
            "attitude": ATTITUDE,
            "watch": WATCH,
            "observe": OBSERVED,
            "archive": Argument(lambda case: case.folder / "run.zarr", archived),
            "client": Argument(lambda case: case.client, lambda case, sol: bool(case.client.threads)),
            "workers": Argument(lambda case: 2, lambda case, sol: case.processes == [2]),
            "members_per_block": Argument(lambda case: 3, lambda case, sol: sol.attributes["archive_block"] == 3),
            "threads": THREADS,
            "progress": PROGRESS,
            "coordinates": Argument(
                lambda case: {"gain": np.arange(MEMBERS)},
                lambda case, sol: np.array_equal(sol.to_xarray().get("gain", ()), np.arange(MEMBERS)),
            ),
        },
        ({"client", "workers"},),
        (("client", "archive"),),
    ),
}


def covering_sets(entry, most):
    """Yield sets of arguments that cover all pairs, up to `most` in one call; refused pairs alone."""
    if most == 2:
        yield from map(frozenset, combinations_with_replacement(entry.arguments, 2))
        return
    left = {frozenset(pair) for pair in combinations(entry.arguments, 2)}
    refused = {frozenset(pair) for pair in entry.refused}
    yield from refused
    left -= refused
    while left:
        found = set(min(left, key=sorted))
        while len(found) < most:
            gains = {
                each: sum(frozenset({each, one}) in left for one in found)
                for each in entry.arguments
                if each not in found and not any(frozenset({each, one}) in refused for one in found)
            }
            if not gains or max(gains.values()) == 0:
                break
            found.add(max(gains, key=gains.get))
        left -= {frozenset(pair) for pair in combinations(found, 2)}
        yield frozenset(found)


# Blocks in archives take longer. A run prepared for an accuracy has two branches.
CALLS = [
    (name, " and ".join(sorted(names)), way)
    for name, entry in ENTRIES.items()
    for number, names in enumerate(covering_sets(entry, 5 if name == "ensemble" else 2))
    for way in ((1.0, -1.0) if name == "prepare" and "accuracy" in names else ((-1.0) ** number,))
]


@pytest.fixture
def case(monkeypatch, tmp_path):
    """A case that counts threads, processes and tasks; none is started unless it is requested."""
    found, real = Case("so(3)", 1.0, tmp_path), run.run_in_threads

    def counted(member_batches, given, loops, workers=1):
        done, target = given[-2:]
        # Archives take no step, or one, before their runs.
        if workers > 1 and target > done + 1:
            found.threads.append(workers)
        return real(member_batches, given, loops, workers)

    @contextmanager
    def cluster(workers):
        found.processes.append(workers)
        yield found.cluster

    monkeypatch.setattr(run, "run_in_threads", counted)
    monkeypatch.setattr(prepared_run, "concurrent_members", lambda rows: 1)
    monkeypatch.setattr(dask_blocks, "local_cluster", cluster)
    monkeypatch.setattr(dask_blocks, "_wait_for_tasks", lambda client, tasks: list(tasks))
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    return found


@pytest.mark.thinned(26)
@pytest.mark.parametrize(("name", "given", "way"), CALLS)
def test_arguments_have_their_effects_in_pairs(case, capsys, name, given, way):
    """Effects are detected of the given arguments, and of no others."""
    entry, number, names = ENTRIES[name], CALLS.index((name, given, way)), set(given.split(" and "))
    case.way = way
    single = names & {"accuracy", "inputs"}
    worlds = [world for world in WORLDS if len(WORLDS[world].systems) == 1 or not single]
    case.name = worlds[number % len(worlds)]
    both = names | {other for each, other in entry.needs if each in names}
    case.given = {each: entry.arguments[each].value(case) for each in sorted(both)}
    barred = [each for each in names if entry.arguments[each].seen is None]
    if barred or names in entry.refused:
        with pytest.raises((TypeError, ValueError)) as raised:
            entry.call(case)
        assert all(each in str(raised.value) for each in names) or any(each in str(raised.value) for each in barred)
        return
    found = entry.call(case)
    case.printed = capsys.readouterr().err
    assert np.abs(found.x - case.motion(found.t, "inputs" in both)).max() < NEAR
    assert {each for each, argument in entry.arguments.items() if argument.seen and argument.seen(case, found)} == both


@pytest.mark.parametrize("name", ENTRIES)
def test_every_argument_is_covered(name):
    entry = ENTRIES[name]
    taken = {each for function in entry.signatures for each in inspect.signature(function).parameters}
    assert taken - entry.beside == set(entry.arguments) - {"run attitude"}


def test_every_pair_of_arguments_is_covered():
    for name, entry in ENTRIES.items():
        seen = {
            frozenset(pair)
            for own, given, _ in CALLS
            if own == name
            for pair in combinations(sorted(given.split(" and ")), 2)
        }
        assert seen == {frozenset(pair) for pair in combinations(entry.arguments, 2)}
