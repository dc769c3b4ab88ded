"""Warnings about long operations: in advance if the time can be estimated, otherwise after some seconds."""

from __future__ import annotations

import sys
import time
import warnings
from contextlib import ContextDecorator
from contextvars import ContextVar, Token
from types import FrameType

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


class long_operation(ContextDecorator):
    """Context or decorator of a possibly long operation: after `WARNING_SECONDS` the next `note_progress` warns, once.

    `what` is the name of the function called by the user. Only the outermost context warns.
    """

    def __init__(self, what: str) -> None:
        self.what = what
        self._token: Token[long_operation | None] | None = None

    def _recreate_cm(self) -> long_operation:
        return long_operation(self.what)

    def __enter__(self) -> long_operation:
        if _current.get() is None:
            self.started, self.warned = time.monotonic(), False
            self._token = _current.set(self)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._token is not None:
            _current.reset(self._token)
            self._token = None


_current: ContextVar[long_operation | None] = ContextVar("long_operation", default=None)


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
