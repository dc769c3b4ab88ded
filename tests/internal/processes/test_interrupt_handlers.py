"""Signal handlers: order of actions and exit status of interrupted processes."""

import signal

import pytest

from coadjoint import interruption
from core_only import run_python

BEGIN = """
import os, signal, sys
from coadjoint.interruption import Interrupted, cleanups, install_handlers, raise_on_interrupt
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
install_handlers()
class Dropping:
    def __init__(self, number):
        self.number = number
    def __del__(self):
        signal.raise_signal(self.number)  # an exception raised here is dropped
sys.unraisablehook = lambda dropped: print("dropped", type(dropped.exc_value).__name__)
"""


def child(code):
    """Return exit status, output and errors of a process with handlers."""
    done = run_python(BEGIN + code)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("name", "message"), [("SIGINT", "interrupted"), ("SIGTERM", "terminated"), ("SIGHUP", "hung up")]
)
def test_dropped_interrupt_ends_the_process(name, message):
    """At the end of the steps: the run is not continued, whatever is raised or returned there."""
    status = 128 + getattr(signal, name)
    for inside in ("pass", "raise ValueError"):
        code = f"""
with raise_on_interrupt():
    Dropping(signal.{name})
    print("continued")
    {inside}
print("not reached")
"""
        assert child(code) == (status, "dropped Interrupted\ncontinued\n", f"coadjoint: {message}\n")


def test_second_interrupt_ends_the_process():
    code = """
for number in (signal.SIGTERM, signal.SIGINT):  # a second context raises as well
    try:
        with raise_on_interrupt():
            signal.raise_signal(number)
    except Interrupted as error:
        print(error.number == number, error.description, error.partial)
with raise_on_interrupt():
    print("begun")
    try:
        signal.raise_signal(signal.SIGTERM)
    except Interrupted:
        signal.raise_signal(signal.SIGHUP)
    print("not reached")
"""
    message = "True terminated None\nTrue interrupted None\nbegun\n"
    assert child(code) == (128 + signal.SIGHUP, message, "coadjoint: hung up\n")


def test_interrupt_after_a_context_ends_the_process():
    code = (
        "with raise_on_interrupt():\n    pass\nprint('behind')\nsignal.raise_signal(signal.SIGTERM)\nprint('reached')"
    )
    assert child(code) == (128 + signal.SIGTERM, "behind\n", "coadjoint: terminated\n")


def test_cleanups_run_in_reverse_despite_errors():
    """Signals are ignored meanwhile; then the output is flushed."""
    code = """
def act(name, error=None):
    def acting():
        os.kill(os.getpid(), signal.SIGINT)
        print(name)
        if error is not None:
            raise error
    cleanups.append(acting)
act("first"), act("second", ValueError()), act("third", OSError()), act("fourth"), cleanups.pop(), act("fifth")
signal.raise_signal(signal.SIGTERM)
"""
    assert child(code) == (128 + signal.SIGTERM, "fifth\nthird\nsecond\nfirst\n", "coadjoint: terminated\n")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_ignored_signals_stay_ignored(name):
    code = f"""
signal.signal(signal.{name}, signal.SIG_IGN)
install_handlers()
signal.raise_signal(signal.{name})
print("alive")
others = {{signal.SIGINT, signal.SIGTERM, signal.SIGHUP}} - {{signal.{name}}}
signal.raise_signal(min(others))
"""
    first = min({signal.SIGINT, signal.SIGTERM, signal.SIGHUP} - {getattr(signal, name)})
    message = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}[first]
    assert child(code) == (128 + first, "alive\n", f"coadjoint: {message}\n")


@pytest.fixture
def received():
    """Yield the list of signals that a handler of this process receives."""
    found = []
    before = signal.signal(signal.SIGINT, lambda number, frame: found.append(number))
    handler = signal.getsignal(signal.SIGINT)
    yield found
    assert signal.signal(signal.SIGINT, before) is handler, "the handler is restored"


def test_deferred_signals_arrive_after_the_context(received):
    with interruption.deferred():
        signal.raise_signal(signal.SIGINT)
        with interruption.deferred():
            signal.raise_signal(signal.SIGINT)
        assert received == []
    assert received == [signal.SIGINT]


def test_error_in_a_deferred_context(received):
    with pytest.raises(ValueError, match="inside"), interruption.deferred():
        signal.raise_signal(signal.SIGINT)
        raise ValueError("inside")
    assert received == [signal.SIGINT]
