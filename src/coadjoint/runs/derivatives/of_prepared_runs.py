"""Derivatives of prepared runs: `PreparedRun.jvp` and `PreparedRun.vjp`.

Members of batches, with events, or with own steps are differentiated each by a run of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.errors import IntegrationError
from coadjoint.methods.protocol.derivative_tables import ADDED_PART, DIFFERENCES, EXACT
from coadjoint.runs.derivatives.backward import Cotangents, Pullback
from coadjoint.runs.derivatives.differentiable_run import Arguments, DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import check_shape, tangents_of_run
from coadjoint.runs.derivatives.located_trajectory import LocatedTrajectory
from coadjoint.runs.derivatives.results import Gradient, Tangents
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.protocol import is_batch, shape_of
from coadjoint.validation import read_choice, to_array

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun

REVERSES = ("exact", "reversible")


def jvp(prepared: PreparedRun, directions: Mapping[str, Any], **arguments: Any) -> tuple[Solution, Tangents]:
    """Return the solution and its derivatives along directions; see `PreparedRun.jvp`."""
    given = Arguments(**arguments)
    if _by_member(prepared, given):
        return _tangents_of_members(prepared, given, directions)
    run = _derivatives_of(prepared)
    return tangents_of_run(run, _trajectory(run, given, None), directions)


def vjp(prepared: PreparedRun, reverse: str, **arguments: Any) -> tuple[Solution, Pullback]:
    """Return the solution and a function for gradients; see `PreparedRun.vjp`."""
    given = Arguments(**arguments)
    if _by_member(prepared, given):
        pullback: Pullback = PullbackOfMembers(prepared, given, reverse)
    else:
        run = _derivatives_of(prepared)
        undone = read_choice(reverse, "reverse", REVERSES) == "reversible"
        if undone and (prepared.method.own_steps or not run.tables(prepared.step, run.parameters).reversible):
            raise TypeError(f'{prepared.method} has no steps that can be undone; take reverse="exact"')
        pullback = Pullback(run, _trajectory(run, given, reverse))
    return pullback.solution, pullback


def _derivatives_of(prepared: PreparedRun) -> DifferentiableRun:
    """Return the tables of the derivatives of a run, which it keeps."""
    prepared.check_differentiable()
    cache = prepared.cache
    if cache.derivatives is None:
        cache.derivatives = DifferentiableRun(prepared)
    return cache.derivatives


def _trajectory(run: DifferentiableRun, given: Arguments, reverse: str | None) -> Trajectory:
    """Integrate a run to be differentiated."""
    if not given.events and not run.prepared.method.own_steps:
        return Trajectory(run, given, reverse)
    if run.inputs is not None:
        raise TypeError(
            "runs with events or steps of their own have no derivatives with inputs; prepare without inputs="
        )
    return LocatedTrajectory(run, given, reverse)


def _by_member(prepared: PreparedRun, given: Arguments) -> bool:
    """Return whether the members of a run are differentiated one by one: their steps or times differ."""
    several = is_batch(prepared.system)
    if given.events or prepared.method.own_steps:
        several = several or np.ndim(given.x0) > len(shape_of(prepared.system))
    if several and prepared.takes_inputs:
        raise TypeError(
            "members are differentiated one by one if they have systems, steps or events of their own, and then "
            "without inputs; prepare a run of each member"
        )
    return several


def _runs(prepared: PreparedRun, given: Arguments) -> tuple[Solution, list[tuple[PreparedRun, dict[str, Any]]]]:
    """Return the solution of all members, and the run of each with its arguments."""
    solution, start = prepared.run(**given.keywords), prepared.start(given.x0, given.attitude)
    attitudes: Any = [None] * len(solution.x0) if prepared.representation is None else start.groups
    each = zip(solution.x0, attitudes, strict=True)
    arguments = [given._replace(x0=x0, attitude=attitude).keywords for x0, attitude in each]
    return solution, [(prepared.of_member(m), one) for m, one in enumerate(arguments)]


def _tangents_of_members(prepared: PreparedRun, given: Arguments, directions: Any) -> tuple[Solution, Tangents]:
    """Return the solution of all members, and the tangents of each, side by side."""
    solution, runs = _runs(prepared, given)
    count, points, parameters = len(runs), len(solution.t), prepared.parameters
    if not isinstance(directions, Mapping):
        raise TypeError(f"directions is {short(directions)}; give a mapping from names to arrays")
    leading: dict[str, Any] = {}
    for name, value in directions.items():
        shape = (count, *shape_of(runs[0][0].system)) if name == "x0" else None
        if name in parameters and is_batch(prepared.system):
            shape = parameters[name].shape
        if shape is None and name != "attitude0":
            continue
        array = to_array(value, f"the direction {name}", "iufc")
        if shape is not None:
            check_shape(name, array, shape)
        if array.shape[:1] != (count,):
            raise ValueError(
                f"the direction {name} has the shape {array.shape}; its first axis must be that of the {count} members"
            )
        leading[name] = array

    def of_member(m: int) -> Tangents:
        single, arguments = runs[m]
        of_each = {name: leading[name][m] if name in leading else value for name, value in directions.items()}
        return single.jvp(directions=of_each, **arguments)[1]

    found, error = _of_each(of_member, count)
    ended = ~np.isnan(solution.events.ends(count)) if solution.events is not None else np.zeros(count)

    def stacked(name: str) -> Any:
        return np.stack([_padded(getattr(one, name), points, e) for one, e in zip(found, ended, strict=True)], axis=1)

    crossings = {}
    if solution.events is not None:
        crossings = {name: np.concatenate([one.events[name] for one in found]) for name in ("t", "x")}
    tangents = Tangents(
        x=stacked("x"),
        attitude=None if found[0].attitude is None else stacked("attitude"),
        energy=stacked("energy"),
        events=crossings,
        rule=_rules(found, found[0].rule),
    )
    if error is not None:
        raise _joined(error, solution, tangents)
    return solution, tangents


class PullbackOfMembers(Pullback):
    """The function from cotangents of the outputs of a run of several members to a gradient."""

    def __init__(self, prepared: PreparedRun, given: Arguments, reverse: str) -> None:
        self._prepared = prepared
        self._solution, runs = _runs(prepared, given)
        self._pullbacks = [single.vjp(reverse=reverse, **arguments)[1] for single, arguments in runs]

    @property
    def solution(self) -> Solution:
        return self._solution

    def _of_all(self, given: Cotangents) -> Gradient:
        solution, prepared, events = self._solution, self._prepared, self._solution.events

        def of_member(m: int) -> Gradient:
            pullback = self._pullbacks[m]
            mine = None if events is None else events.member == m

            def at_points(series: Any) -> Any:
                """Return the cotangents at the points of the member: zero at a crossing that has ended it."""
                if series is None:
                    return None
                points, crossings = len(pullback.solution.t), pullback.solution.events
                if crossings is None or np.isnan(crossings.ends(1)[0]):
                    return series[:, m]
                # The last point of the member is its crossing, which the ensemble does not have.
                return np.concatenate([series[: points - 1, m], np.zeros_like(series[:1, m])])

            return pullback._of_all(
                Cotangents(
                    x=at_points(given.x),
                    attitude=at_points(given.attitude),
                    energy=at_points(given.energy),
                    observed={name: at_points(one) for name, one in given.observed.items()},
                    events={name: one[mine] for name, one in given.events.items()},
                )
            )

        found, error = _of_each(of_member, len(self._pullbacks))
        values = {}
        # Members of a batch may have further parameters, or others of the same name.
        parameters = [name for name in found[0] if name in prepared.parameters]
        for name in [*(name for name in ("x0", "attitude0") if name in found[0]), *parameters]:
            stacked = np.stack([one[name] for one in found])
            summed = name in parameters and not is_batch(prepared.system)
            values[name] = stacked.sum(axis=0) if summed else stacked
        gradient = Gradient(values, _rules(found, parameters))
        if error is not None:
            raise _joined(error, solution, gradient)
        return gradient


def _of_each(of_member: Callable[[int], Any], count: int) -> tuple[list[Any], IntegrationError | None]:
    """Return the derivatives of all members, and the first error of those whose derivatives overflow."""
    found, error = [], None
    for m in range(count):
        try:
            found.append(of_member(m))
        except IntegrationError as raised:
            if raised.derivatives is None:
                raise
            found.append(raised.derivatives)
            error = error or raised
    return found, error


def _rules(found: Sequence[Tangents | Gradient], names: Iterable[str]) -> dict[str, str]:
    """Return the rule of each parameter: the farthest one from the computed map among the members."""
    nearest_first = (EXACT, DIFFERENCES, ADDED_PART)
    return {name: max((one.rule[name] for one in found), key=nearest_first.index) for name in names}


def _joined(error: IntegrationError, solution: Solution, derivatives: Any) -> IntegrationError:
    return IntegrationError(
        str(error), step=error.step, time=error.time, residual=error.residual, partial=solution, derivatives=derivatives
    )


def _padded(series: Any, points: int, ended: bool) -> Any:
    """Return tangents at the points of the ensemble: NaN from the crossing on that has ended a member."""
    if not ended:
        return series
    rest = np.full((points, *series.shape[1:]), np.nan, dtype=series.dtype)
    rest[: len(series) - 1] = series[:-1]
    return rest
