"""Warnings of long operations: estimates beforehand, remaining times, nested and parallel operations, the command."""

import contextlib
import functools
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from coadjoint.long_operations import WARNING_SECONDS, LongWait, long_operation, note_progress, warn_if_long
from core_only import run_python


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test advances."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def warnings_of(action):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        action()
    assert all(one.category is LongWait for one in found)
    return [str(one.message) for one in found]


def test_long_estimates_warn_beforehand():
    assert warnings_of(lambda: warn_if_long("to prepare it", WARNING_SECONDS)) == []
    (found,) = warnings_of(lambda: warn_if_long("to prepare it", 42.0, "take rk4"))
    assert found == "to prepare it takes about 42 s; take rk4"


@pytest.mark.parametrize("part", [None, 0.0, 0.25, 1.0])
def test_long_work_warns_once_and_the_remaining_time_follows_from_the_part(clock, part):
    def work():
        with long_operation("certify"):
            for now in (2.0, WARNING_SECONDS, 8.0, 60.0):
                clock[0] = now
                note_progress("the long run", part)
        clock[0] = 200.0
        note_progress("nothing")

    left = {0.25: ", and about 24 s are left", 1.0: ", and about 0 s are left"}.get(part, "")
    assert warnings_of(work) == [f"certify has taken 8 s so far{left}; now it computes the long run; Ctrl-C ends it"]


def test_only_the_outermost_operation_warns_and_failed_ones_end(clock):
    def work():
        with long_operation("certify"):
            clock[0] += 4.0
            for _ in range(2):
                with contextlib.suppress(LookupError), long_operation("choose"):
                    clock[0] += 4.0
                    note_progress("a pilot run")
                    raise LookupError
        clock[0] += 100.0
        note_progress("nothing")

    assert warnings_of(work) == ["certify has taken 8 s so far; now it computes a pilot run; Ctrl-C ends it"]


def test_calls_of_one_function_are_independent(clock):
    """Nested, in sequence, and in two threads of which the first to begin is the first to end."""
    entered = [threading.Event(), threading.Event()]

    @long_operation("choose")
    def work(depth):
        if depth:
            work(depth - 1)
            clock[0] += 6.0
            note_progress("a pilot run")

    for _ in range(2):
        assert [one.partition(" so far")[0] for one in warnings_of(lambda: work(1))] == ["choose has taken 6 s"]

    @long_operation("choose")
    def beside(number):
        entered[number].set()
        assert entered[1 - number].wait(timeout=60)
        if number:
            assert first.exception(timeout=60) is None

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(beside, 0)
        assert entered[0].wait(timeout=60)
        second = pool.submit(beside, 1)
        assert first.exception(timeout=60) is None and second.exception(timeout=60) is None


def test_the_caller_is_found_through_library_decorators_only():
    """A decorated function of the caller counts as the caller."""

    @functools.wraps(warn_if_long)
    def wrapped(*args):
        return warn_if_long(*args)

    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        wrapped("a run", 42.0)
    (one,) = found
    line = Path(__file__).read_text().splitlines()[one.lineno - 1]
    assert one.filename == __file__ and "return warn_if_long(*args)" in line


def test_the_command_prints_the_warning_immediately():
    """Other warnings are printed at the end."""
    code = """
import sys, warnings
from coadjoint import commands, long_operations
def performed(arguments, began):
    warnings.warn('of another kind', UserWarning)
    long_operations.warn_if_long('to prepare it', 42.0)
    print('ready', file=sys.stderr)
    return 0, ''
commands._invoke = performed
from coadjoint.cli import main
sys.exit(main(['run', 'x.toml']))
"""
    done = run_python(code)
    assert (done.returncode, done.stdout) == (0, "")
    told = [line.removeprefix("coadjoint: warning: ") for line in done.stderr.splitlines()]
    assert told == ["to prepare it takes about 42 s", "ready", "of another kind"]
