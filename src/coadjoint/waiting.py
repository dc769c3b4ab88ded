"""Does it take long? Whoever waits is told: beforehand where the time can be estimated, else after some seconds."""

from __future__ import annotations

import sys
import time
import warnings
from contextlib import ContextDecorator
from contextvars import ContextVar, Token
from types import FrameType

WITHIN = ("contextlib", "functools")
LONG = 5.0
"""Seconds of which nobody is told."""


class LongWait(UserWarning):
    """Something takes longer than some seconds; it goes on, and Ctrl-C ends it.

    Examples
    --------
    Say nothing of it:

    >>> import warnings
    >>> warnings.simplefilter("ignore", LongWait)
    """


def tell(what: str, seconds: float, instead: str = "") -> None:
    """Warn beforehand of what takes longer than `LONG`.

    Parameters
    ----------
    what : str
        What is done, the subject of the message.
    seconds : float
        How long it takes, estimated.
    instead : str, optional
        What would be faster.

    Examples
    --------
    >>> tell("to make this ready", 0.1)
    """
    if seconds > LONG:
        _warn(f"{what} takes about {seconds:.2g} s" + (f"; {instead}" if instead else ""))


class waiting(ContextDecorator):
    """A context of work that may be long, or the decorator of a function that does it.

    After `LONG` seconds the next `at` inside warns, once.

    Within another one it says nothing: the outer one speaks for both.

    Parameters
    ----------
    what : str
        What is done, the subject of the message: the name of the function that the user has called.

    Examples
    --------
    >>> with waiting("certify"):
    ...     at("the long run", 0.5)
    """

    def __init__(self, what: str) -> None:
        self.what = what
        self._token: Token[waiting | None] | None = None

    def _recreate_cm(self) -> waiting:
        return waiting(self.what)

    def __enter__(self) -> waiting:
        if _current.get() is None:
            self.begun, self.said = time.monotonic(), False
            self._token = _current.set(self)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._token is not None:
            _current.reset(self._token)
            self._token = None


_current: ContextVar[waiting | None] = ContextVar("waiting", default=None)


def at(doing: str, part: float | None = None) -> None:
    """Say where the work is, for whoever waits longer than `LONG`.

    Parameters
    ----------
    doing : str
        What begins now.
    part : float, optional
        How much of the whole is done, between 0 and 1, where that is known.
    """
    current = _current.get()
    if current is None or current.said:
        return
    spent = time.monotonic() - current.begun
    if spent <= LONG:
        return
    current.said = True
    left = f", and about {spent * (1.0 / part - 1.0):.2g} s are left" if part else ""
    _warn(f"{current.what} has taken {spent:.2g} s so far{left}; now it computes {doing}; Ctrl-C ends it")


def _warn(text: str) -> None:
    """Warn at the line that called the library."""
    frame: FrameType | None = sys._getframe()
    level, outermost = 1, 0
    while frame is not None:
        name = frame.f_globals.get("__name__", "").partition(".")[0]
        # A decorator stands between the library and whoever called it.
        if name == "coadjoint" or (name in WITHIN and level == outermost + 1):
            outermost = level
        frame, level = frame.f_back, level + 1
    warnings.warn(text, LongWait, stacklevel=outermost + 1)
