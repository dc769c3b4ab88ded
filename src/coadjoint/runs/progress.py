"""How far has a run come? A bar on a terminal; where the standard error goes to a file, a plain line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

SECONDS_BETWEEN_LINES = 30.0
"""A log of a night has about a thousand lines."""


class progress_bar:
    """A progress bar over the steps, or over what else is counted; or nothing.

    Where the standard error is no terminal nothing is drawn over what was drawn before: a line is printed every
    `SECONDS_BETWEEN_LINES`, and one at the end.

    Parameters
    ----------
    steps : int
        How many there are.
    shown : bool
        Whether anything is shown.
    unit : str
        What is counted.

    Examples
    --------
    >>> with progress_bar(10, False) as done:
    ...     done(10)
    """

    def __init__(self, steps: int, shown: bool, unit: str = "step") -> None:
        self._bar: Any = None
        if shown and _is_terminal():
            from tqdm import tqdm

            self._bar = tqdm(total=steps, unit=unit, unit_scale=True)
        elif shown:
            self._bar = _Lines(steps, unit)

    def __enter__(self) -> Callable[[int], None]:
        return (lambda count: None) if self._bar is None else (lambda count: self._bar.update(count))

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()


def _is_terminal() -> bool:
    """Say whether what is printed can be drawn over: on a terminal, or below the cell of a notebook."""
    if type(sys.stderr).__module__.partition(".")[0] == "ipykernel":
        return True
    try:
        return bool(sys.stderr.isatty())
    except (AttributeError, ValueError):  # there is none, or it is closed
        return False


class _Lines:
    """Lines for a log, without control characters."""

    def __init__(self, steps: int, unit: str) -> None:
        self._steps, self._unit, self._done, self._told = steps, unit, 0, -1
        self._begun = self._last = time.monotonic()

    def update(self, count: int) -> None:
        self._done += count
        now = time.monotonic()
        if now - self._last >= SECONDS_BETWEEN_LINES:
            self._last = now
            self._tell(now)

    def close(self) -> None:
        if self._told != self._done:
            self._tell(time.monotonic())

    def _tell(self, now: float) -> None:
        self._told = self._done
        part = f" ({100.0 * self._done / self._steps:.0f} %)" if self._steps else ""
        many = "" if self._steps == 1 else "s"
        try:
            print(
                f"{self._done} of {self._steps} {self._unit}{many}{part} after {now - self._begun:.3g} s",
                file=sys.stderr,
                flush=True,
            )
        except (OSError, ValueError, AttributeError):
            pass  # A log that cannot be written is no reason to lose the run.
