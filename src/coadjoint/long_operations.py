"""Warnings about long operations: in advance if the time can be estimated, otherwise after some seconds."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType, SimpleNamespace

DECORATOR_MODULES = ("contextlib", "functools")
WARNING_SECONDS = 5.0
"""Operations shorter than this (seconds) do not warn."""


class LongWait(UserWarning):
    """Warning that an operation takes longer than some seconds; it continues, and Ctrl-C interrupts it.

    Examples
    --------
    Silence it:

    >>> import warnings
    >>> warnings.simplefilter("ignore", LongWait)
    """


def warn_if_long(what: str, seconds: float, instead: str = "") -> None:
    """Warn if an operation is estimated to take longer than `WARNING_SECONDS`; `instead` is a faster alternative."""
    if seconds > WARNING_SECONDS:
        warn_caller(f"{what} takes about {seconds:.2g} s" + (f"; {instead}" if instead else ""), LongWait)


_current: ContextVar[SimpleNamespace | None] = ContextVar("long_operation", default=None)


@contextmanager
def long_operation(what: str) -> Iterator[None]:
    """Context or decorator of a possibly long operation: after `WARNING_SECONDS` the next `note_progress` warns, once.

    `what` is the name of the function called by the user. Only the outermost context warns.
    """
    if _current.get() is not None:
        yield
        return
    token = _current.set(SimpleNamespace(what=what, started=time.monotonic(), warned=False))
    try:
        yield
    finally:
        _current.reset(token)


def note_progress(computing: str, part: float | None = None) -> None:
    """Warn after `WARNING_SECONDS`; `computing` is the current stage, `part` the completed fraction, if known."""
    current = _current.get()
    if current is None or current.warned:
        return
    spent = time.monotonic() - current.started
    if spent <= WARNING_SECONDS:
        return
    current.warned = True
    left = f", and about {spent * (1.0 / part - 1.0):.2g} s are left" if part else ""
    warn_caller(
        f"{current.what} has taken {spent:.2g} s so far{left}; now it computes {computing}; Ctrl-C ends it", LongWait
    )


def warn_caller(text: str, category: type[Warning]) -> None:
    """Warn at the line that called the library."""
    frame: FrameType | None = sys._getframe()
    level, outermost = 1, 0
    while frame is not None:
        name = frame.f_globals.get("__name__", "").partition(".")[0]
        # Frames of a decorator lie between the library and its caller.
        if name == "coadjoint" or (name in DECORATOR_MODULES and level == outermost + 1):
            outermost = level
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=outermost + 1)
