"""Outcomes of calls: a result, or a refusal in one sentence raised by the library itself."""

from __future__ import annotations

import dis
import traceback
from pathlib import Path

import coadjoint as co

TESTS = str(Path(__file__).parents[1])
SENTENCES = (ValueError, TypeError, ArithmeticError, ImportError, co.IntegrationError)
INSIDE = (ZeroDivisionError, FloatingPointError)  # uninformative for users
LONGEST = 1000  # characters of a sentence


class TooLong(BaseException):
    """Raised in a call that exceeds its time limit."""


def wrong_error(error, here=""):
    """Return a description of an unacceptable error of the call `here`, or None."""
    last = error.__traceback__
    while last.tb_next is not None:
        last = last.tb_next
    place = traceback.extract_tb(error.__traceback__)[-1]
    message = str(error)
    shown = f"{type(error).__name__}: {message[:300]!r} ({Path(place.filename).name}:{place.lineno})"
    if TESTS in place.filename:  # refused by Python itself, or by a function of the tests
        return None
    if isinstance(error, OSError) and ("file" in here or "path" in here):  # of the operating system, which names it
        return None
    if isinstance(error, MemoryError):  # of Python or NumPy, which name the size
        return None
    if not isinstance(error, SENTENCES) or type(error) in INSIDE:
        return shown
    module = last.tb_frame.f_globals.get("__name__", "")
    raised = next(step.opname for step in dis.get_instructions(last.tb_frame.f_code) if step.offset == last.tb_lasti)
    if module.partition(".")[0] != "coadjoint" or not raised.startswith(("RAISE", "RERAISE")):
        return f"not of the library: {shown}"
    if len(message) > LONGEST or "\n" in message or not message:
        return f"not one sentence: {shown}"
    return None


def wrong_warning(noticed):
    """Return the first floating-point warning outside of the tests, or None."""
    for found in noticed:
        if issubclass(found.category, RuntimeWarning) and " encountered in " in str(found.message):
            if not found.filename.startswith(TESTS):
                return f"a warning: {found.message} ({Path(found.filename).name}:{found.lineno})"
    return None
