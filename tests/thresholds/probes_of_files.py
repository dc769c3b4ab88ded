"""Thresholds of `files/` and of the readers of arguments."""

import time

from coadjoint.files.configuration.parsing import parse_toml
from coadjoint.files.configuration.sweep_models import SweepTable
from coadjoint.files.records.entries import Entry
from coadjoint.methods.compiled_steps.preprocessed_source import stamps_are_final
from coadjoint.validation import check_power, read_title
from thresholds.probing import accepted, limit, probe, sides

ENTRIES = "files/records/entries.py"


@limit(("files/configuration/parsing.py", "MAX_NESTING"), at=64)
def a_key_has_not_too_many_parts(parts):
    return accepted(lambda: parse_toml("run.toml", ".".join(["a"] * parts) + " = 1"), "64")


@limit((ENTRIES, "MAX_DEPTH"), at=32)
def an_entry_lies_not_too_deep(depth):
    def read():
        entry = Entry(value, "x0")
        for _ in range(depth):
            (entry,) = entry.entries()

    value = 1
    for _ in range(depth):
        value = [value]
    return accepted(read, "deeper")


@limit((ENTRIES, "MAX_CHARACTERS"), at=2000)
def a_text_is_not_too_long(letters):
    return accepted(lambda: Entry("x" * letters, "name").text(), "2000")


@limit((ENTRIES, "MAX_INTEGER"), at=2**62)
def a_whole_number_is_in_range(number):
    return accepted(lambda: Entry(number, "steps").integer(), "whole")


@limit(("files/configuration/sweep_models.py", "MAX_SEED"), at=2**63 - 1)
def a_seed_of_a_sweep_is_in_range(seed):
    given = {"samples": 2, "seed": seed, "over": {"x": {"uniform": [0.0, 1.0]}}}
    return accepted(lambda: SweepTable.model_validate(given))


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
