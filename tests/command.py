"""The installed command, called in this process."""

from __future__ import annotations

import signal
import sys
from importlib.metadata import entry_points
from typing import NamedTuple

import pytest


class Outcome(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


def command(capsys: pytest.CaptureFixture[str], *arguments: object) -> Outcome:
    """Run `coadjoint` with arguments, as a shell would."""
    (script,) = entry_points(group="console_scripts", name="coadjoint")
    before, sys.argv = sys.argv, ["coadjoint", *map(str, arguments)]
    # The command handles signals, and ignores them at its end, for the rest of its process.
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
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
