"""Statements of the literature with the criterion, the measurement and the verdict."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

HOLDS, LIMITED, FAILS = "holds", "holds with a limit", "does not hold"


class Statement(NamedTuple):
    """A row of the table; the verdict is ``"holds"``, ``"holds with a limit"`` or ``"does not hold"``."""

    key: str
    place: str
    statement: str
    paper: str
    criterion: str
    measured: str
    verdict: str


def judge(
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
    """Return a row with its verdict: `holds` if the criterion is met, `limited` if the paper omits a limit."""
    verdict = FAILS if not holds else LIMITED if limited else HOLDS
    return Statement(key, place, statement, paper, criterion, measured, verdict)


def write_csv(rows: Sequence[Statement], path: Path) -> None:
    """Write the rows as comma-separated values with a header."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Statement._fields)
        writer.writerows(rows)


def markdown(rows: Sequence[Statement]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| place | statement | what the paper says | criterion | measured | verdict |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (cell.replace("|", r"\|").replace("\n", " ") for cell in row[1:])
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
