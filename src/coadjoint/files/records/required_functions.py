"""Functions that must be given again to resume a run; an archive stores only their fingerprints."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from coadjoint.files.archives.store import ArchiveError
from coadjoint.files.records.entries import parsed
from coadjoint.files.records.fingerprints import fingerprint_of, functions_in, same_fingerprint, system_contents
from coadjoint.files.records.reconstruction import invariants_of
from coadjoint.files.records.records import STORABLE_TYPES, invariants_record, record_of
from coadjoint.runs.events import Event, read_events
from coadjoint.runs.observables import check_observe
from coadjoint.short_repr import short

if TYPE_CHECKING:
    from coadjoint.files.archives.archived_solution import ArchivedSolution
    from coadjoint.runs.prepared_run import PreparedRun

FUNCTIONS_ATTRIBUTE, OBSERVED_ATTRIBUTE = "archive_given", "archive_observed"


class ResumeArguments(NamedTuple):
    """Arguments of a resumed run: the observed quantities, and the events (None: those stored in the archive)."""

    observe: dict[str, Any]
    events: tuple[Event, ...] | None


def function_attributes(ready: PreparedRun, events: Sequence[Event]) -> dict[str, str]:
    """Return the attributes with the observed quantities and the fingerprints of functions."""
    observed, found = ready.observe, {}
    functions = functions_in(ready.system)
    if functions:
        found["system"] = {"named": functions, **fingerprint_of(system_contents(ready.system))}
    named = [name for name, given in observed.items() if not isinstance(given, STORABLE_TYPES)]
    if named:
        found["observe"] = {"named": named, **fingerprint_of(observed)}
    called = [
        event.name or str(k) for k, event in enumerate(events) if not isinstance(event.g, int | str | STORABLE_TYPES[0])
    ]
    if called:
        found["events"] = {"named": called, **fingerprint_of(list(events))}
    return {
        FUNCTIONS_ATTRIBUTE: json.dumps(found),
        OBSERVED_ATTRIBUTE: json.dumps({"names": list(observed), "stored": invariants_record(observed)}),
    }


def requires_argument(attributes: Mapping[str, Any], what: str) -> bool:
    """Whether the run of an archive needs its system, observed quantities or events given again."""
    return what in json.loads(attributes[FUNCTIONS_ATTRIBUTE])


def resume_arguments(
    path: Path, archive: ArchivedSolution, system: Any, observe: Mapping[str, Any] | None, events: Any
) -> ResumeArguments:
    """Return the arguments of a resumed run, from those given and those stored.

    ArchiveError: a function is missing, or differs from the one that the run began with.
    """
    attributes = archive.attributes
    wanted = json.loads(attributes[FUNCTIONS_ATTRIBUTE])
    observed = json.loads(attributes[OBSERVED_ATTRIBUTE])
    looked_for = None if events is None else read_events(events)
    if looked_for and "events" not in wanted:
        raise ArchiveError(f"{path}: the run has no events; omit events")
    if system is not None:
        _check(path, "system", system_contents(system), wanted, system)
        if json.loads(json.dumps(record_of(system))) != json.loads(attributes["system"]):
            raise ArchiveError(f"{path}: system is {short(system)}, and the run is one of {attributes['system_repr']}")
    elif "system" in wanted:
        raise _missing(path, "system", wanted)
    if observe is not None:
        observe = check_observe(observe)
        if list(observe) != observed["names"]:
            raise ArchiveError(f"{path}: the run observes {observed['names']}, and observe has {list(observe)}")
        _check(path, "observe", observe, wanted, observe)
        records = json.loads(json.dumps(invariants_record(observe)))  # functions have none
        changed = [name for name in observe if records.get(name) != observed["stored"].get(name)]
        if changed:
            raise ArchiveError(
                f"{path}: observe[{short(changed[0])}] is {short(observe[changed[0]])}, which is not the quantity that "
                "the run was begun with; omit observe, or give the same"
            )
    elif "observe" in wanted:
        raise _missing(path, "observe", wanted)
    else:
        dim = archive.inputs()["system"].dim if observed["names"] else 0
        stored = invariants_of(parsed(json.dumps(observed["stored"]), OBSERVED_ATTRIBUTE), dim)
        observe = {name: stored[name] for name in observed["names"]}
    if looked_for is not None:
        _check(path, "events", list(looked_for), wanted, events)
    elif "events" in wanted:
        raise _missing(path, "events", wanted)
    return ResumeArguments(dict(observe), looked_for)


def _check(path: Path, what: str, made: Any, wanted: Mapping[str, Any], given: Any) -> None:
    """Raise ArchiveError if an argument differs from the one that the run began with."""
    if what in wanted and not same_fingerprint(wanted[what], fingerprint_of(made)):
        raise ArchiveError(
            f"{path}: {what} is {short(given)}, which is not what the run was begun with: its numbers, or the code of "
            f"its functions ({short(', '.join(wanted[what]['named']))[1:-1]}), differ"
        )
    unknown = wanted.get(what, {}).get("unknown", ())
    if unknown:
        warnings.warn(
            f"{path}: {what} is compared without {short(', '.join(unknown))[1:-1]}, which cannot be fingerprinted",
            UserWarning,
            stacklevel=4,
        )


def _missing(path: Path, what: str, wanted: Mapping[str, Any]) -> ArchiveError:
    named = short(", ".join(wanted[what]["named"]))[1:-1]
    return ArchiveError(
        f"{path}: the run has functions, which are not stored ({named}); give them again: co.resume(path, {what}=...)"
    )
