"""Tests that say again what shorter ones say, for more seeds, schemes or compilers: `make long` runs them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def long_beyond(count: int, cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; those beyond the first ones are long."""
    return [case if k < count else pytest.param(case, marks=pytest.mark.long) for k, case in enumerate(cases)]


def long_where(chosen: Iterable[Any], cases: Iterable[Any]) -> list[Any]:
    """Return cases for `parametrize`; the chosen ones are long."""
    chosen = list(chosen)
    return [pytest.param(case, marks=pytest.mark.long) if case in chosen else case for case in cases]
