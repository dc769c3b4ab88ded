"""Functions that must be given again to resume a run; an archive stores only their fingerprints."""

from __future__ import annotations

import json
import platform
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from coadjoint.files.archives.archive import ArchiveError
from coadjoint.files.records.entries import EXACT, INTEGRAL, parsed
from coadjoint.files.records.reconstruction import invariants_of
from coadjoint.files.records.records import functions_among, invariants_record, record_of
from coadjoint.kernels.functions.contents import contents_of
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import check_observe
from coadjoint.runs.results.solution import Solution
from coadjoint.short_repr import short
from coadjoint.systems.lie_poisson import LiePoissonSystem

FUNCTIONS_ATTRIBUTE, OBSERVED_ATTRIBUTE = "archive_given", "archive_observed"


def function_attributes(prepared: PreparedRun) -> dict[str, str]:
    """Return the attributes with the observed quantities and the fingerprints of functions."""
    observed, fingerprints = prepared.observe, {}
    functions = functions_in(prepared.system)
    if functions:
        fingerprints["system"] = {"named": functions, **fingerprint_of(system_contents(prepared.system))}
    functional_quantities = functions_among(observed)
    if functional_quantities:
        fingerprints["observe"] = {"named": functional_quantities, **fingerprint_of(observed)}
    return {
        FUNCTIONS_ATTRIBUTE: json.dumps(fingerprints),
        OBSERVED_ATTRIBUTE: json.dumps({"names": list(observed), "stored": invariants_record(observed)}),
    }


def requires_argument(attributes: Mapping[str, Any], what: str) -> bool:
    """Whether `what`, the system or the observed quantities, contains functions and must be given to resume."""
    return what in json.loads(attributes[FUNCTIONS_ATTRIBUTE])


def observed_again(archive: Solution, system: Any, observe: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the observed quantities of a resumed run; ArchiveError if one is missing, or they or the system differ."""
    path, attributes = archive.path, archive.attributes
    fingerprints = json.loads(attributes[FUNCTIONS_ATTRIBUTE])
    observed = json.loads(attributes[OBSERVED_ATTRIBUTE])
    if system is not None:
        _check(path, "system", system_contents(system), fingerprints, system)
        if json.loads(json.dumps(record_of(system))) != json.loads(attributes["system"]):
            raise ArchiveError(f"{path}: system is {short(system)}, but the run has {attributes['system_repr']}")
    elif "system" in fingerprints:
        raise _missing(path, "system", fingerprints)
    if observe is not None:
        observe = check_observe(observe)
        if list(observe) != observed["names"]:
            raise ArchiveError(f"{path}: the run observes {observed['names']}, but observe has {list(observe)}")
        _check(path, "observe", observe, fingerprints, observe)
        records = json.loads(json.dumps(invariants_record(observe)))  # functions have none
        changed = [name for name in observe if records.get(name) != observed["stored"].get(name)]
        if changed:
            raise ArchiveError(
                f"{path}: observe[{short(changed[0])}] is {short(observe[changed[0]])}, which differs from "
                "that of the run; omit observe, or give the same quantity"
            )
    elif "observe" in fingerprints:
        raise _missing(path, "observe", fingerprints)
    else:
        dim = archive.inputs()["system"].dim if observed["names"] else 0
        stored = invariants_of(parsed(json.dumps(observed["stored"]), OBSERVED_ATTRIBUTE), dim)
        observe = {name: stored[name] for name in observed["names"]}
    return dict(observe)


def _check(path: Path | str, what: str, contents: Any, stored: Mapping[str, Any], argument: Any) -> None:
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


def _missing(path: Path | str, what: str, stored: Mapping[str, Any]) -> ArchiveError:
    named = short(", ".join(stored[what]["named"]))[1:-1]
    return ArchiveError(
        f"{path}: the run uses functions, which are not stored ({named}); give them by co.resume(path, {what}=...)"
    )


def fingerprint_of(value: Any) -> dict[str, Any]:
    """Return a fingerprint of a value and of everything its functions read, for `same_fingerprint`."""
    contents, written = contents_of(value), contents_of(value, written=True)
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "contents": contents.digest,
        "unknown": list(contents.unknown),
        "written": written.digest if written.unknown == contents.unknown else None,
    }


def same_fingerprint(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether two values and all their functions read are equal, by bytecode or, if Python differs, source text."""
    if not {"python", "contents", "written"} <= first.keys() & second.keys():
        return False
    compared = "contents" if first["python"] == second["python"] else "written"
    return first[compared] is not None and bool(first[compared] == second[compared])


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
