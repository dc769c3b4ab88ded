"""Texts of the command ``coadjoint checkcase``, and its parameters of cases."""

from __future__ import annotations

from typing import Any

from coadjoint.checkcases.check_case import CheckCase
from coadjoint.checkcases.registry import defaults_of, names, title_of
from coadjoint.short_repr import short

MAX_NUMBERS_LENGTH = 400  # characters of a parameter of a check-case, up to nine numbers


def listed_cases() -> str:
    """Return the check-cases with their parameters, two lines each."""
    lines = []
    for name in names():
        arguments = ", ".join(f"{key}={value!r}" for key, value in defaults_of(name).items())
        lines.append(f"{name}({arguments})\n    {title_of(name)}")
    return "\n".join(lines)


def described_case(case: CheckCase) -> str:
    """Return the description of a case, with the errors of published samples."""
    lines = [str(case)]
    for simulator, samples in case.published.items():
        found = case.compare(samples)
        errors = ", ".join(f"{each.name} {each.largest:.2g}" for each in found.errors[: len(case.quantities)])
        lines.append(f"published, {simulator}: {errors}" + "".join(f"; {each}" for each in found.diagnosis))
    return "\n".join(lines)


def read_case_parameter(text: str) -> tuple[str, Any]:
    """Parse a parameter of a check-case, such as end=20, rates=0.1,2,0.1 or inertia=1,0,0;0,2,0;0,0,3."""
    key, _, numbers = text.partition("=")
    try:
        if len(text) > MAX_NUMBERS_LENGTH:
            raise ValueError
        rows = [[float(entry) for entry in row.split(",")] for row in numbers.split(";")]
    except ValueError:
        raise ValueError(f"{short(text)} is no parameter; give name and numbers, such as rates=0.1,2,0.1") from None
    if len(rows) > 1:
        return key, rows
    single = rows[0][0]
    if len(rows[0]) > 1:
        return key, rows[0]
    return key, int(single) if single.is_integer() and "." not in numbers and "e" not in numbers.lower() else single
