"""Interrupts (SIGINT, SIGTERM, SIGHUP, SIGBREAK): how the command ends, and what they wait for.

The command ends at once, with one line, and removes incomplete files. An exception would not suffice: Python drops
those raised while a weak reference is cleared, and the run would continue. Only during the steps of a run the first
signal raises `Interrupted`, so that the solution so far is written; the second one ends the process.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from threading import current_thread, main_thread

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

# SIGBREAK is Ctrl-Break on Windows, which has no SIGHUP.
_DESCRIPTIONS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up", "SIGBREAK": "interrupted"}
_HANDLED = {getattr(signal, name): text for name, text in _DESCRIPTIONS.items() if hasattr(signal, name)}
cleanups: list[Callable[[], object]] = []
"""Removals of incomplete files, for a signal that ends the process."""
_raise_enabled = False
_signal_received = 0


class Interrupted(KeyboardInterrupt):
    """The process received an interrupt signal inside `raise_on_interrupt`; `partial` holds the result so far."""

    partial: object = None

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number, self.description = number, _HANDLED[number]


@contextmanager
def raise_on_interrupt() -> Iterator[None]:
    """Context in which the first interrupt raises `Interrupted` instead of ending the process."""
    global _raise_enabled, _signal_received
    _raise_enabled, _signal_received = True, 0
    try:
        yield
    except Interrupted:
        _raise_enabled, _signal_received = False, 0
        raise
    finally:
        _raise_enabled = False
        if _signal_received:
            _exit_process(_signal_received, None)  # Python dropped the exception


@contextmanager
def deferred() -> Iterator[None]:
    """Context at whose end SIGINT is handled, for code of others that an exception inside would break for good."""
    handler, received = signal.getsignal(signal.SIGINT), set[int]()
    if current_thread() is not main_thread() or not callable(handler):
        yield
        return
    signal.signal(signal.SIGINT, lambda number, frame: received.add(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        for number in received:
            handler(number, None)


def install_handlers() -> None:
    """Let interrupts end the process with exit status 128 + number; those that its parent ignores stay ignored."""
    for number in [one for one in _HANDLED if signal.getsignal(one) not in (signal.SIG_IGN, None)]:
        signal.signal(number, _exit_process)


def ignore_signals() -> None:
    """Ignore interrupts from now on: at exit Python removes handlers, and a signal would kill it without a message."""
    for number in _HANDLED:
        signal.signal(number, signal.SIG_IGN)


def _exit_process(number: int, frame: FrameType | None) -> None:
    global _signal_received
    if _raise_enabled and not _signal_received:
        _signal_received = number
        raise Interrupted(number)
    ignore_signals()
    for action in (*reversed(cleanups), sys.stdout.flush):
        try:
            action()
        except Exception:  # the process ends in any case; the next run removes remaining files
            pass
    try:
        prefix = "\n" if os.isatty(2) else ""  # after ^C or a progress bar
        os.write(2, f"{prefix}coadjoint: {_HANDLED[number]}\n".encode())
    except OSError:
        pass
    os._exit(128 + number)
