"""Thresholds of `files/` and of the readers of arguments."""

import time

from coadjoint.methods.compiled_steps.preprocessed_source import stamps_are_final
from coadjoint.validation import check_power, read_title
from thresholds.probing import accepted, limit, probe, sides

ARRAYS, ENTRIES = "files/archives/stored_arrays.py", "files/records/entries.py"


@limit(("validation.py", "MAX_TITLE_LENGTH"), at=200)
def a_title_is_not_too_long(letters):
    return accepted(lambda: read_title("x" * letters, "name"), "200")


@probe(("validation.py", "power * math.log2(max(abs(number), 1.0)) >= 1024.0"), at=1024.0)
def a_power_is_in_range(bits):
    return accepted(lambda: check_power(2.0 ** (bits / 4), 4, "step"), "range")


@sides(("methods/compiled_steps/preprocessed_source.py", "TIMESTAMP_GRANULARITY"), below=4.0, above=1.0)
def files_are_settled(seconds):
    """Compared with the clock, of which a second is left for the call."""
    when = time.time_ns() - int(seconds * 1e9)
    return stamps_are_final({b"source": (0, 0, 0, when, when)})
