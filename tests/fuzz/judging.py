"""What may a call or a command end in? A result, or one sentence that the library itself says."""

from __future__ import annotations

import linecache
import traceback
from pathlib import Path

import coadjoint as co
from coadjoint.optional_packages import MissingPackageError

TESTS = Path(__file__).parents[1]
SOURCE = str(Path(co.__file__).parent)
SENTENCES = (ValueError, TypeError, ArithmeticError, co.IntegrationError, MissingPackageError)
INSIDE = (ZeroDivisionError, FloatingPointError)  # of which a user learns nothing
LONGEST = 1000  # characters of a sentence


class TooLong(BaseException):
    """A call is still at work when its time is over; it heard that."""


def wrong_error(error, here):
    """Return what is wrong with an error, or None; `here` says what was called."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    message = str(error)
    shown = f"{type(error).__name__}: {message[:300]!r} ({place})"
    if str(TESTS) in last.filename:  # Python itself refuses the call, or what was made of wild values
        return None
    if isinstance(error, TypeError) and ("unexpected keyword argument" in message or "multiple values for" in message):
        return None
    if isinstance(error, FileNotFoundError | IsADirectoryError) and "file" in here:
        return None
    if not isinstance(error, SENTENCES) or type(error) in INSIDE:
        return shown
    if not (last.filename.startswith(SOURCE) and "raise" in linecache.getline(last.filename, last.lineno)):
        return f"not of the library: {shown}"
    if len(message) > LONGEST or "\n" in message or not message:
        return f"not one sentence: {shown}"
    return None


def wrong_warning(noticed):
    """Return the first warning that is not the library's own, or None."""
    for found in noticed:
        if found.filename.startswith(str(TESTS)):  # in a function that was given
            continue
        if issubclass(found.category, RuntimeWarning) and " encountered in " in str(found.message):
            return f"a warning: {found.message} ({Path(found.filename).name}:{found.lineno})"
    return None
