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
        print(said, file=sys.stderr)
    return status


def run() -> None:
    """Run the command and leave the interpreter with its exit status."""
    hear()
    status = main()
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        from coadjoint.commands import UNREAD

        status = UNREAD
        _forget_output()
    except OSError as reason:
        print(f"coadjoint: the standard output cannot be written ({reason.strerror})", file=sys.stderr)
        status = status or 1
        _forget_output()
    ignore()
    sys.exit(status)


def _forget_output() -> None:
    """Drop what is still to be printed. The interpreter would try again when it ends, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
