"""Checks of outcomes: a result, or a refusal in one sentence raised by the library itself."""

from __future__ import annotations

import linecache
import traceback
from pathlib import Path

import coadjoint as co
from coadjoint.optional_packages import MissingPackageError

TESTS = Path(__file__).parents[1]
SOURCE = str(Path(co.__file__).parent)
SENTENCES = (ValueError, TypeError, ArithmeticError, co.IntegrationError, MissingPackageError)
INSIDE = (ZeroDivisionError, FloatingPointError)  # uninformative for users
LONGEST = 1000  # characters of a sentence


class TooLong(BaseException):
    """Raised in a call that exceeds its time limit."""


def wrong_error(error, here):
    """Return a description of an unacceptable error of the call `here`, or None."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    message = str(error)
    shown = f"{type(error).__name__}: {message[:300]!r} ({place})"
    if str(TESTS) in last.filename:  # refused by Python itself, or by a function of the tests
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
    """Return the first floating-point warning outside of the tests, or None."""
    for found in noticed:
        if found.filename.startswith(str(TESTS)):
            continue
        if issubclass(found.category, RuntimeWarning) and " encountered in " in str(found.message):
            return f"a warning: {found.message} ({Path(found.filename).name}:{found.lineno})"
    return None
