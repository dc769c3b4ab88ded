"""Fingerprints of functions, by which archives identify them."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from typing import Any, cast

from coadjoint.files.records.entries import EXACT, INTEGRAL
from coadjoint.files.records.records import record_of
from coadjoint.kernels.functions.contents import contents_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem


def fingerprint_of(value: Any) -> dict[str, Any]:
    """Return a fingerprint of a value and of everything its functions read, for `same_fingerprint`.

    Examples
    --------
    >>> def times(a):
    ...     return lambda x: a * x
    >>> first, second, third = (fingerprint_of(times(a)) for a in (1.0, 2.0, 1.0))
    >>> same_fingerprint(first, second), same_fingerprint(first, third)
    (False, True)
    """
    contents, written = contents_of(value), contents_of(value, written=True)
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "contents": contents.digest,
        "unknown": list(contents.unknown),
        "written": written.digest if written.unknown == contents.unknown else None,
    }


def same_fingerprint(first: Mapping[str, Any], second: Mapping[str, Any]) -> bool:
    """Whether two values, including everything their functions read, are equal.

    Bytecode is compared if the version of Python is the same, otherwise source text; functions without text are
    unequal.
    """
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
    if isinstance(system, Batch):
        return [system_contents(member) for member in system.distinct]
    if system.forces:
        forces = [[type(force).__name__, force, dict(force.parameters())] for force in system.forces]
        return [system_contents(system.unforced), forces]
    if system.parameters is not None:
        return [system.name, dict(system.parameters)]
    if isinstance(system, MatrixSystem):
        streams = (system.stream, system.second_stream)
        functions = [getattr(stream, "function", stream) for stream in streams]
        return [record_of(cast(Any, system)), functions, system.energy_function]
    contents = [system.name, system.sign, list(system.hamiltonian.terms()), dict(system.casimirs)]
    if isinstance(system, LiePoissonSystem):
        return [record_of(system), *contents]
    return [*contents, system.structure_function or system]
