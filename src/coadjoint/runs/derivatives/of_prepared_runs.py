"""Derivatives of prepared runs: `PreparedRun.jvp` and `PreparedRun.vjp`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from coadjoint.runs.derivatives.backward import Pullback
from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun
from coadjoint.runs.derivatives.forward import tangents_of_run
from coadjoint.runs.derivatives.located_trajectory import trajectory_of
from coadjoint.runs.derivatives.members import PullbackOfMembers, by_member, tangents_of_members
from coadjoint.runs.derivatives.results import Tangents
from coadjoint.runs.events import read_events
from coadjoint.runs.results.solution import Solution

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun


def jvp(
    prepared: PreparedRun,
    x0: Any,
    t_span: tuple[float, float],
    directions: Mapping[str, Any],
    save_every: int,
    t_eval: Any,
    attitude: Any,
    events: Any,
    inputs: Mapping[str, Any],
) -> tuple[Solution, Tangents]:
    """Return the solution and its derivatives along directions; see `PreparedRun.jvp`."""
    watched = read_events(events)
    if by_member(prepared, x0, watched):
        _check_without_inputs(prepared)
        return tangents_of_members(prepared, x0, t_span, directions, save_every, t_eval, attitude, watched)
    run = _derivatives_of(prepared)
    trajectory = trajectory_of(run, x0, t_span, save_every, t_eval, attitude, None, watched, inputs)
    return tangents_of_run(run, trajectory, directions)


def vjp(
    prepared: PreparedRun,
    x0: Any,
    t_span: tuple[float, float],
    save_every: int,
    t_eval: Any,
    attitude: Any,
    reverse: str,
    events: Any,
    inputs: Mapping[str, Any],
) -> tuple[Solution, Pullback | PullbackOfMembers]:
    """Return the solution and a function for gradients; see `PreparedRun.vjp`."""
    watched = read_events(events)
    if by_member(prepared, x0, watched):
        _check_without_inputs(prepared)
        found = PullbackOfMembers(prepared, x0, t_span, save_every, t_eval, attitude, reverse, watched)
        return found.solution, found
    run = _derivatives_of(prepared)
    run.check_reverse(reverse, prepared.step)
    trajectory = trajectory_of(run, x0, t_span, save_every, t_eval, attitude, reverse, watched, inputs)
    return trajectory.solution, Pullback(run, trajectory)


def _derivatives_of(prepared: PreparedRun) -> DifferentiableRun:
    """Return the tables of the derivatives of a run, which it keeps."""
    prepared.check_differentiable()
    cache = prepared.cache
    if cache.derivatives is None:
        cache.derivatives = DifferentiableRun(prepared)
    return cache.derivatives


def _check_without_inputs(prepared: PreparedRun) -> None:
    if prepared.takes_inputs:
        raise TypeError(
            "members are differentiated one by one if they have systems, steps or events of their own, and then "
            "without inputs; prepare a run of each member"
        )
