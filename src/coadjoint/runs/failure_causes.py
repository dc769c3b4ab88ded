"""Causes of failed runs: the function of the user, the force or the pair of bodies that gave no finite numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.methods.forced import Forced
from coadjoint.methods.spherical_midpoint import spins_of
from coadjoint.runs.partial_steps import PartialSteps, noises_of
from coadjoint.short_repr import short

if TYPE_CHECKING:
    from coadjoint.runs.run import Run

MOST_REPEATED = 4096
"""Steps that are repeated from the last saved state to find the cause of a failure, in less than a second."""
UNIT = 1e-6  # deviation of the length of a spin from 1 that is taken for rounding
BLOWN_UP = 1e100  # size of a state beyond which cubes of its numbers overflow: no function is the cause
MOST_TEXT = 200  # characters of the message of an exception
CORRECT = "correct the function, or end t_span before"
ELSEWHERE = "take another x0, or end t_span before"
REACHED = (0.5, 1.0, 1.5)
"""Parts of a step after which states are searched for the cause; substeps of compositions go beyond its end."""
Cause = tuple[str, str]
"""What gave what at which time, and what to do."""


def cause_of_failure(run: Run, member: int, step: int) -> Cause | None:
    """Return the cause of a failed step; None if a number overflowed, or none is found."""
    system, times = run.start.system.of_member(member), run.times
    try:
        with np.errstate(all="ignore"):
            x = _state_before(run, member, step)
            return cause_in_step(system, run.plan.method, x, float(times.t0 + (step - 1) * times.h), float(times.h))
    except Exception:  # a search for a cause does not hide the failure itself
        return None


def _state_before(run: Run, member: int, step: int) -> NDArray[np.float64]:
    """Return the state before a step, from the last saved one, or the latest known state if that is too far."""
    # Behind the coordinates are the works of forces.
    times, saved, n = run.times, run.saved["x"][:, member], run.start.momenta.shape[1]
    numbers = times.saved[: len(saved)]
    known = np.flatnonzero(np.isfinite(saved).all(axis=1) & (numbers < step))
    x, number = np.zeros(saved.shape[1]), 0
    x[:n] = run.start.momenta[member]
    if len(known):
        x, number = saved[known[-1]], int(numbers[known[-1]])
    if step - 1 - number > MOST_REPEATED or noises_of(run.start.system.of_member(member)):
        return x[:n]
    parts = PartialSteps(run.start.system, run.plan.method, run.loops)
    rows, groups = x[None].copy(), run.start.groups[member : member + 1].reshape(1, -1)
    for k in range(number, step - 1):
        at, length = np.array([times.t0 + k * times.h]), np.array([times.h])
        rows, groups, *_ = parts.attempt(rows, groups, at, length, np.array([member]))
    return np.asarray(rows[0] if np.isfinite(rows).all() else x)[:n]


def hint_of_spins(system: Any, x: NDArray[np.float64]) -> str:
    """Return a hint for spins of a lattice that are not unit vectors; "" for all others."""
    if "lattice" not in system.layout or system.has_matrices:
        return ""
    try:
        lengths = np.sqrt((x[spins_of(system)] ** 2).sum(axis=1))
    except ValueError:  # it is not made of spins
        return ""
    if np.abs(lengths - 1.0).max() <= UNIT:
        return ""
    least, most = lengths.min(), lengths.max()
    return f"; spins are unit vectors, and those of x0 have lengths of {least:.3g} to {most:.3g}: divide them by these"


def cause_in_step(system: Any, method: Any, x: NDArray[Any], t: float, h: float) -> Cause | None:
    """Return the cause of a failure in a step from x at time t."""
    plain, y = system.unforced, np.array(x, dtype=np.float64)
    if not np.abs(y).max() < BLOWN_UP:
        return None
    if not system.forces:
        return _of_energy(plain, y, t, h) or _of_step(method, plain, y, t, h)
    for label, force in zip(system.labels, system.forces, strict=True):
        failure = _attempt(force.demand, plain, y, t)[1] if force.sampled else ""
        if failure:
            return f"the law of {label} {failure} at t = {t:g}", CORRECT
    scheme = method if isinstance(method, Forced) else Forced(method)
    for position, part, begin, length in scheme.parts_of_step(system, t, h):
        if position is None:
            cause = _of_energy(plain, y, begin, length) or _of_step(part, plain, y, begin, length)
            y = y if cause else np.asarray(part.step(plain, y, begin, length))
        else:
            y, cause = _of_force(part, system.labels[position], plain, y, begin, length, scheme.order)
        if cause or not np.abs(y).max() < BLOWN_UP:  # a state that a flow has blown up is no cause
            return cause
    return None


def _of_force(
    force: Any, label: str, plain: Any, y: NDArray[Any], t: float, tau: float, order: int
) -> tuple[NDArray[Any], Cause | None]:
    """Return the state after the flow of a force, and the cause if it fails."""
    after, failure = _attempt(force.flow_of_order, plain, y, t, tau, order)
    if not failure:
        return after, None
    for time in () if force.random else (t, t + 0.5 * tau, t + tau):
        found = _attempt(force.field, plain, y, time)[1]
        if found:
            return y, (f"{label} {found} at t = {time:g}", CORRECT)
    if after is not None and not np.isnan(after).any():  # it overflows
        return after, None
    return y, (f"{label} {failure} at t = {t:g}", CORRECT)


def _of_step(method: Any, plain: Any, y: NDArray[Any], t: float, h: float) -> Cause | None:
    """Return the cause if a step of a scheme of the user raises."""
    if type(method).__module__.startswith("coadjoint."):
        return None
    after, failure = _attempt(method.step, plain, y, t, h)
    return (f"the step of {type(method).__name__} {failure} at t = {t:g}", CORRECT) if after is None else None


def _of_energy(plain: Any, y: NDArray[Any], t: float, h: float) -> Cause | None:
    """Return the cause if the Hamiltonian part fails within a step."""
    positions = getattr(plain, "positions", None)
    if positions is not None and len(plain.bodies):
        r = positions(y)
        for i, j in zip(*np.triu_indices(len(r), 1), strict=True):
            if np.array_equal(r[i], r[j]):
                return f"the bodies {i} and {j} are at one place at t = {t:g}", "give them different positions"
    remedy = CORRECT if plain.parameters is None else ELSEWHERE
    for time in (t, t + 0.5 * h, t + h):
        failure = _attempt(plain.hamiltonian.gradient, y, time)[1]
        if failure:
            return f"the gradient of the energy of {plain.name} {failure} at t = {time:g}", remedy
    # A function that raises where the step leads; values that are not finite there may be those of a step too long.
    slope = plain.vector_field(y, t)
    for part in REACHED:
        reached = y + part * h * slope
        value, failure = _attempt(plain.hamiltonian.gradient, reached, t + part * h)
        if value is None and np.abs(reached).max() < BLOWN_UP:
            return f"the gradient of the energy of {plain.name} {failure} at t = {t + part * h:g}", remedy
    return None


def _attempt(call: Callable[..., Any], *arguments: Any) -> tuple[Any, str]:
    """Return a value and "", or what a call raised or gave that is not finite."""
    try:
        value = np.asarray(call(*arguments))
    except Exception as error:  # functions of users raise anything
        return None, f"raises {type(error).__name__} ({in_one_line(str(error), MOST_TEXT)})"
    return value, "" if np.isfinite(value).all() else f"gives {short(value.tolist())}"
