"""Checks of archives: of untrusted metadata before use, and of functions that are given again to resume a run."""

from __future__ import annotations

import json
import platform
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.archives.archive import (
    BLOCK_SIZE_ATTRIBUTE,
    FINISHED,
    FIRST_STEP,
    FORMAT,
    RUN,
    SAVE_EVERY,
    STATES,
    STATUS,
    STEPS,
    VERSION_ATTRIBUTE,
    WORK_INTEGRALS_ATTRIBUTE,
    Archive,
    is_computed,
)
from coadjoint.files.archives.folder import ArchiveError, reading
from coadjoint.files.archives.stored_arrays import StoredArray
from coadjoint.files.datasets.export import ENDED_ATTRIBUTE
from coadjoint.files.datasets.named_axes import MEMBER, stored_axes
from coadjoint.files.datasets.variables import SIZES, TIME
from coadjoint.files.records.entries import EXACT, INTEGRAL, Entry, parsed
from coadjoint.files.records.reconstruction import events_of, invariants_of
from coadjoint.files.records.records import event_record, functions_among, invariants_record, record_of
from coadjoint.kernels.functions.contents import contents_of
from coadjoint.runs.crossings import names_of
from coadjoint.runs.events import Event, read_events
from coadjoint.runs.piecewise_run import STATE_PREFIX
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import check_observe
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.times import Times, times_of
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import coordinates_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import is_real

FUNCTIONS_ATTRIBUTE, OBSERVED_ATTRIBUTE, EVENTS_ATTRIBUTE = "archive_given", "archive_observed", "events"
"""Attributes with the fingerprints of functions, with the observed quantities, and with the events."""
TEXT_ATTRIBUTES = ("system_repr", "method_repr", "coadjoint_version", "platform", "attitude_carried", FIRST_STEP)
SUMMARY_ARRAYS = ({"drift"}, {"change", "balance", "work"})
"""Arrays over the invariants, of a run without forces and with them."""
ARRAY_TYPES = {"invariant": "string", "failed": "bool", STATUS: "int64", "tenth": "int64"}
FLOAT_ARRAYS = (TIME, "x", "x0", "attitude", "attitude0", "energy", "drift", "change", "balance", "work", SIZES)
VARYING_DIMENSIONS = ("row", "column", "layer")
"""Dimensions whose length may differ between arrays."""
SERIES_PREFIXES, CROSSING_PREFIX = ("casimir_", "observed_"), "event_"
RESERVED_NAMES = frozenset(
    {*FLOAT_ARRAYS, *ARRAY_TYPES, *VARYING_DIMENSIONS, "part", "component", "account", "crossing"}
)
"""Names that have a meaning in archives and datasets, beside those that begin with `SERIES_PREFIXES` or
`CROSSING_PREFIX`.
"""


def check_archive(archive: Archive) -> None:
    """Raise `ArchiveError` unless attributes and arrays describe one run, or one ensemble."""
    arrays, attributes = archive.arrays, archive.attributes
    with reading(archive.folder, "the archive"):
        entry = Entry(attributes, "attributes")
        is_bound = attributes[VERSION_ATTRIBUTE] == FORMAT
        for name in (*TEXT_ATTRIBUTES, *((RUN,) if is_bound else ())):
            entry[name].text(sys.maxsize)
        for name in (STEPS, "steps", "evaluations", "iterations"):
            entry[name].integer()
        for name in (FINISHED, "between_steps", "watch"):
            entry[name].flag()
        if entry["seconds"].number() < 0.0:
            raise entry["seconds"].invalid_error("a number from 0 up")
        work_integrals = [
            pair.texts(2) for pair in parsed(attributes[WORK_INTEGRALS_ATTRIBUTE], WORK_INTEGRALS_ATTRIBUTE).entries()
        ]
        functions = parsed(attributes[FUNCTIONS_ATTRIBUTE], FUNCTIONS_ATTRIBUTE).table().values()
        observed = parsed(attributes[OBSERVED_ATTRIBUTE], OBSERVED_ATTRIBUTE)
        for names in (observed["names"], *(fingerprint["named"] for fingerprint in functions)):
            names.texts()
        observed["stored"].table()
        if "run_failed" in attributes:
            entry["run_failed"].flag()
            entry["failed_step"].integer()
            for name in ("failed_time", "failed_residual"):
                if not is_real(attributes[name]):
                    raise entry[name].invalid_error("a number")
            entry["failed_reason"].text(sys.maxsize)
        span = tuple(time.number() for time in parsed(attributes["t_span"], "t_span").entries(2))
        times = times_of(span, entry["step"].number(), entry["save_every"].integer(1))
        if times.steps != attributes["steps"] or attributes[STEPS] > times.steps:
            raise entry["steps"].invalid_error(f"{times.steps}, and {STEPS} no larger")
        sizes = check_arrays(arrays, work_integrals)
        if EVENTS_ATTRIBUTE in attributes:
            parsed(attributes[EVENTS_ATTRIBUTE], EVENTS_ATTRIBUTE).table()
        if ENDED_ATTRIBUTE in attributes and (
            entry[ENDED_ATTRIBUTE].integer(1) != attributes[STEPS] or not attributes[FINISHED] or MEMBER in sizes
        ):
            raise entry[ENDED_ATTRIBUTE].invalid_error(f"{STEPS} of a finished run of one member")
        stored_axes(attributes, sizes.get(MEMBER, 1))
        if is_bound or not archive.has_blocks:
            _check_states(attributes)
        if archive.has_blocks:
            size = entry[BLOCK_SIZE_ATTRIBUTE].integer(1)
            chunks = {a.chunk[a.dims.index(MEMBER)] for name, a in arrays.items() if is_computed(name, a)}
            if not chunks <= {size}:
                raise entry[BLOCK_SIZE_ATTRIBUTE].invalid_error("the length of chunks along the members")
            if STATUS not in arrays or MEMBER not in sizes or arrays["x0"].dims[0] != MEMBER:
                raise ValueError("an array over the members is missing")
            if entry[FINISHED].flag() and attributes[STEPS] != times.steps and "run_failed" not in attributes:
                raise entry[STEPS].invalid_error(f"{times.steps}, since the ensemble is finished")
            expected = times.total_points
        else:
            entry[SAVE_EVERY].integer(1)
            expected = _expected_points(entry, archive, times, sizes[TIME])
        if not attributes["between_steps"] and sizes[TIME] != expected:
            raise ValueError(f"there are {sizes[TIME]} saved points after {attributes[STEPS]} steps, not {expected}")


def check_arrays(arrays: Mapping[str, StoredArray], work_integrals: list[list[str]]) -> dict[str, int]:
    """Validate the arrays of a run; return the lengths of the dimensions."""
    missing = {TIME, "x", "x0", "energy", "invariant", "tenth", *SUMMARY_ARRAYS[bool(work_integrals)]} - arrays.keys()
    if missing:
        raise ValueError(f"the array {min(missing)} is missing")
    sizes = dict[str, int]()
    for name, array in arrays.items():
        series = name.startswith(SERIES_PREFIXES)
        if array.kind != ("float64" if series or name in FLOAT_ARRAYS else ARRAY_TYPES.get(name, array.kind)):
            raise ValueError(f"the array {name} is of {array.kind}")
        if series and not isinstance(array.attributes.get("long_name"), str):
            raise ValueError(f"the array {name} has no long_name")
        if (series or name in ("x", "energy", "work", "attitude", TIME)) != array.grows:
            raise ValueError(f"the array {name} is over {', '.join(array.dims)}")
        for dim, size in zip(array.dims, array.shape, strict=True):
            if dim not in VARYING_DIMENSIONS and sizes.setdefault(dim, size) != size:
                raise ValueError(f"the arrays along {dim} have the lengths {sizes[dim]} and {size}")
    start, energy_dims = arrays["x0"].dims, arrays["energy"].dims
    if arrays["x"].dims != (TIME, *start) or energy_dims != (TIME, *start[: int(MEMBER in start)]):
        raise ValueError("the arrays x, x0 and energy are over other dimensions than the states of one run")
    if arrays["x"].shape[1:] != arrays["x0"].shape or not all(arrays["x0"].shape):
        raise ValueError("the arrays x and x0 have states of other shapes")
    if SIZES in arrays and arrays[SIZES].dims != (*energy_dims[1:], "invariant"):
        raise ValueError(f"the array {SIZES} is over {', '.join(arrays[SIZES].dims)}")
    if sizes.get("part", 2) != 2 or (work_integrals and sizes.get("account") != len(work_integrals)):
        raise ValueError("a dimension has a length that contradicts its meaning")
    return sizes


def _check_states(attributes: Mapping[str, Any]) -> None:
    """Validate the entries of stored states."""
    states = parsed(attributes[STATES], STATES)
    if not states.entries():
        raise states.invalid_error("a list of states, at least one")
    for state in states.entries():
        file, digest, about = state.entries(3)
        file.text(), digest.text(), about["block"].flag()
        for name in ("number", TIME):
            about[name].integer()


def _expected_points(entry: Entry, archive: Archive, times: Times, rows: int) -> int:
    """Validate the order of the stored states; return the expected number of saved points."""
    attributes, states = archive.attributes, archive.states
    numbers = [state.about["number"] for state in states]
    if numbers != sorted(numbers) or numbers[-1] != attributes[STEPS] or states[-1].about[TIME] != rows:
        raise entry[STATES].invalid_error("a list of states, of which the last one is that of the last commit")
    if ENDED_ATTRIBUTE in attributes:  # by an event in the last step, which is the last point
        return times.after(attributes[STEPS] - 1).passed + 1
    expected = times.after(attributes[STEPS]).passed
    # A failed run has saved the points before its failure.
    return min(rows, expected) if attributes.get("run_failed") else expected


def check_reported(stored: Mapping[str, NDArray[Any]], archive: Archive) -> None:
    """Raise ValueError unless the numbers of a state match the invariants of the run."""
    members, (tenths, invariants) = archive.members, (archive.arrays[name].shape[0] for name in ("tenth", "invariant"))
    # The balances of invariants that forces change follow the invariants.
    columns = max(invariants, stored["initial"].shape[-1] if stored["initial"].ndim else 0)
    shapes: dict[str, tuple[int, ...]] = {"initial": (members, columns)}
    shapes |= dict.fromkeys(("earlier", f"{STATE_PREFIX}worst"), (members, tenths, columns))
    for name, shape in shapes.items():
        if stored[name].shape != shape or stored[name].dtype != np.float64:
            raise ValueError(f"{name} of the state has the shape {stored[name].shape}; it must be {shape}")


def function_attributes(prepared: PreparedRun, events: tuple[Event, ...]) -> dict[str, str]:
    """Return the attributes with the observed quantities and the fingerprints of functions."""
    observed, fingerprints = prepared.observe, {}
    functions = functions_in(prepared.system)
    if functions:
        fingerprints["system"] = {"named": functions, **fingerprint_of(system_contents(prepared.system))}
    functional_quantities = functions_among(observed)
    if functional_quantities:
        fingerprints["observe"] = {"named": functional_quantities, **fingerprint_of(observed)}
    if functional_events := _functions_of(events, prepared.system):
        fingerprints["events"] = {"named": functional_events, **fingerprint_of([event.g for event in events])}
    return {
        FUNCTIONS_ATTRIBUTE: json.dumps(fingerprints),
        OBSERVED_ATTRIBUTE: json.dumps({"names": list(observed), "stored": invariants_record(observed)}),
    }


def requires_argument(attributes: Mapping[str, Any], what: str) -> bool:
    """Whether `what`, the system, the observed quantities or the events, has functions and is required to resume."""
    return what in json.loads(attributes[FUNCTIONS_ATTRIBUTE])


def observed_again(archive: Solution, system: Any, observe: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the observed quantities of a resumed run; ArchiveError if one is missing, or they or the system differ."""
    path, attributes = archive.path, archive.attributes
    fingerprints = json.loads(attributes[FUNCTIONS_ATTRIBUTE])
    observed = json.loads(attributes[OBSERVED_ATTRIBUTE])
    if system is not None:
        _check_same(path, "system", system_contents(system), fingerprints, system)
        if json.loads(json.dumps(record_of(system))) != json.loads(attributes["system"]):
            raise ArchiveError(f"{path}: system is {short(system)}, but the run has {attributes['system_repr']}")
    elif "system" in fingerprints:
        raise _missing_error(path, "system", fingerprints)
    if observe is not None:
        observe = check_observe(observe, archive.inputs()["system"] if observe else None)
        if list(observe) != observed["names"]:
            raise ArchiveError(f"{path}: the run observes {observed['names']}, but observe has {list(observe)}")
        _check_same(path, "observe", observe, fingerprints, observe)
        records = json.loads(json.dumps(invariants_record(observe)))  # functions have none
        changed = [name for name in observe if records.get(name) != observed["stored"].get(name)]
        if changed:
            raise ArchiveError(
                f"{path}: observe[{short(changed[0])}] is {short(observe[changed[0]])}, which differs from "
                "that of the run; omit observe, or give the same quantity"
            )
    elif "observe" in fingerprints:
        raise _missing_error(path, "observe", fingerprints)
    else:
        dim = archive.inputs()["system"].dim if observed["names"] else 0
        stored = invariants_of(parsed(json.dumps(observed["stored"]), OBSERVED_ATTRIBUTE), dim)
        observe = {name: stored[name] for name in observed["names"]}
    return dict(observe)


def events_again(archive: Solution, system: Any, events: Any) -> tuple[Event, ...]:
    """Return the events of a resumed run of a system; ArchiveError if they are missing, or differ."""
    path, attributes = archive.path, archive.attributes
    fingerprints, stored = json.loads(attributes[FUNCTIONS_ATTRIBUTE]), attributes.get(EVENTS_ATTRIBUTE)
    given = read_events(events)
    if events is not None:
        if stored is None and given:
            raise ArchiveError(f"{path}: the run has no events; omit events")
        if event_record(given, names_of(given, coordinates_of(system)), system.dim)[0] != (stored or "{}"):
            raise ArchiveError(
                f"{path}: events is {short(events)}, but the run has {short(stored)}; omit or correct it"
            )
        _check_same(path, "events", [event.g for event in given], fingerprints, events)
        return given
    if "events" in fingerprints:
        raise _missing_error(path, "events", fingerprints)
    return () if stored is None else events_of(stored, EVENTS_ATTRIBUTE, system)


def _functions_of(events: tuple[Event, ...], system: Any) -> list[str]:
    """Return the names of the events that are functions, which are not stored."""
    return event_record(events, names_of(events, coordinates_of(system)), system.dim)[1]


def _check_same(path: Path | str, what: str, contents: Any, stored: Mapping[str, Any], argument: Any) -> None:
    """Raise ArchiveError if an argument differs from the stored fingerprint."""
    if what in stored and not same_fingerprint(stored[what], fingerprint_of(contents)):
        raise ArchiveError(
            f"{path}: {what} is {short(argument)}, which differs from that of the run in its numbers, "
            f"or in the code of its functions ({short(', '.join(stored[what]['named']))[1:-1]})"
        )
    unknown = stored.get(what, {}).get("unknown", ())
    if unknown:
        warnings.warn(
            f"{path}: {what} is compared without {short(', '.join(unknown))[1:-1]}, which cannot be fingerprinted",
            UserWarning,
            stacklevel=4,
        )


def _missing_error(path: Path | str, what: str, stored: Mapping[str, Any]) -> ArchiveError:
    named = short(", ".join(stored[what]["named"]))[1:-1]
    return ArchiveError(
        f"{path}: the run uses functions, which are not stored ({named}); give them by co.resume(path, {what}=...)"
    )


def fingerprint_of(value: Any) -> dict[str, Any]:
    """Return a fingerprint of a value and of everything its functions read, for `same_fingerprint`."""
    contents, unknown = contents_of(value)
    written, unknown_in_text = contents_of(value, written=True)
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "contents": contents,
        "unknown": list(unknown),
        "written": written if unknown_in_text == unknown else None,
    }


def same_fingerprint(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether two values and all their functions read are equal, by bytecode or, if Python differs, source text."""
    if not {"python", "contents", "written"} <= first.keys() & second.keys():
        return False
    compared = "contents" if first["python"] == second["python"] else "written"
    return bool(first[compared] and first[compared] == second[compared])  # empty for values that are nested too deep


def functions_in(system: Any) -> list[str]:
    """Return the names of a system's functions that are required to resume its runs."""
    missing = record_of(system).get("not_stored", [])
    return [name for name in missing if not name.startswith((EXACT, INTEGRAL))]


def system_contents(system: Any) -> Any:
    """Return everything that defines a system, for `fingerprint_of`."""
    if system.is_batch:
        return [system_contents(member) for member in system.distinct]
    if system.forces:
        forces = [[type(force).__name__, force, dict(force.parameters())] for force in system.forces]
        return [system_contents(system.unforced), forces]
    if system.parameters is not None:
        return [system.name, dict(system.parameters)]
    if system.has_matrices:
        streams = (system.stream, system.second_stream)
        functions = [getattr(stream, "function", stream) for stream in streams]
        return [record_of(cast(Any, system)), functions, system.energy_function]
    contents = [system.name, system.sign, list(system.hamiltonian.terms()), dict(system.casimirs)]
    if isinstance(system, LiePoissonSystem):
        return [record_of(system), *contents]
    return [*contents, system.structure_function or system]
