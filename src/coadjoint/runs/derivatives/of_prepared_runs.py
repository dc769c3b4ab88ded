"""Derivatives of prepared runs, `PreparedRun.jvp` and `vjp`: jointly for members whose tables have one structure.

All others, and those with events or own steps, are differentiated each by a run of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.kernels.tables.compiled import NotWritable
from coadjoint.methods.protocol.derivative_tables import least_exact
from coadjoint.runs.derivatives.backward import Cotangents, Gradient, Pullback, pullback_of_run
from coadjoint.runs.derivatives.differentiable_run import Arguments, DifferentiableRun, Trajectory
from coadjoint.runs.derivatives.forward import Tangents, check_shape, read_mapping, tangents_of_run
from coadjoint.runs.derivatives.located_trajectory import LocatedTrajectory
from coadjoint.runs.derivatives.run_tables import INPUTS, differ_in_columns
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.validation import read_numbers, to_array


def jvp(prepared: PreparedRun, directions: Mapping[str, Any], **arguments: Any) -> tuple[Solution, Tangents]:
    """Return the solution and its derivatives along directions; see `PreparedRun.jvp`."""
    given = Arguments(**arguments)
    names = frozenset(one for one in prepared.parameters if isinstance(directions, Mapping) and one in directions)
    pieces = _by_member(prepared, given, names)
    if pieces is None:
        return _tangents(prepared, given, directions)
    return _tangents_of_members(prepared, given, directions, pieces)


def vjp(prepared: PreparedRun, reverse: str, **arguments: Any) -> tuple[Solution, Pullback]:
    """Return the solution and a function for gradients; see `PreparedRun.vjp`."""
    given = Arguments(**arguments)
    pieces = _by_member(prepared, given, frozenset(prepared.parameters))
    if pieces is None:
        pullback = _pullback(prepared, given, reverse)
    else:
        pullback = _pullback_of_members(prepared, given, reverse, pieces)
    return pullback.solution, pullback


def _tangents(prepared: PreparedRun, given: Arguments, directions: Mapping[str, Any]) -> tuple[Solution, Tangents]:
    run = DifferentiableRun.of(prepared)
    return tangents_of_run(run, _trajectory(run, given, None), directions)


def _pullback(prepared: PreparedRun, given: Arguments, reverse: str) -> Pullback:
    run = DifferentiableRun.of(prepared)
    run.check_reverse(reverse, prepared.step)
    return pullback_of_run(run, _trajectory(run, given, reverse))


def _trajectory(run: DifferentiableRun, given: Arguments, reverse: str | None) -> Trajectory:
    if not given.events and not run.prepared.method.own_steps:
        return Trajectory(run, given, reverse)
    return LocatedTrajectory(run, given, reverse)


_Joined = list[tuple[NDArray[np.int64], PreparedRun]]
"""Members of a batch that are differentiated together, and the run of these."""


def _by_member(prepared: PreparedRun, given: Arguments, names: frozenset[str]) -> _Joined | None:
    """Return the members that are differentiated together if all are not: their structure, steps or times differ."""
    several = prepared.system.is_batch
    if given.events or prepared.method.own_steps:
        if prepared.inputs is not None:
            raise TypeError(
                "runs with events or steps of their own have no derivatives with inputs; prepare without inputs="
            )
        return [] if several or np.ndim(given.x0) > len(prepared.system.shape) else None
    if several:
        joined = _in_columns(prepared, names)
        whole = [len(members) for members, _ in joined] == [len(prepared.system)]
        return None if whole and prepared.loops(prepared.step).order is None else joined
    return None


_Piece = tuple[Any, PreparedRun, Arguments]
"""Members of a run that are differentiated together, by their numbers or the number of one, and their own run."""


def _pieces(prepared: PreparedRun, given: Arguments, together: _Joined) -> tuple[Solution, list[_Piece]]:
    solution, start = prepared.run(**given.keywords), prepared.start(given.x0, given.attitude)
    values = prepared.values_of(given.inputs)
    attitudes: Any = None if prepared.representation is None else start.groups

    def piece(members: Any, run: PreparedRun) -> _Piece:
        attitude = None if attitudes is None else attitudes[members]
        own = {} if values is None else {name: values[members][at] for name, at in prepared.inputs.indices.items()}
        return members, run, given._replace(x0=solution.x0[members], attitude=attitude, inputs=own)

    alone = np.setdiff1d(np.arange(len(solution.x0)), np.concatenate([np.zeros(0, int), *(one for one, _ in together)]))
    pieces = [piece(members, run) for members, run in together]
    return solution, [*pieces, *(piece(m, prepared.of_member(m)) for m in alone.tolist())]


def _in_columns(prepared: PreparedRun, names: frozenset[str]) -> _Joined:
    """Return the members of a batch that are differentiated together by these parameters, and the runs of them."""
    system, cache = prepared.system, prepared.cache.in_columns
    forced = bool(system.forces)
    if prepared.inputs is not None or not (forced or prepared.scheme.differentiates(system.of_member(0))):
        return []
    key = names if forced else frozenset()
    if key not in cache:
        loops = prepared.loops(prepared.step)
        found = [(members, _run_of(prepared, members)) for members in loops.in_columns]
        found = [(members, run) for members, run in found if differ_in_columns(run)]
        if forced:
            # The others are differentiated in one call too; and all with noise, which is that of their numbers.
            together = np.concatenate([np.zeros(0, dtype=np.int64), *(members for members, _ in found)])
            rest = np.arange(len(system)) if loops.order is None else loops.order
            if system.has_noise and (len(together) < len(system) or found[0][1] is not prepared):
                found = [(np.arange(len(system)), prepared)]
            elif len(rest := rest[~np.isin(rest, together)]) > 1:
                found.append((rest, _run_of(prepared, rest)))
            found = [(members, run) for members, run in found if _joins(run, names)]
        cache[key] = found
    return cache[key]


def _run_of(prepared: PreparedRun, members: NDArray[np.int64]) -> PreparedRun:
    return prepared if np.array_equal(members, np.arange(len(prepared.system))) else prepared.sampled(members)


def _joins(prepared: PreparedRun, names: frozenset[str]) -> bool:
    """Return whether the derivatives of steps with forces of all members have the same coefficients."""
    if prepared.loops(prepared.step).order is not None:
        return False
    try:
        DifferentiableRun.of(prepared).tables(prepared.step, names)
    except NotWritable:
        return False
    return True


def _tangents_of_members(
    prepared: PreparedRun, given: Arguments, directions: Any, joined: _Joined
) -> tuple[Solution, Tangents]:
    """Return the solution of all members, and the tangents of each, side by side."""
    solution, pieces = _pieces(prepared, given, joined)
    count, points, parameters = len(solution.x0), len(solution.t), prepared.parameters
    directions = read_mapping(directions, "directions", "names")
    leading: dict[str, Any] = {}
    for name, value in directions.items():
        shape = (count, *prepared.system.shape) if name == "x0" else None
        if name in parameters and prepared.system.is_batch:
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
    of_inputs: dict[str, Any] = {}
    if prepared.inputs is not None:
        of_inputs = read_mapping(directions.pop(INPUTS, {}), "the direction inputs", "names of inputs")
    for name, value in of_inputs.items():
        if name not in prepared.inputs.indices:
            raise unknown_name("input of this run", name, prepared.inputs.indices)
        array, shape = read_numbers(value, f"the direction {INPUTS}.{name}"), prepared.inputs.indices[name].shape
        check_shape(f"{INPUTS}.{name}", array, (count, *shape) if name in _by_each(prepared, given) else shape)
        of_inputs[name] = array

    def of_piece(piece: _Piece) -> Tangents:
        members, run, own = piece
        of_each = {name: leading[name][members] if name in leading else value for name, value in directions.items()}
        if of_inputs:
            own_inputs = {name: one[members] for name, one in of_inputs.items() if name in _by_each(prepared, given)}
            of_each[INPUTS] = of_inputs | own_inputs
        return _tangents(run, own, of_each)[1]

    found, error = _of_each(of_piece, pieces)
    ended = ~np.isnan(solution.events.ends(count)) if solution.events is not None else np.zeros(count, dtype=bool)

    def stacked(name: str) -> Any:
        parts = [
            _padded(getattr(one, name), points, bool(np.any(ended[members])))
            for (members, *_), one in zip(pieces, found, strict=True)
        ]
        return _beside(pieces, parts, count, axis=1)

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
    _raise(error, solution, tangents)
    return solution, tangents


def _pullback_of_members(prepared: PreparedRun, given: Arguments, reverse: str, joined: _Joined) -> Pullback:
    """Return the function from cotangents of the outputs of a run of several members to a gradient."""
    solution, pieces = _pieces(prepared, given, joined)
    pullbacks = [_pullback(run, own, reverse) for _, run, own in pieces]
    by_each = _by_each(prepared, given)
    return Pullback(solution, partial(_gradient_of_members, prepared, solution, pieces, pullbacks, by_each))


def _by_each(prepared: PreparedRun, given: Arguments) -> set[str]:
    """Return the names of the inputs that were given for each member, as those of their derivatives are."""
    return {name for name, value in given.inputs.items() if np.ndim(value) > prepared.inputs.indices[name].ndim}


def _gradient_of_members(
    prepared: PreparedRun,
    solution: Solution,
    pieces: Sequence[_Piece],
    pullbacks: Sequence[Pullback],
    by_each: set[str],
    given: Cotangents,
) -> Gradient:
    events = solution.events

    def of_piece(part: tuple[_Piece, Pullback]) -> Gradient:
        (members, *_), pullback = part
        mine = None if events is None else events.member == members

        def at_points(series: Any) -> Any:
            """Return the cotangents at the points of the member: zero at a crossing that has ended it."""
            if series is None:
                return None
            points, crossings = len(pullback.solution.t), pullback.solution.events
            if crossings is None or np.isnan(crossings.ends(1)[0]):
                return series[:, members]
            # The last point of the member is its crossing, which the ensemble does not have.
            own = series[:, members]
            return np.concatenate([own[: points - 1], np.zeros_like(own[:1])])

        return pullback._gradient(
            Cotangents(
                x=at_points(given.x),
                attitude=at_points(given.attitude),
                energy=at_points(given.energy),
                observed={name: at_points(one) for name, one in given.observed.items()},
                events={name: one[mine] for name, one in given.events.items()},
            )
        )

    found, error = _of_each(of_piece, list(zip(pieces, pullbacks, strict=True)))
    values = {}
    # Members of a batch may have further parameters, or others of the same name.
    parameters = [name for name in found[0] if name in prepared.parameters]
    for name in [*(name for name in ("x0", "attitude0") if name in found[0]), *parameters]:
        stacked = _beside(pieces, [one[name] for one in found], len(solution.x0), axis=0)
        summed = name in parameters and not prepared.system.is_batch
        values[name] = stacked.sum(axis=0) if summed else stacked
    if prepared.inputs is not None:
        values[INPUTS] = {}
        for name in prepared.inputs.indices:
            stacked = _beside(pieces, [one[INPUTS][name] for one in found], len(solution.x0), axis=0)
            values[INPUTS][name] = stacked if name in by_each else stacked.sum(axis=0)
    gradient = Gradient(values, _rules(found, parameters))
    _raise(error, solution, gradient)
    return gradient


def _beside(pieces: Sequence[_Piece], parts: Sequence[Any], count: int, axis: int) -> Any:
    """Return arrays of pieces as one, with an axis of all members."""
    shape = list(np.shape(parts[0]))
    shape[axis : axis + (np.ndim(pieces[0][0]) > 0)] = [count]
    total = np.empty(shape, dtype=parts[0].dtype)
    for (members, *_), part in zip(pieces, parts, strict=True):
        total[(slice(None),) * axis + (members,)] = part
    return total


def _of_each(of_piece: Callable[[Any], Any], pieces: Sequence[Any]) -> tuple[list[Any], IntegrationError | None]:
    """Return the derivatives of all pieces, and the first error of those whose derivatives overflow."""
    found, error = [], None
    for piece in pieces:
        try:
            found.append(of_piece(piece))
        except IntegrationError as raised:
            if raised.derivatives is None:
                raise
            found.append(raised.derivatives)
            error = error or raised
    return found, error


def _rules(found: Sequence[Tangents | Gradient], names: Iterable[str]) -> dict[str, str]:
    """Return the rule of each parameter: the farthest one from the computed map among the members."""
    return {name: least_exact(one.rule[name] for one in found) for name in names}


def _raise(error: IntegrationError | None, solution: Solution, derivatives: Any) -> None:
    """Raise the error of a piece, if there is one, with the results of all members."""
    if error is not None:
        error.partial, error.derivatives = solution, derivatives
        raise error


def _padded(series: Any, points: int, ended: bool) -> Any:
    """Return tangents at the points of the ensemble: NaN from the crossing on that has ended a member."""
    if not ended:
        return series
    rest = np.full((points, *series.shape[1:]), np.nan, dtype=series.dtype)
    rest[: len(series) - 1] = series[:-1]
    return rest
