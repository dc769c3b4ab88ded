"""A statement of the literature, put to the test: what it says, what decides, what was measured, and the verdict."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

HOLDS, LIMITED, FAILS = "holds", "holds with a limit", "does not hold"


class Statement(NamedTuple):
    """One row of a table of statements.

    Parameters
    ----------
    key : str
        Short name, for tests and references.
    place : str
        Where the paper says it.
    statement : str
        What it is about.
    paper : str
        What the paper says.
    criterion : str
        What decides, and from what it is derived.
    measured : str
        What was measured in this run.
    verdict : str
        ``"holds"``, ``"holds with a limit"`` or ``"does not hold"``.
    """

    key: str
    place: str
    statement: str
    paper: str
    criterion: str
    measured: str
    verdict: str


def judged(
    key: str,
    place: str,
    statement: str,
    *,
    paper: str,
    criterion: str,
    measured: str,
    holds: bool,
    limited: bool = False,
) -> Statement:
    """Return a row with its verdict.

    Parameters
    ----------
    key, place, statement, paper, criterion, measured : str
        As in `Statement`.
    holds : bool
        Whether the measurements meet the criterion.
    limited : bool
        Whether they also show a limit that the paper does not name.

    Returns
    -------
    Statement

    Examples
    --------
    >>> words = dict(paper="2 + 2 = 4", criterion="exact", measured="4")
    >>> judged("sum", "page 1", "a sum", holds=2 + 2 == 4, **words).verdict
    'holds'
    """
    verdict = FAILS if not holds else LIMITED if limited else HOLDS
    return Statement(key, place, statement, paper, criterion, measured, verdict)


def write_csv(rows: Sequence[Statement], path: Path) -> None:
    """Write the rows as comma-separated values with a header.

    Parameters
    ----------
    rows : sequence of Statement
        The table.
    path : Path
        Where to.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Statement._fields)
        writer.writerows(rows)


def markdown(rows: Sequence[Statement]) -> str:
    r"""Return the rows as a Markdown table.

    Parameters
    ----------
    rows : sequence of Statement
        The table.

    Returns
    -------
    str

    Examples
    --------
    >>> row = Statement("k", "1", "a", "b", "|x| small", "d", HOLDS)
    >>> print(markdown([row]).splitlines()[-1])
    | 1 | a | b | \|x\| small | d | holds |
    """
    lines = [
        "| place | statement | what the paper says | criterion | measured | verdict |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (cell.replace("|", r"\|").replace("\n", " ") for cell in row[1:])
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
