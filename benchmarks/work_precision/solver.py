"""What a solver is to the comparison: a name, settings from loose to tight, and how to get ready for one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from work_precision.problems import STATES, Problem

Solve = Callable[[np.ndarray, float], np.ndarray]


class Failed(Exception):
    """A solver said that it did not reach the end."""


@dataclass(frozen=True)
class Solver:
    """`prepare` compiles whatever is needed and returns the function from an initial state and a span to the end."""

    name: str
    package: str  # whose version is reported
    settings: tuple[Any, ...]
    prepare: Callable[[Problem, Any], Solve]
    states: int = STATES  # slow ones run on the first few
    prepares_each_state: bool = False  # then set-up is the time for one


def decades(loosest: int, tightest: int, apart: int = 2) -> tuple[float, ...]:
    """Return the tolerances 10^-loosest ... 10^-tightest."""
    return tuple(10.0**-k for k in range(loosest, tightest + 1, apart))
