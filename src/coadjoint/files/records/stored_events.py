"""Events in files: parsed from configurations, and stored with solutions."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import coordinate_names as default_names
from coadjoint.algebra.polynomials.polynomial_format import plain
from coadjoint.files.configuration.construction import parse_polynomial
from coadjoint.files.datasets.variables import cf_attributes, split_complex, state_dimensions
from coadjoint.files.records.entries import Entry, as_value_errors
from coadjoint.files.records.reconstruction import invariants_of
from coadjoint.files.records.records import invariants_record
from coadjoint.runs.events import Event, RecordedEvents
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.validation import read_integer


def event_of_file(name: str, table: Mapping[str, Any], system: Any) -> Event:
    """Return the event of a table: ``g``, an index or name of a coordinate or a polynomial, and options of `Event`."""
    names = coordinates_of(system)
    if not names:
        raise ValueError(f"an event of a file needs coordinates; the states of {system.unforced.name} are matrices")
    options = dict(table)
    g = options.pop("g")
    if isinstance(g, str) and g not in names:
        g = parse_polynomial(g, system.dim, names)
    elif isinstance(g, list):
        g = parse_polynomial(g, system.dim)
    elif not isinstance(g, str):
        g = read_integer(g, "g", 0, system.dim - 1)
    return Event(g, name=name, **options)


def event_record(events: Sequence[Event], names: Sequence[str]) -> tuple[str, list[str]]:
    """Return events as JSON, and the names of events whose g is a function; these have a null g."""
    tables, missing = {}, []
    for event, name in zip(events, names, strict=True):
        g: Any = event.g
        if isinstance(g, Polynomial):
            text = plain(g.monomials, default_names(g.dim))
            # A coordinate alone would be read as a name, which may be that of another coordinate of the system.
            g = invariants_record({name: g})[name] if text in default_names(g.dim) else text
        if isinstance(g, Quadratic):
            g = invariants_record({name: g})[name]
        if not isinstance(g, int | str | dict | list):
            missing.append(name)
            g = None
        tables[name] = {"g": g, "direction": event.direction, "count": event.count, "terminal": event.terminal}
    return json.dumps(tables), missing


def variables_of(events: RecordedEvents) -> dict[str, Any]:
    """Return crossings as variables of a dataset, over ``crossing``."""
    dims = ("crossing",)
    variables: dict[str, Any] = {
        "event_time": (dims, events.t, cf_attributes("time of a crossing")),
        "event_x": ((*dims, *state_dimensions(events.x, 1)), split_complex(events.x), cf_attributes("momentum there")),
        "event_which": (dims, events.which, {"long_name": "number of the event"}),
        "event_member": (dims, events.member, {"long_name": "member that crosses"}),
        "event_direction": (dims, events.direction, {"long_name": "1 where g rises, -1 where it falls"}),
    }
    if events.attitude is not None:
        variables["event_attitude"] = ((*dims, "row", "column"), events.attitude, cf_attributes("group element there"))
    return variables


def not_stored(x: NDArray[Any], t: float) -> float:
    """Raise an error in place of the function of an event, which datasets do not contain."""
    raise ValueError("the function of this event was not stored; give the events again")


def events_of(entry: Entry, system: Any) -> tuple[Event, ...]:
    """Parse the events of `event_record`, with `not_stored` for functions; ValueError if damaged."""
    events = []
    with as_value_errors(entry):
        for name, table in json.loads(entry.text()).items():
            if table["g"] is None:
                events.append(Event(**{**table, "g": not_stored}, name=name))
            elif isinstance(table["g"], dict):
                g = invariants_of(Entry({name: table["g"]}, entry.path), system.dim)[name]
                events.append(Event(**{**table, "g": g}, name=name))
            else:
                events.append(event_of_file(name, table, system))
    return tuple(events)
