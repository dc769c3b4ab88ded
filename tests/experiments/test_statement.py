"""Tables of statements: verdicts follow from what is measured, and files say what the rows say."""

import csv
from pathlib import Path

import pytest

from coadjoint.experiments.statement import FAILS, HOLDS, LIMITED, judge, markdown, write_csv

WORDS = {"paper": "p", "criterion": "|x| < 1", "measured": "m, 0.5"}


@pytest.mark.parametrize(
    ("holds", "limited", "verdict"),
    [(True, False, HOLDS), (True, True, LIMITED), (False, False, FAILS), (False, True, FAILS)],
)
def test_verdict(holds: bool, limited: bool, verdict: str) -> None:
    assert judge("k", "place", "s", holds=holds, limited=limited, **WORDS).verdict == verdict


def test_csv_returns_the_rows(tmp_path: Path) -> None:
    rows = [
        judge("a", "1", "first, with a comma", holds=True, **WORDS),
        judge("b", "2", 'a "word"', holds=False, **WORDS),
    ]
    write_csv(rows, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as file:
        header, *read = list(csv.reader(file))
    assert header == list(rows[0]._fields)
    assert [tuple(row) for row in read] == [tuple(row) for row in rows]


def test_markdown_has_one_line_of_six_cells_for_each_row() -> None:
    rows = [judge("a", "1", "s", holds=True, **WORDS)] * 3
    lines = markdown(rows).splitlines()
    assert len(lines) == 2 + 3
    assert all(line.replace(r"\|", "").count("|") == 7 for line in lines)
