"""Solutions that are compared bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np

import coadjoint as co
from rounding import UNIT_ROUNDOFF

PARTS = (
    "t", "x", "x0", "energy", "casimirs", "attitude", "attitude0", "observed", "work", "initial", "failed", "t_span",
    "asked_span", "step", "save_every", "carried", "watched", "incomplete", "method",
)  # fmt: skip


def plain(value: Any) -> Any:
    """Return mappings as dictionaries, and drifts as numbers."""
    if hasattr(value, "items"):
        return {name: plain(each) for name, each in value.items()}
    return (float(value), np.asarray(value.tenths), value.members) if hasattr(value, "tenths") else value


def check_same(found: co.Solution, expected: co.Solution, *, left_out: tuple[str, ...] = (), work: bool = True) -> None:
    """Compare two solutions bit for bit.

    Invariants at a start that is not saved are not stored, and are computed again with another order of summation.
    """
    computed = expected.t[0] != expected.t_span[0]
    for part in PARTS:
        read, saved = plain(getattr(found, part)), plain(getattr(expected, part))
        if part in left_out:
            continue
        if part == "initial" and computed:
            for invariant, values in saved.items():
                np.testing.assert_allclose(read[invariant], values, rtol=16 * UNIT_ROUNDOFF)
            continue
        np.testing.assert_equal(read, saved, err_msg=part)
    for part in ("casimirs", "observed", "work"):
        assert part in left_out or list(getattr(found, part)) == list(getattr(expected, part))
    for part in ("change", "balance") if expected.work else ("drift", "change"):
        for relative in (True, False):
            read, saved = getattr(found, part)(relative), getattr(expected, part)(relative)
            if computed and relative:
                for invariant, drift in saved.items():
                    np.testing.assert_allclose(read[invariant].tenths, drift.tenths, rtol=16 * UNIT_ROUNDOFF)
            else:
                np.testing.assert_equal(plain(read), plain(saved), err_msg=part)
    stats = [(sol.stats.evaluations, sol.stats.iterations) for sol in (found, expected)]
    assert found.stats.steps == expected.stats.steps
    assert stats[0] == stats[1] or (not work and stats[0] >= stats[1])
