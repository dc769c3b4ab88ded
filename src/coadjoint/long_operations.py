"""Long operations: warnings, in advance if the time can be estimated, else after some seconds, and progress bars."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from types import FrameType, SimpleNamespace
from typing import Any

from coadjoint.optional_packages import require_packages
from coadjoint.validation import read_bool

DECORATOR_MODULES = ("contextlib", "functools")
WARNING_SECONDS = 5.0
"""Operations shorter than this (seconds) do not warn."""
SECONDS_BETWEEN_LINES = 30.0
"""About a thousand lines in an overnight log."""


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


_silent: ContextVar[bool] = ContextVar("without_warnings", default=False)


@contextmanager
def without_warnings() -> Iterator[None]:
    """Context of values that the user did not give: `warn_caller` is silent, in this thread only."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


def warn_caller(text: str, category: type[Warning]) -> None:
    """Warn at the line that called the library."""
    if _silent.get():
        return
    frame: FrameType | None = sys._getframe()
    level, outermost = 1, 0
    while frame is not None:
        name = frame.f_globals.get("__name__", "").partition(".")[0]
        # Frames of a decorator lie between the library and its caller.
        if name == "coadjoint" or (name in DECORATOR_MODULES and level == outermost + 1):
            outermost = level
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=outermost + 1)


def read_progress(progress: Any) -> bool:
    """Validate `progress`; raise if a progress bar cannot be shown."""
    shown = read_bool(progress, "progress")
    if shown:
        require_packages("progress=True", "tqdm")
    return shown


@contextmanager
def progress_bar(steps: int, shown: bool, unit: str = "step") -> Iterator[Callable[[int], Any]]:
    """Show a progress bar, or printed lines without a terminal; the value of the context takes each increment."""
    if not shown:
        yield lambda count: None
    elif _is_terminal():
        from tqdm import tqdm

        with tqdm(total=steps, unit=unit, unit_scale=True) as bar:
            yield bar.update
    else:
        with _progress_lines(steps, unit) as update:
            yield update


def _is_terminal() -> bool:
    """Whether printed output can be overwritten: on a terminal, or below a notebook cell."""
    if type(sys.stderr).__module__.partition(".")[0] == "ipykernel":
        return True
    try:
        return bool(sys.stderr.isatty())
    except (AttributeError, ValueError):  # no standard error, or closed
        return False


def paced(taken: int, seconds: float, interval: float, most: int) -> int:
    """Return how many steps take about an interval (s), from 1 to `most`, if `taken` have taken so many seconds."""
    # The clock may not have advanced.
    return max(1, min(int(taken / max(seconds, 1e-6) * interval), most))


@contextmanager
def _progress_lines(steps: int, unit: str) -> Iterator[Callable[[int], None]]:
    """Print progress lines for a log, without control characters; the value of the context takes each increment."""
    done, printed_at = 0, -1
    started_at = last = time.monotonic()

    def print_line(now: float) -> None:
        nonlocal printed_at
        printed_at = done
        percentage = f" ({100.0 * done / steps:.0f} %)" if steps else ""
        text = f"{done} of {steps} {unit}{'' if steps == 1 else 's'}{percentage} after {now - started_at:.3g} s"
        # The run continues even if the log cannot be written.
        with suppress(OSError, ValueError, AttributeError):
            print(text, file=sys.stderr, flush=True)

    def update(count: int) -> None:
        nonlocal done, last
        done += count
        now = time.monotonic()
        if now - last >= SECONDS_BETWEEN_LINES:
            last = now
            print_line(now)

    try:
        yield update
    finally:
        if printed_at != done:
            print_line(time.monotonic())
