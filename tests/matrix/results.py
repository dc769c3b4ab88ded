"""Runs as arrays by name, member by member, and their comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

import coadjoint as co


def attempted(*arguments: Any, **options: Any) -> co.Solution:
    """Integrate; return what there is of a run that fails."""
    try:
        return co.integrate(*arguments, **options)
    except co.IntegrationError as error:
        return error.partial


def fixed(system: Any, values: np.ndarray, to: float) -> np.ndarray:
    """Return states or directions whose central coordinate, if the system has one, is `to`: 1 in states."""
    one = getattr(system, "systems", [system])[0].unforced
    if one.name not in co.systems.names() or "z" not in one.casimirs:
        return values
    values = np.array(values)
    values[..., np.argmax(np.abs(one.casimirs["z"].gradient(np.zeros(one.dim))))] = to
    return values


def momenta(system: Any) -> np.ndarray:
    """Return 1 for coordinates that a torque may change, momenta, and 0 for others."""
    one = getattr(system, "systems", [system])[0].unforced
    taken = np.ones(one.dim)
    for i in range(one.dim) if one.layout.get("coordinates") else ():
        try:
            one.with_forces(co.forces.Torque(np.eye(one.dim)[i]))
        except ValueError:
            taken[i] = 0.0
    return taken


def numbers(sol: co.Solution, m: int | None = None, every: Any = slice(None), followed: bool = True) -> dict[str, Any]:
    """Return every number of a run, or of one of its members, at some of the saved times.

    Only the times that a member reaches: in an ensemble, states after its end are NaN. The last state of a single
    member that an event ends is left out, since it lies between the saved times. `followed`: with Casimirs of several
    branches, and with changes, which depend on the steps at which they are watched.
    """
    along = {"x": sol.x, "energy": sol.energy, **(sol.observed or {})}
    along |= {f"Casimir {name}": values for name, values in sol.casimirs.items() if followed or "log" not in name}
    if sol.attitude is not None:
        along["attitude"] = sol.attitude
    if sol.work is not None:
        along |= {f"work of {force} on {name}": v for force, done in sol.work.items() for name, v in done.items()}
    if m is not None:
        along = {name: values[:, m] for name, values in along.items()}
    many = m is not None or sol.failed is not None
    reached = len(sol.t)
    if m is not None:
        reached = int(np.isfinite(along["x"].reshape(reached, -1)).all(axis=1).sum())
    elif not many and sol.events is not None and sol.t_span[1] != sol.asked_span[1]:
        reached = max(1, reached - 1)  # at the start itself, there is one state
    found = {name: values[:reached][every] for name, values in along.items()}
    if followed and sol.watched:
        for name, change in sol.change().items():
            found[f"change of {name}"] = change.tenths if m is None else change.tenths[m]
    if sol.events is not None:
        own = sol.events if m is None else sol.events.of(m)
        found |= {"crossings": own.t, "crossed": own.x, "which": own.which, "directions": own.direction}
    return found


def rows(found: dict[str, Any], every: Any) -> dict[str, Any]:
    """Return what is saved along a run at some of the saved times, without changes."""
    kept = ("change", "cross", "which", "direct")
    return {name: values[every] for name, values in found.items() if not name.startswith(kept)}


def shared(found: dict[str, Any], names: Any) -> dict[str, Any]:
    """Return the arrays of these names."""
    return {name: found[name] for name in found if name in names}


def difference(found: Any, expected: Any, allowed: Any = 0.0) -> str | None:
    """Return how two numbers, arrays or mappings of them differ by more than is allowed; None if they do not.

    Nothing allowed means equal bits; all NaN are equal.
    """
    if isinstance(found, list):
        return difference(dict(enumerate(found)), dict(enumerate(expected)), allowed)
    if isinstance(found, dict):
        if found.keys() != expected.keys():
            return f"{sorted(found)} are there, not {sorted(expected)}"
        limit = allowed if isinstance(allowed, dict) else dict.fromkeys(found, allowed)
        sentences = {name: difference(found[name], expected[name], limit[name]) for name in found}
        return "; ".join(f"{name}: {text}" for name, text in sentences.items() if text) or None
    one, other = (np.asarray(value) + 0 for value in (found, expected))  # of truth values, numbers
    if one.shape != other.shape and np.ndim(expected):
        return f"shape {one.shape}, not {other.shape}"
    if np.ndim(allowed) == 0 and allowed == 0.0:
        if np.array_equal(one, other, equal_nan=True):
            return None
        off, largest = np.abs(one - other), 0.0
    else:
        off = np.abs(one - other)
        if np.all(off <= allowed):
            return None
        largest = np.max(allowed)
    place = np.unravel_index(np.argmax(np.where(np.isnan(off), np.inf, off)), off.shape)
    where = f" at {[int(k) for k in place]}" if place else ""
    other = np.broadcast_to(other, one.shape)
    return f"{one[place]!r}, not {other[place]!r}{where}; they differ by {off[place]:.3g}, allowed {largest:.3g}"


def assert_agree(found: Any, expected: Any, allowed: Any = 0.0) -> None:
    """Raise AssertionError with the two numbers that differ most."""
    text = difference(found, expected, allowed)
    assert text is None, text
