"""Tests that say again what shorter ones say, for more seeds, schemes or compilers: `make long` runs them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def long_beyond(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; those beyond the first ones are long."""
    return [case if k < count else _long(case) for k, case in enumerate(cases)]


def long_where(chosen: Iterable[Any], cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; the chosen ones are long."""
    chosen = list(chosen)
    return [_long(case) if case in chosen else case for case in cases]


def _long(case: Any) -> Any:
    """Return a case, a tuple of values where there are several names, with the mark."""
    if hasattr(case, "marks"):  # made by pytest.param
        return pytest.param(*case.values, marks=[*case.marks, pytest.mark.long], id=case.id)
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
