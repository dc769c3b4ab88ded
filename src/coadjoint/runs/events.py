"""Events of a run: their specification and the crossings found."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import record_repr, short
from coadjoint.shortcuts import shortcut
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import MAX_COORDINATES
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import is_integer, read_bool, read_choice, read_integer, read_list, read_title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_EVENTS = 64
MAX_CROSSINGS = 2**53
"""Largest `count`: whole numbers up to it are exact in float64."""
PER_CROSSING = ("t", "x", "which", "member", "direction")
NUMBERS = "event "
"""Prefix of the names of stored arrays of crossings."""


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Event:
    """A function g of state and time whose zeros are found during a run.

    Use it for Poincare sections, periods, turning points, and to stop a run at a condition. The zeros found are
    `RecordedEvents`.

    Parameters
    ----------
    g : int, str, Polynomial, Quadratic, or callable
        A coordinate by its number from 0 or by its name, as in datasets (x0 for a basis element e0, which is a name of
        it too); a polynomial or `formula` of the coordinates; or a pure function of x or of (x, t) that returns a
        number.
    direction : {0, 1, -1}
        1: g rises through zero in the direction in which the run goes; -1: it falls; 0: both.
    count : int, optional
        Record at most this many crossings of each member, the first ones; None records all.
    terminal : bool
        Whether the run of a member ends at crossing number `count`, or at the first one if `count` is None.
    name : str, optional
        Key in ``sol.events``; by default the coordinate, or ``event 0``, ``event 1``, ...

    Raises
    ------
    TypeError, ValueError
        An argument has an invalid type or value.

    Notes
    -----
    A step has a crossing if g has another sign after it than before. A state with g = 0 belongs to the step that ends
    there: the start of a run is no crossing, its end is one. Two crossings within one step are searched for where the
    values of g at four successive grid points allow them. None is missed if g is convex away from zero on that step
    and on both neighbours; a longer step may hide a pair. In steps of `Taylor` the series of a polynomial g isolates
    all crossings, however many lie in one step.

    A zero of g without a change of sign is not an event, and may or may not be found: round-off decides whether the
    computed g has a zero there. Locate the zeros of dg/dt instead, and select those where abs(g) is small.

    Examples
    --------
    Periodic flips of the intermediate axis of a rigid body:

    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> flip = co.Event("x2", direction=1, name="flip")
    >>> sol = co.integrate(body, (0.01, 1.0, 0.01), t_span=(0, 100), step=0.05, events=flip)
    >>> sol.events["flip"].t.round(9)
    array([59.44335187])
    """

    g: int | str | Polynomial | Quadratic | Callable[..., Any]
    direction: int = 0
    count: int | None = None
    terminal: bool = False
    name: str | None = None

    def __post_init__(self) -> None:
        assign = object.__setattr__
        if not (isinstance(self.g, str) or is_integer(self.g) or callable(self.g)):
            raise TypeError(
                f"g of an event is {short(self.g)}; give a coordinate by number or name, a Polynomial, or a function "
                "of x or (x, t)"
            )
        if is_integer(self.g):
            assign(self, "g", read_integer(self.g, "the coordinate of an event", 0, MAX_COORDINATES))
        if not is_integer(self.direction) or self.direction not in (0, 1, -1):
            raise ValueError(f"direction of an event is {short(self.direction)}; it must be 1, -1, or 0 for both")
        assign(self, "direction", int(self.direction))
        if self.count is not None:
            assign(self, "count", read_integer(self.count, "count of an event", 1, MAX_CROSSINGS))
        assign(self, "terminal", read_bool(self.terminal, "terminal"))
        if self.name is not None:
            assign(self, "name", read_title(self.name, "name of an event"))
        if callable(self.g):
            takes_time(self.g, "g of an event")

    def __repr__(self) -> str:
        return record_repr(self)

    @property
    def until(self) -> int:
        """Number of the crossing that ends the run of a member; 0 if the event is not terminal."""
        return (self.count or 1) if self.terminal else 0


def read_events(value: Any) -> tuple[Event, ...]:
    """Validate an event or a sequence of events (or None) and return a tuple; at most `MAX_EVENTS`."""
    if value is None:
        return ()
    example = f"co.Event({short(value)})" if isinstance(value, str) else "co.Event('x1')"
    rule = f"give an Event, such as {example}, or a list of them"
    events = (value,) if isinstance(value, Event) else read_list(value, "events", rule)
    if not all(isinstance(event, Event) for event in events):
        raise TypeError(f"events is {short(value)}; {rule}")
    if len(events) > MAX_EVENTS:
        raise ValueError(f"{len(events)} events were given; a run can have at most {MAX_EVENTS}")
    return events


class RecordedEvents:
    """The m crossings of events that a run found, ordered by member, and for each member in the order of the run.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Times.
    x : ndarray, shape (m, n)
        States, computed by a partial step of the same scheme, with the same conservation properties as at the steps.
    which : ndarray of int, shape (m,)
        Index of the event.
    member : ndarray of int, shape (m,)
        Member of the ensemble; 0 for a single run.
    direction : ndarray of int, shape (m,)
        1 where g rises, -1 where it falls.
    attitude : ndarray, shape (m, d, d), or None
        Group elements, if they were computed.
    names : tuple of str
        Names of the events.
    coordinates : tuple of str
        Names of the coordinates, for plots; empty if states are matrices.
    asked : tuple of Event
        The events as specified.

    Notes
    -----
    ``events["name"]`` selects the crossings of one event, and ``events.of(member)`` those of one member.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> sol = co.integrate(body, (0.01, 1.0, 0.01), (0, 70), 0.05, events=[co.Event("x2"), co.Event("x1")])
    >>> sol.events.names, sol.events["x2"].direction
    (('x2', 'x1'), array([-1,  1]))
    """

    def __init__(
        self,
        names: tuple[str, ...],
        t: NDArray[np.float64],
        x: NDArray[Any],
        which: NDArray[np.int64],
        member: NDArray[np.int64],
        direction: NDArray[np.int64],
        attitude: NDArray[np.float64] | None = None,
        coordinates: tuple[str, ...] = (),
        asked: tuple[Event, ...] = (),
    ) -> None:
        self.names, self.t, self.x, self.which, self.member = names, t, x, which, member
        self.direction, self.attitude, self.coordinates = direction, attitude, coordinates
        self.asked = asked

    def __len__(self) -> int:
        return len(self.t)

    def __iter__(self) -> Iterator[Any]:
        raise TypeError("events are arrays: t, x, which, member, direction; take one event by its name, events['name']")

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {np.count_nonzero(self.which == k)}" for k, name in enumerate(self.names))
        return f"<crossings of {counts}>"

    def chosen(self, selection: NDArray[Any]) -> RecordedEvents:
        """Select crossings by mask or indices."""
        attitude = None if self.attitude is None else self.attitude[selection]
        t, x, which, member, direction = (getattr(self, name)[selection] for name in PER_CROSSING)
        return RecordedEvents(self.names, t, x, which, member, direction, attitude, self.coordinates, self.asked)

    def __getitem__(self, name: str | int) -> RecordedEvents:
        """Return the crossings of an event, by its name or number."""
        if isinstance(name, str):
            k = self.names.index(read_choice(name, "event", self.names))
        else:
            k = read_integer(name, "number of an event", 0, len(self.names) - 1)
        return self.chosen(self.which == k)

    def of(self, member: int) -> RecordedEvents:
        """Return the crossings of a member."""
        return self.chosen(self.member == read_integer(member, "member", 0))

    def ends(self, members: int) -> NDArray[np.float64]:
        """Return the times at which terminal events ended the runs, (members,); NaN where none did."""
        times = np.full(members, np.nan)
        last = np.flatnonzero(np.diff(self.member, append=-1))  # last crossing of each member
        for event, asked in enumerate(self.asked):
            if asked.until:
                counts = np.bincount(self.member[self.which == event], minlength=members)
                ended = last[(self.which[last] == event) & (counts[self.member[last]] == asked.until)]
                times[self.member[ended]] = self.t[ended]
        return times

    def plot(self, components: tuple[Any, Any] | None = None, axes: Any = None) -> Figure:
        """Plot two components of the states at the crossings, with one colour for each member.

        Parameters
        ----------
        components : (int or str, int or str), optional
            Components on the horizontal and the vertical axis.
        axes : Axes, optional
            Existing axes to draw into.

        Returns
        -------
        matplotlib.figure.Figure
        """
        return shortcut("draw_result")("crossings", self, components, axes)


def joined_events(pieces: Sequence[RecordedEvents]) -> RecordedEvents:
    """Join the crossings of successive parts of a run, or of members."""
    first = pieces[0]
    t, x, which, member, direction = (
        np.concatenate([getattr(piece, name) for piece in pieces]) for name in PER_CROSSING
    )
    attitude = None if first.attitude is None else np.concatenate(cast(Any, [piece.attitude for piece in pieces]))
    joined = RecordedEvents(first.names, t, x, which, member, direction, attitude, first.coordinates, first.asked)
    return joined.chosen(np.argsort(member, kind="stable"))


def numbers_of_events(events: RecordedEvents) -> dict[str, NDArray[Any]]:
    """Return the arrays of crossings, by name, with complex numbers as pairs of floats."""
    names = PER_CROSSING if events.attitude is None else (*PER_CROSSING, "attitude")
    numbers = {f"{NUMBERS}{name}": getattr(events, name) for name in names}
    return {**numbers, f"{NUMBERS}x": np.ascontiguousarray(events.x).view(np.float64)}


def events_of_numbers(numbers: Mapping[str, Any], like: RecordedEvents, members: int) -> RecordedEvents:
    """Return the crossings of `numbers_of_events`, with names and shapes of others; ValueError if they do not fit."""
    arrays = {name: getattr(like, name) for name in (*PER_CROSSING, "attitude")}
    count = len(numbers[f"{NUMBERS}t"])
    for name, own in arrays.items():
        if own is None:
            continue
        values = numbers[f"{NUMBERS}{name}"]
        arrays[name] = values.view(own.dtype) if name == "x" and values.dtype == np.float64 else values
        if (arrays[name].shape, arrays[name].dtype) != ((count, *own.shape[1:]), own.dtype):
            raise ValueError(f"{name} of the crossings is {values.dtype} of shape {values.shape}")
    which, member, direction = arrays["which"], arrays["member"], arrays["direction"]
    limits = ((which, 0, len(like.names) - 1), (member, 0, members - 1), (abs(direction), 1, 1))
    if (
        any((values < least).any() or (values > most).any() for values, least, most in limits)
        or (np.diff(member) < 0).any()
    ):
        raise ValueError("the crossings are of other events or members, or not in their order")
    return RecordedEvents(like.names, **arrays, coordinates=like.coordinates, asked=like.asked)


class TerminalEvent(NamedTuple):
    """Terminal event of a single-member run: number of saved points, step, time, state, invariants and attitude."""

    points: int
    steps: int
    t: float
    x: NDArray[np.float64]
    values: NDArray[np.float64]
    attitude: NDArray[np.float64] | None
