"""Derivatives of runs of several members, each by a run of its own: of batches, with events, or with own steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError, unknown_name
from coadjoint.methods.protocol.derivative_tables import ADDED_PART, DIFFERENCES, EXACT
from coadjoint.runs.derivatives.results import Gradient, Tangents
from coadjoint.short_repr import short
from coadjoint.systems.protocol import is_batch, shape_of
from coadjoint.validation import read_numbers, to_array

if TYPE_CHECKING:
    from coadjoint.runs.derivatives.backward import Pullback
    from coadjoint.runs.events import Event
    from coadjoint.runs.prepared_run import PreparedRun
    from coadjoint.runs.results.solution import Solution

Floats = NDArray[np.float64]


def by_member(prepared: PreparedRun, x0: Any, events: tuple[Event, ...]) -> bool:
    """Return whether the members of a run are differentiated one by one: their steps or times differ."""
    if is_batch(prepared.system):
        return True
    return bool(events or prepared.method.own_steps) and np.ndim(x0) > len(shape_of(prepared.system))


class _Members:
    """A run of all members, and the arguments of that of each."""

    def __init__(self, prepared: PreparedRun, x0: Any, t_span: Any, options: dict[str, Any]) -> None:
        self.prepared, self._t_span, self._options = prepared, t_span, options
        self.solution: Solution = prepared.run(x0, t_span, **options)
        self.count = self.solution.x.shape[1]
        self._start = prepared.start(x0, options["attitude"])
        self.shared = not is_batch(prepared.system)

    def each(self) -> Iterator[tuple[PreparedRun, dict[str, Any]]]:
        """Yield the run of each member and its arguments."""
        for m in range(self.count):
            initial = self._start.groups[m] if self.prepared.representation is not None else None
            state = self.solution.x0[m]
            yield (
                self.prepared.of_member(m),
                {"x0": state, "t_span": self._t_span, **self._options, "attitude": initial},
            )

    def crossings(self, m: int) -> NDArray[np.bool_]:
        """Return which crossings are those of a member."""
        assert self.solution.events is not None
        return np.asarray(self.solution.events.member == m)


def tangents_of_members(
    prepared: PreparedRun,
    x0: Any,
    t_span: Any,
    directions: Any,
    save_every: int,
    t_eval: Any,
    attitude: Any,
    events: tuple[Event, ...],
) -> tuple[Solution, Tangents]:
    """Return the solution of all members, and the tangents of each, side by side."""
    options = {"save_every": save_every, "t_eval": t_eval, "attitude": attitude, "events": events}
    members = _Members(prepared, x0, t_span, options)
    parameters = prepared.parameters
    if not isinstance(directions, Mapping):
        raise TypeError(f"directions is {short(directions)}; give a mapping from names to arrays")
    leading: dict[str, Any] = {}
    for name, value in directions.items():
        shape = (members.count, *shape_of(prepared.of_member(0).system)) if name == "x0" else None
        shape = parameters[name].shape if shape is None and name in parameters and not members.shared else shape
        if shape is None and name != "attitude0":
            continue
        array = to_array(value, f"the direction {name}", "iufc")
        if shape is not None and shape not in (array.shape, array.shape[:-1]):
            raise ValueError(
                f"the direction {name} has the shape {array.shape}; it must be {shape}, or with a last axis of "
                "directions"
            )
        if array.shape[:1] != (members.count,):
            raise ValueError(
                f"the direction {name} has the shape {array.shape}; its first axis must be that of the {members.count} "
                "members"
            )
        leading[name] = array

    def of_member(m: int, single: PreparedRun, arguments: dict[str, Any]) -> Tangents:
        given = {name: leading[name][m] if name in leading else value for name, value in directions.items()}
        return single.jvp(directions=given, **arguments)[1]

    found, error = _of_each(members, of_member)
    solution = members.solution
    points = len(solution.t)
    ended = ~np.isnan(solution.events.ends(members.count)) if solution.events is not None else np.zeros(members.count)

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
        raise _of_all(error, solution, tangents)
    return solution, tangents


class PullbackOfMembers:
    """The function from cotangents of the outputs of a run of several members to a gradient, as `Pullback`."""

    def __init__(
        self,
        prepared: PreparedRun,
        x0: Any,
        t_span: Any,
        save_every: int,
        t_eval: Any,
        attitude: Any,
        reverse: str,
        events: tuple[Event, ...],
    ) -> None:
        options = {"save_every": save_every, "t_eval": t_eval, "attitude": attitude, "events": events}
        self._members = _Members(prepared, x0, t_span, options)
        self._pullbacks: list[Pullback] = [
            single.vjp(reverse=reverse, **arguments)[1]  # type: ignore[misc]
            for single, arguments in self._members.each()
        ]

    def __repr__(self) -> str:
        return f"<pullback of {self.solution!r}>"

    @property
    def solution(self) -> Solution:
        """The solution of the run."""
        return self._members.solution

    def __call__(
        self,
        x: Any = None,
        *,
        attitude: Any = None,
        energy: Any = None,
        observed: Mapping[str, Any] | None = None,
        events: Mapping[str, Any] | None = None,
    ) -> Gradient:
        """Return the gradient of a number; see `Pullback`."""
        members, solution = self._members, self.solution
        series = {"x": (x, solution.x), "attitude": (attitude, solution.attitude), "energy": (energy, solution.energy)}
        given = {name: _checked(value, like, name) for name, (value, like) in series.items() if value is not None}
        of_observed = {}
        for name, value in (observed or {}).items():
            if name not in solution.observed:
                raise unknown_name("observed quantity of this run", name, solution.observed)
            of_observed[name] = _checked(value, solution.observed[name], f"observed {name}")
        of_events = {}
        if events is not None:
            if solution.events is None:
                raise ValueError("events was given to a pullback of a run without them; give events= to vjp")
            if unknown := set(events) - {"t", "x"}:
                raise unknown_name("result of events", min(unknown), ("t", "x"))
            of_events = {
                name: _checked(value, getattr(solution.events, name), f"{name} of events")
                for name, value in events.items()
            }

        def of_member(m: int, pullback: Pullback) -> Gradient:
            points, one = len(pullback.solution.t), pullback.solution
            # The last point of a member that an event has ended is its crossing, which the ensemble does not have.
            arguments = {name: _cut(value[:, m], points, one) for name, value in given.items()}
            if of_observed:
                arguments["observed"] = {name: _cut(value[:, m], points, one) for name, value in of_observed.items()}
            if of_events:
                arguments["events"] = {name: value[members.crossings(m)] for name, value in of_events.items()}
            return pullback(**arguments)

        found, error = [], None
        for m, pullback in enumerate(self._pullbacks):
            try:
                found.append(of_member(m, pullback))
            except IntegrationError as raised:
                if raised.derivatives is None:
                    raise
                found.append(raised.derivatives)
                error = error or raised
        values = {}
        # Members of a batch may have further parameters, or others of the same name.
        parameters = [name for name in found[0] if name in members.prepared.parameters]
        for name in [*(name for name in ("x0", "attitude0") if name in found[0]), *parameters]:
            stacked = np.stack([one[name] for one in found])
            summed = members.shared and name not in ("x0", "attitude0")
            values[name] = stacked.sum(axis=0) if summed else stacked
        gradient = Gradient(values, _rules(found, parameters))
        if error is not None:
            raise _of_all(error, solution, gradient)
        return gradient


def _of_each(members: _Members, function: Callable[..., Tangents]) -> tuple[list[Tangents], IntegrationError | None]:
    """Return the tangents of all members, and the first error of those whose derivatives overflow."""
    found, error = [], None
    for m, (single, arguments) in enumerate(members.each()):
        try:
            found.append(function(m, single, arguments))
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


def _of_all(error: IntegrationError, solution: Solution, derivatives: Any) -> IntegrationError:
    return IntegrationError(
        str(error), step=error.step, time=error.time, residual=error.residual, partial=solution, derivatives=derivatives
    )


def _checked(value: Any, series: Any, name: str) -> Any:
    """Validate the shape of the cotangent of a series."""
    numbers = to_array(value, name, "iufc") if np.iscomplexobj(series) else read_numbers(value, name)
    if series is None or numbers.shape != np.shape(series):
        raise ValueError(f"{name} has the shape {numbers.shape}; as in the solution it must be {np.shape(series)}")
    return numbers


def _cut(series: Any, points: int, solution: Solution) -> Any:
    """Return the cotangents at the points of a member: zero at a crossing that has ended it."""
    if solution.events is None or np.isnan(solution.events.ends(1)[0]):
        return series
    return np.concatenate([series[: points - 1], np.zeros_like(series[:1])])


def _padded(series: Any, points: int, ended: bool) -> Any:
    """Return tangents at the points of the ensemble: NaN from the crossing on that has ended a member."""
    if not ended:
        return series
    rest = np.full((points, *series.shape[1:]), np.nan, dtype=series.dtype)
    rest[: len(series) - 1] = series[:-1]
    return rest
