"""How does the command end when it is told to stop? At once, in one line, with nothing half written left behind.

An exception will not do: Python drops those that are raised while a weak reference is cleared or a module is loaded,
and the run would go on. Only while steps are taken the first one raises `Told`, so that what there is of the run can be
written; the second one ends the process all the same. Nothing is imported here that takes time: an interrupt is heard
from the first line on.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

_SAID = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
_unfinished: list[Callable[[], object]] = []
_raises = False
_told = 0


class Told(KeyboardInterrupt):
    """The process was told to stop, by the signal of a number, while `raising`.

    Attributes
    ----------
    partial : object
        What there is of what was interrupted.
    """

    partial: object = None

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def said(self) -> str:
        """What has happened, in a word."""
        return _SAID[signal.Signals(self.number).name]


class raising:
    """A context in which the first interrupt that `hear` would end the process at raises `Told`."""

    def __enter__(self) -> None:
        global _raises, _told
        _raises, _told = True, 0

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        global _raises
        _raises = False
        if _told and not isinstance(error, Told):
            _leave(_told, None)  # Python has dropped it


def hear() -> None:
    """End the process at an interrupt, with the exit status 128 + number of the signal.

    Signals that whoever started the process has set to be ignored (``nohup``, a job in the background) stay so.

    Examples
    --------
    >>> import subprocess, sys
    >>> code = "from coadjoint.interruption import hear; hear(); import signal; signal.raise_signal(signal.SIGTERM)"
    >>> subprocess.run([sys.executable, "-c", code], capture_output=True).returncode
    143
    """
    for number in _heard():
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _leave)


def ignore() -> None:
    """Hear no interrupt any more: all is done, and the interpreter is about to end.

    While it does so it would be killed without a word, for it takes handlers away first.
    """
    for number in _heard():
        signal.signal(number, signal.SIG_IGN)


def begin(abandon: Callable[[], object]) -> None:
    """Have something done where the process is ended before `end`: the removal of what is half written.

    Examples
    --------
    >>> begin(print)
    >>> end(print)
    """
    _unfinished.append(abandon)


def end(abandon: Callable[[], object]) -> None:
    """Take back a `begin`."""
    _unfinished.remove(abandon)


def _heard() -> list[signal.Signals]:
    return [getattr(signal, name) for name in _SAID if hasattr(signal, name)]


def _leave(number: int, frame: FrameType | None) -> None:
    global _told
    if _raises and not _told:
        _told = number
        raise Told(number)
    ignore()
    for act in (*reversed(_unfinished), sys.stdout.flush):
        try:
            act()
        except Exception:  # whatever it is, the process ends now; the next run removes what is left
            pass
    try:
        # A terminal has shown ^C, or a progress bar, on this line.
        begun = "\n" if os.isatty(2) else ""
        os.write(2, f"{begun}coadjoint: {_SAID[signal.Signals(number).name]}\n".encode())
    except OSError:
        pass
    os._exit(128 + number)
