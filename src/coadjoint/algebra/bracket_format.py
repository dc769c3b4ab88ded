"""Formatting of brackets, ``[e1, e3] = 2 e1 - e2``, in the notation that `written_brackets` parses."""

from __future__ import annotations

from collections.abc import Sequence

from coadjoint.algebra.constants import Triples

MAX_EXAMINED_CONSTANTS = 20_000
"""Number of constants examined; an algebra may have millions."""


def format_brackets(triples: Triples, basis: Sequence[str], most: int) -> list[str]:
    """Format the first `most` nonzero brackets."""
    found: dict[tuple[int, int], str] = {}
    columns = (column[:MAX_EXAMINED_CONSTANTS].tolist() for column in triples)
    for i, j, k, c in zip(*columns, strict=True):
        if (i, j) not in found and len(found) == most:
            break
        before = found.get((i, j), "")
        sign = ("-" if c < 0 else "") if not before else (" - " if c < 0 else " + ")
        size = f"{abs(c):.6g}"
        found[i, j] = f"{before}{sign}{'' if size == '1' else size + ' '}{basis[k]}"
    return [f"[{basis[i]}, {basis[j]}] = {text}" for (i, j), text in found.items()]


def count_of_brackets(triples: Triples) -> int:
    """Return the number of pairs of basis elements that do not commute."""
    i, j = triples.i, triples.j
    return 0 if not len(i) else 1 + int(((i[1:] != i[:-1]) | (j[1:] != j[:-1])).sum())
