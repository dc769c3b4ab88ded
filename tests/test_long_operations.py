"""Warnings of long operations: estimates beforehand, otherwise one warning after some seconds."""

import contextlib
import functools
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint import long_operations
from coadjoint.algebra.invariants import casimirs
from coadjoint.long_operations import LongWait, note_progress, warn_if_long
from core_only import run_python


@pytest.fixture
def clock(monkeypatch):
    """A clock that the test advances."""
    now = [0.0]
    monkeypatch.setattr(long_operations.time, "monotonic", lambda: now[0])
    return now


def warnings_of(action):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        action()
    assert all(one.category is LongWait for one in found)
    return [str(one.message) for one in found]


def test_long_estimates_warn_beforehand():
    assert warnings_of(lambda: warn_if_long("to prepare it", long_operations.WARNING_SECONDS)) == []
    assert warnings_of(lambda: warn_if_long("to prepare it", 42.0, "take rk4")) == [
        "to prepare it takes about 42 s; take rk4"
    ]


def test_long_work_warns_once_with_progress(clock):
    def work():
        with long_operations.long_operation("certify"):
            for now in (2.0, long_operations.WARNING_SECONDS, 6.0, 60.0):
                clock[0] = now
                note_progress("the long run", now / 24.0)

    assert warnings_of(work) == [
        "certify has taken 6 s so far, and about 18 s are left; now it computes the long run; Ctrl-C ends it"
    ]


def test_only_the_outermost_operation_warns(clock):
    def work():
        with long_operations.long_operation("certify"):
            clock[0] = 4.0
            for _ in range(2):
                with long_operations.long_operation("choose"):
                    clock[0] += 4.0
                    note_progress("a pilot run")

    assert warnings_of(work) == ["certify has taken 8 s so far; now it computes a pilot run; Ctrl-C ends it"]


def test_calls_of_one_function_are_independent(clock):
    """Nested, in sequence, and in two threads of which the first to begin is the first to end."""
    entered = [threading.Event(), threading.Event()]

    @long_operations.long_operation("choose")
    def work(depth):
        if depth:
            work(depth - 1)
            clock[0] += 6.0
            note_progress("a pilot run")

    for _ in range(2):
        assert [one.partition(" so far")[0] for one in warnings_of(lambda: work(1))] == ["choose has taken 6 s"]

    @long_operations.long_operation("choose")
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


def test_no_warning_outside_of_operations(clock):
    def work():
        with long_operations.long_operation("certify"):
            pass
        clock[0] = 100.0
        note_progress("nothing")

    assert warnings_of(work) == []


def test_failed_operations_end(clock):
    def work():
        with pytest.raises(ValueError, match="wrong"), long_operations.long_operation("certify"):
            raise ValueError("wrong")
        clock[0] = 100.0
        note_progress("nothing")

    assert warnings_of(work) == []


def test_warning_names_the_line_of_the_caller(clock, monkeypatch):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        warn_if_long("to prepare it", 42.0)
        clock[0] = 0.0
        with monkeypatch.context() as patch:
            patch.setattr(casimirs, "generic_rank", lambda *args: (clock.append(clock.pop() + 9.0), 0)[1])
            co.algebras.su(2).casimirs(3)
    assert [one.filename for one in found] == [__file__, __file__]


def test_command_prints_the_warning_immediately():
    """Other warnings are printed at the end."""
    code = "\n".join(
        [
            "import sys, warnings",
            "from coadjoint import commands, long_operations",
            "def performed(arguments, began):",
            "    warnings.warn('of another kind', UserWarning)",
            "    long_operations.warn_if_long('to prepare it', 42.0)",
            "    print('ready', file=sys.stderr)",
            "    return 0, ''",
            "commands._invoke = performed",
            "from coadjoint.cli import main",
            "sys.exit(main(['run', 'x.toml']))",
        ]
    )
    done = run_python(code)
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr.splitlines() == [
        "coadjoint: warning: to prepare it takes about 42 s",
        "ready",
        "coadjoint: warning: of another kind",
    ]


def slow_down(clock, monkeypatch, module, name):
    """Let every call of a function take nine seconds."""
    plain = getattr(module, name)

    def called(*args, **kwargs):
        clock[0] += 9.0
        return plain(*args, **kwargs)

    monkeypatch.setattr(module, name, called)


BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, 1.0, 0.2)


@pytest.mark.parametrize(
    "name", ["certify", "choose", "integrate", "prepare", "lyapunov", "Splitting.tuned", "tangent"]
)
def test_long_calls_warn_by_their_name(name, clock, monkeypatch):
    from coadjoint.analysis.checks import subject
    from coadjoint.choosing import pilot
    from coadjoint.methods.numerics import taylor_tangents
    from coadjoint.program.parts import decompose
    from coadjoint.runs import tangent_stretching as stretching

    modules = {"certify": subject, "choose": pilot, "lyapunov": stretching, "tangent": taylor_tangents}
    module = modules.get(name, decompose)
    slow_down(clock, monkeypatch, module, "note_progress")
    system = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 2.0, 3.0, 4.0, 5.0, 7.0]))
    x0 = [0.3, 1.0, 0.2, 0.1, -0.4, 0.5]
    calls = {
        "certify": lambda: co.certify(BODY, co.Splitting(), X0, 0.1, steps=8),
        "choose": lambda: co.choose(BODY, X0, (0, 1), 1e-6),
        "integrate": lambda: co.integrate(system, x0, (0, 1), 0.1, co.Splitting()),
        "prepare": lambda: co.prepare(system, co.Splitting(), 0.1),
        "lyapunov": lambda: co.lyapunov(BODY, X0, (0, 1), 0.1),
        "Splitting.tuned": lambda: co.Splitting.tuned(system, x0),
        "tangent": lambda: co.stepper(BODY, co.Taylor(4), 0.1).tangent(X0),
    }
    (found,) = warnings_of(calls[name])
    assert found.startswith(f"{name} has taken ") and found.endswith("; Ctrl-C ends it")


@pytest.mark.parametrize("part", [None, 0.0, 0.25, 1.0])
def test_remaining_time_follows_from_the_part(clock, part):
    """There is no estimate at the start; remaining times below the limit are omitted."""

    def work():
        with long_operations.long_operation("certify"):
            for now in (0.0, long_operations.WARNING_SECONDS, 8.0):
                clock[0] = now
                note_progress("the long run", part)

    left = {0.25: ", and about 24 s are left", 1.0: ", and about 0 s are left"}.get(part, "")
    assert warnings_of(work) == [f"certify has taken 8 s so far{left}; now it computes the long run; Ctrl-C ends it"]


def test_caller_is_found_through_library_decorators_only():
    """A decorated function of the caller counts as the caller."""

    @contextlib.contextmanager
    def around():
        yield

    @functools.wraps(warn_if_long)
    def wrapped(*args):
        return warn_if_long(*args)

    @around()
    def decorated():
        wrapped("a run", 42.0)

    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        decorated()
    (one,) = found
    assert (
        one.filename == __file__
        and "return warn_if_long(*args)" in Path(__file__).read_text().splitlines()[one.lineno - 1]
    )
