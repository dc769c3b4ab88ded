"""The installed command, called in this process."""

from __future__ import annotations

import signal
import sys
from importlib.metadata import entry_points
from typing import NamedTuple

import pytest

HANDLED = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]


class Outcome(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


def command(capsys: pytest.CaptureFixture[str], *arguments: object) -> Outcome:
    """Run `coadjoint` with arguments, as a shell would."""
    (script,) = entry_points(group="console_scripts", name="coadjoint")
    before, sys.argv = sys.argv, ["coadjoint", *map(str, arguments)]
    # At its end the command ignores signals, which child processes would inherit.
    handlers = {number: signal.getsignal(number) for number in HANDLED}
    capsys.readouterr()
    try:
        status = script.load()()
    except SystemExit as ended:
        status = ended.code
    finally:
        sys.argv = before
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return Outcome(int(status or 0), *capsys.readouterr())
