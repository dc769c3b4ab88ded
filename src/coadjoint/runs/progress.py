"""Progress of a run on the standard error: a bar on a terminal, occasional plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from coadjoint.optional_packages import require_packages
from coadjoint.validation import read_bool

SECONDS_BETWEEN_LINES = 30.0
"""About a thousand lines in an overnight log."""


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
        return
    bar: Any = _Lines(steps, unit)
    if _is_terminal():
        from tqdm import tqdm

        bar = tqdm(total=steps, unit=unit, unit_scale=True)
    try:
        yield bar.update
    finally:
        bar.close()


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


class _Lines:
    """Progress lines for a log, without control characters."""

    def __init__(self, steps: int, unit: str) -> None:
        self._steps, self._unit, self._done, self._printed_at = steps, unit, 0, -1
        self._started_at = self._last = time.monotonic()

    def update(self, count: int) -> None:
        self._done += count
        now = time.monotonic()
        if now - self._last >= SECONDS_BETWEEN_LINES:
            self._last = now
            self._print(now)

    def close(self) -> None:
        if self._printed_at != self._done:
            self._print(time.monotonic())

    def _print(self, now: float) -> None:
        self._printed_at = self._done
        percentage = f" ({100.0 * self._done / self._steps:.0f} %)" if self._steps else ""
        plural = "" if self._steps == 1 else "s"
        try:
            print(
                f"{self._done} of {self._steps} {self._unit}{plural}{percentage} after {now - self._started_at:.3g} s",
                file=sys.stderr,
                flush=True,
            )
        except (OSError, ValueError, AttributeError):
            pass  # The run continues even if the log cannot be written.
