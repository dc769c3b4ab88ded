"""The brackets of a basis, written for people: ``[e1, e3] = 2 e1 - e2``, as `written_brackets` reads them."""

from __future__ import annotations

from collections.abc import Sequence

from coadjoint.algebra.constants import Triples

READ = 20_000
"""Constants that are looked at: an algebra may have millions."""


def shown_brackets(triples: Triples, basis: Sequence[str], most: int) -> list[str]:
    """Return the first brackets that do not vanish as text.

    Parameters
    ----------
    triples : Triples
        Sorted, each pair once.
    basis : sequence of str
        Names of the basis elements.
    most : int
        How many brackets, at most.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import coadjoint as co
    >>> g = co.algebras.A3_7(a=2.0)
    >>> shown_brackets(g.triples, g.basis, 5)
    ['[e1, e3] = 2 e1 - e2', '[e2, e3] = e1 + 2 e2']
    """
    found: dict[tuple[int, int], str] = {}
    columns = (column[:READ].tolist() for column in triples)
    for i, j, k, c in zip(*columns, strict=True):
        if (i, j) not in found and len(found) == most:
            break
        before = found.get((i, j), "")
        sign = ("-" if c < 0 else "") if not before else (" - " if c < 0 else " + ")
        size = f"{abs(c):.6g}"
        found[i, j] = f"{before}{sign}{'' if size == '1' else size + ' '}{basis[k]}"
    return [f"[{basis[i]}, {basis[j]}] = {text}" for (i, j), text in found.items()]


def count_of_brackets(triples: Triples) -> int:
    """Return how many pairs of basis elements do not commute.

    Examples
    --------
    >>> import coadjoint as co
    >>> count_of_brackets(co.algebras.so(4).triples)
    12
    """
    i, j = triples.i, triples.j
    return 0 if not len(i) else 1 + int(((i[1:] != i[:-1]) | (j[1:] != j[:-1])).sum())
