"""Solutions that are compared bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np

import coadjoint as co
from rounding import UNIT_ROUNDOFF

EVENTS = "names", "coordinates", "t", "x", "which", "member", "direction", "attitude"
PARTS = (
    "t", "x", "x0", "energy", "casimirs", "attitude", "attitude0", "observed", "work", "initial", "failed", "t_span",
    "asked_span", "t_eval", "step", "save_every", "carried", "watched", "incomplete", "method",
)  # fmt: skip


def plain(value: Any) -> Any:
    """Return mappings as dictionaries in the order of their keys, and drifts as numbers."""
    if hasattr(value, "items"):
        return {name: plain(each) for name, each in sorted(value.items(), key=lambda item: str(item[0]))}
    return (float(value), np.asarray(value.tenths), value.members) if hasattr(value, "tenths") else value


def same_bits(one: Any, other: Any) -> bool:
    """Return whether two values are equal in every bit; the zeros of complex numbers may differ in their signs."""
    if isinstance(one, dict | tuple) and type(one) is type(other) and len(one) == len(other):
        pairs = zip(*(each.items() if isinstance(each, dict) else each for each in (one, other)), strict=True)
        return all(same_bits(*pair) for pair in pairs)
    if not isinstance(other, np.ndarray | np.generic | float):
        return bool(one == other)
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return np.array_equal(one, other, equal_nan=True) if np.iscomplexobj(one) else one.tobytes() == other.tobytes()


def check_same(found: co.Solution, expected: co.Solution, *, left_out: tuple[str, ...] = (), work: bool = True) -> None:
    """Compare every public part of two solutions bit for bit.

    Invariants at a start that is not saved are not stored, and are computed again with another order of summation.
    """
    computed = expected.t[0] != expected.t_span[0]
    for part in PARTS:
        read, saved = plain(getattr(found, part)), plain(getattr(expected, part))
        if part == "initial" and computed:
            for invariant, values in saved.items():
                np.testing.assert_allclose(read[invariant], values, rtol=16 * UNIT_ROUNDOFF)
        else:
            assert part in left_out or same_bits(read, saved), (part, read, saved)
    for part in ("change", "balance") if expected.work else ("drift", "change"):
        for relative in (True, False):
            read, saved = plain(getattr(found, part)(relative)), plain(getattr(expected, part)(relative))
            if computed and relative:
                for invariant, drift in saved.items():
                    np.testing.assert_allclose(read[invariant][1], drift[1], rtol=16 * UNIT_ROUNDOFF)
            else:
                assert same_bits(read, saved), (part, read, saved)
    assert (found.events is None) == (expected.events is None)
    for part in EVENTS if expected.events is not None and "events" not in left_out else ():
        assert same_bits(getattr(found.events, part), getattr(expected.events, part)), part
    stats = [(sol.stats.evaluations, sol.stats.iterations) for sol in (found, expected)]
    assert found.stats.steps == expected.stats.steps
    # After an event that ends a member, the loops compute it to the end of the piece.
    assert stats[0] == stats[1] or found.events is not None or (not work and stats[0] >= stats[1])
