"""Handlers of signals: what a process that is told to stop does, in which order, and with which exit status."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import coadjoint
from coadjoint import interruption

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(coadjoint.__file__).parents[1])}
BEGIN = """
import os, signal, sys
from coadjoint.interruption import Interrupted, deferred, ignore_signals, install_handlers
from coadjoint.interruption import raise_on_interrupt, register_cleanup, unregister_cleanup
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
    """Return exit status, output and errors of a process that has handlers."""
    done = subprocess.run([sys.executable, "-c", BEGIN + code], capture_output=True, text=True, env=ENVIRONMENT)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("name", "message"), [("SIGINT", "interrupted"), ("SIGTERM", "terminated"), ("SIGHUP", "hung up")]
)
def test_an_interrupt_that_python_drops_ends_the_process(name, message):
    """Where the steps of a run end: whatever else is raised or returned there, the run is not continued."""
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


def test_the_first_interrupt_raises_and_the_second_ends_the_process():
    code = """
for number in (signal.SIGTERM, signal.SIGINT):  # a second context raises as well
    try:
        with raise_on_interrupt():
            signal.raise_signal(number)
    except Interrupted as told:
        print(told.number == number, told.description, told.partial)
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


def test_behind_a_context_an_interrupt_ends_the_process():
    code = (
        "with raise_on_interrupt():\n    pass\nprint('behind')\nsignal.raise_signal(signal.SIGTERM)\nprint('reached')"
    )
    assert child(code) == (128 + signal.SIGTERM, "behind\n", "coadjoint: terminated\n")


def test_cleanups_run_backward_whatever_they_raise():
    """Each of those that are registered, with signals ignored meanwhile; then what was printed is flushed."""
    code = """
def act(name, error=None):
    def acting():
        os.kill(os.getpid(), signal.SIGINT)
        print(name)
        if error is not None:
            raise error
    register_cleanup(acting)
    return acting
act("first"), act("second", ValueError()), act("third", OSError()), unregister_cleanup(act("fourth")), act("fifth")
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
def heard():
    """Signals that handlers of this process have received."""
    found = []
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, lambda number, frame: found.append(number)) for number in numbers]
    handlers = [signal.getsignal(number) for number in numbers]
    yield found
    assert [signal.getsignal(number) for number in numbers] == handlers, "the handlers are restored"
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def test_signals_wait_for_the_end_of_a_context(heard):
    with interruption.deferred():
        signal.raise_signal(signal.SIGHUP)
        with interruption.deferred():
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGHUP)
        assert heard == []
    assert sorted(heard) == sorted([signal.SIGHUP, signal.SIGTERM])


def test_an_error_in_a_context_is_raised_and_signals_are_heard(heard):
    with pytest.raises(ValueError, match="inside"), interruption.deferred():
        signal.raise_signal(signal.SIGTERM)
        raise ValueError("inside")
    assert heard == [signal.SIGTERM]


def test_a_handler_that_raises_when_a_context_begins(heard, monkeypatch):
    """The signal comes while handlers are exchanged: those exchanged before are restored."""
    exchanged, real = [], signal.signal

    def exchange(number, handler):
        exchanged.append(number)
        if len(exchanged) == 2:
            raise KeyboardInterrupt
        return real(number, handler)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(signal, "signal", exchange)
        with interruption.deferred():
            raise AssertionError
    signal.raise_signal(signal.SIGTERM)
    assert heard == [signal.SIGTERM]


def test_what_is_registered_is_unregistered_once():
    before = list(interruption._cleanups)
    for act in (time.sleep, print, time.sleep):
        interruption.register_cleanup(act)
    interruption.unregister_cleanup(time.sleep)
    interruption.unregister_cleanup(print)
    assert interruption._cleanups == [*before, time.sleep]
    interruption.unregister_cleanup(time.sleep)
    assert interruption._cleanups == before
