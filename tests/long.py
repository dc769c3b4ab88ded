"""Marks of long tests, which repeat shorter ones for more seeds, schemes or compilers (`make long`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

MOST_CASES = 3


def long_beyond(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; those beyond the first ones are long."""
    return [case if k < count else _long(case) for k, case in enumerate(cases)]


def long_where(chosen: Iterable[Any], cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; the chosen ones are long."""
    chosen = list(chosen)
    return [_long(case) if case in chosen else case for case in cases]


def long_between(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; the first and every `count`-th after it stay, those between are long."""
    return [_long(case) if k % count else case for k, case in enumerate(cases)]


def thin(items: Iterable[pytest.Item]) -> None:
    """Mark all but about one of k cases of each test marked `thinned(k)` as long, whatever the number of parameters.

    Of tests without the mark, about `MOST_CASES` cases stay; all of them if the name of the test says that something is
    refused: each is a claim of its own, and takes milliseconds.

    Cases stay as in a Latin square: the ranks of their values among those of each parameter add up to a multiple of k.
    Each value of a parameter that has no more values than cases stay is in at least one of them. The nearest mark
    counts: that of a test before that of its module.
    """
    tests: dict[str, list[Any]] = {}
    for item in items:
        if _may_be_thinned(item):
            tests.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in tests.values():
        mark = cases[0].get_closest_marker("thinned")
        usual = 1 if "refused" in cases[0].originalname else max(1, len(cases) // MOST_CASES)
        _thin_one(cases, mark.args[0] if mark else usual)


def _may_be_thinned(item: pytest.Item) -> bool:
    """Return whether a test is marked, has cases, and is neither long nor sensitive."""
    marks = {mark.name for mark in item.iter_markers()}
    return not marks & {"long", "sensitive"} and hasattr(item, "callspec")


def _thin_one(cases: Sequence[Any], share: int) -> None:
    """Mark cases of one test as long."""
    ranks: dict[tuple[int, str], int] = {}
    counts: dict[int, int] = {}
    values = []
    for case in cases:
        # One name for each `parametrize`; pytest numbers the cases, not the values, in `indices`.
        values.append(set(enumerate(case.callspec._idlist)))
        for key in values[-1] - ranks.keys():
            ranks[key] = counts.get(key[0], 0)
            counts[key[0]] = ranks[key] + 1
    stays = [sum(ranks[key] for key in keys) % share == 0 for keys in values]
    few = {key for key in ranks if counts[key[0]] * share <= len(cases)}
    missing = few - {key for keys, stay in zip(values, stays, strict=True) if stay for key in keys}
    while missing:
        most = max(range(len(cases)), key=lambda k: len(values[k] & missing))
        stays[most] = True
        missing -= values[most]
    for case, stay in zip(cases, stays, strict=True):
        if not stay:
            case.add_marker(pytest.mark.long)


def _long(case: Any) -> Any:
    """Return a case, a tuple of values where there are several names, with the mark."""
    if hasattr(case, "marks"):  # made by pytest.param
        return pytest.param(*case.values, marks=[*case.marks, pytest.mark.long], id=case.id)
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
