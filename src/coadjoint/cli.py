"""The entry of the command ``coadjoint``: exit statuses, and one line for whatever is wrong.

Exit status: 0, all is well; 1, a run failed while running (what it had is written, and says so), its result could not
be written, or a scheme does not keep what it declares (``certify``); 2, wrong input, one line on the standard error
says what would be right; 128 + the number of a signal that ended it: 130, interrupted; 143, terminated; 141, nobody
reads its output any more.

The commands are in `coadjoint.commands`. Nothing is imported here that takes time, so that an interrupt is heard from
the start.
"""

from __future__ import annotations

import os
import sys

from coadjoint.extras import need
from coadjoint.interruption import hear, ignore

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the command line by default.

    Returns
    -------
    int
        0, 1, 2 or 130, as the module says.

    Examples
    --------
    >>> main(["--version"])
    coadjoint 0.1.0
    0
    """
    try:
        need("the command coadjoint", "click")
        from coadjoint.commands import perform

        status, said = perform(arguments)
    except ImportError as error:
        status, said = 2, f"coadjoint: {error}"
    except KeyboardInterrupt:
        status, said = 130, "coadjoint: interrupted"
    if said:
        _complain(said)
    return status


def _complain(sentence: str) -> None:
    """Write to the standard error; where that is impossible, the exit status alone remains."""
    try:
        print(sentence, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        pass


def run() -> None:
    """Run the command and leave the interpreter with its exit status."""
    hear()
    _open_closed_streams()
    status = main()
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        from coadjoint.commands import UNREAD

        status = UNREAD
        _forget_output()
    except OSError as reason:
        if status == 0:
            _complain(f"coadjoint: the standard output cannot be written ({reason.strerror})")
        status = status or 1
        _forget_output()
    ignore()
    sys.exit(status)


def _open_closed_streams() -> None:
    """Open the standard streams that were closed, so that no file of a run gets their numbers.

    What is written to a standard output that was closed fails, as for any output that cannot be written.
    """
    for number, name, flags in ((0, "stdin", os.O_RDONLY), (1, "stdout", os.O_RDONLY), (2, "stderr", os.O_WRONLY)):
        if getattr(sys, name) is not None:
            continue
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, flags)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        setattr(sys, name, open(number, "w" if number else "r", encoding="utf-8"))


def _forget_output() -> None:
    """Drop what is still to be printed. The interpreter would try again when it ends, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
