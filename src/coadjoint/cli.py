"""Entry point of the command ``coadjoint``: exit statuses and one-line error messages.

Exit status: 0, success; 1, a run failed (the solution so far is written, and marked as failed), its result could not be
written, a scheme lacks a declared property (``certify``), or samples differ from a check-case (``checkcase``); 2,
invalid input, explained in one line on standard error; 128 + the number of a signal that ended the process: 130,
interrupted; 143, terminated; 141, broken pipe.

The commands are in `coadjoint.commands`. This module imports nothing expensive, so that interrupts are handled from the
start.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress

from coadjoint.interruption import ignore_signals, install_handlers
from coadjoint.optional_packages import require_packages

STARTED = time.monotonic()
"""Start of the process, to which the times reported by `run` refer."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None, began: float | None = None) -> int:
    """Run the command with `arguments` (default: the command line) and return its exit status, see the module.

    Reported times are counted from `began`, a value of ``time.monotonic()``; by default from this call.
    """
    began = time.monotonic() if began is None else began
    try:
        require_packages("the command coadjoint", "click")
        from coadjoint.commands import perform

        status, message = perform(arguments, began)
    except ImportError as error:
        status, message = 2, f"coadjoint: {error}"
    except KeyboardInterrupt:
        status, message = 130, "coadjoint: interrupted"
    if message:
        _print_error(message)
    return status


def _print_error(sentence: str) -> None:
    """Write to standard error; if that fails, only the exit status remains."""
    with suppress(OSError, ValueError):
        print(sentence, file=sys.stderr, flush=True)


def run() -> None:
    """Run the command and exit the interpreter with its status."""
    install_handlers()
    _open_closed_streams()
    status = main(began=STARTED)
    try:
        sys.stdout.flush()
    except OSError as reason:
        if isinstance(reason, BrokenPipeError):
            status = 141  # 128 + SIGPIPE
        elif status == 0:
            _print_error(f"coadjoint: the standard output cannot be written ({reason.strerror})")
            status = 1
        # The interpreter would try to flush the output again at exit, and report an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    ignore_signals()
    sys.exit(status)


def _open_closed_streams() -> None:
    """Open standard streams that were closed, so that no file of a run gets their descriptors."""
    for number, (name, flags) in enumerate((("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY))):
        if getattr(sys, name) is None:
            os.open(os.devnull, flags)  # gets the lowest free descriptor
            setattr(sys, name, open(number, "w" if number else "r", encoding="utf-8"))
