"""Probes of thresholds: a decision of the library, tried with half and with twice the governing quantity.

The thresholds are stated again in the probes, never read from the library: a probe that took them from there would
move with them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

U = 2.0**-53
Decision = Callable[[Any], bool]


@dataclass(frozen=True)
class Probe:
    """A decision that is "yes" up to a threshold; `keys` are the entries of the scan that it tests."""

    keys: tuple[tuple[str, str], ...]
    below: Any
    above: Any
    decision: Decision

    @property
    def name(self) -> str:
        return self.decision.__name__


PROBES: dict[tuple[str, str], Probe] = {}
"""By name and value: modules of probes may be imported more than once, by doctest as well."""


def probe(*keys: tuple[str, str], at: float) -> Callable[[Decision], Decision]:
    """Register a decision that is "yes" for half of a threshold, and "no" for twice the threshold."""
    return sides(*keys, below=0.5 * at, above=2.0 * at)


def limit(*keys: tuple[str, str], at: int) -> Callable[[Decision], Decision]:
    """Register a decision that is "yes" up to a whole number, and "no" for the next one."""
    return sides(*keys, below=at, above=at + 1)


def sides(*keys: tuple[str, str], below: Any, above: Any) -> Callable[[Decision], Decision]:
    """Register a decision with the values for which it is "yes", and "no"."""

    def register(decision: Decision) -> Decision:
        PROBES[decision.__name__, repr(below)] = Probe(keys, below, above, decision)
        return decision

    return register


def accepted(call: Callable[[], Any], *words: str) -> bool:
    """Whether a call is not refused; a refusal must have the words in its message."""
    try:
        call()
    except (ValueError, TypeError) as refusal:
        assert all(word in str(refusal) for word in words), str(refusal)
        return False
    return True


def perturbed(matrix: Any, place: tuple[int, ...], size: float) -> np.ndarray:
    """A copy of an array with one entry moved."""
    changed = np.array(matrix, dtype=np.result_type(np.asarray(matrix), float))
    changed[place] += size
    return changed
