"""A file with unknown keys or wrong values: what in it can still be looked at, so that its other mistakes are told?"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from coadjoint.errors import nearest
from coadjoint.methods import registry
from coadjoint.systems.ready_made import ready_made_systems

if TYPE_CHECKING:
    from pydantic import ValidationError

    from coadjoint.files.configuration_models import File

IN_PLACE: Mapping[str, Any] = {"run": {"t_span": [0.0, 1.0], "step": 1.0}, "initial": {"x": "unread.npy"}}
"""What stands for a table that must be there and cannot be read; it is not looked at."""
OF_SYSTEM = frozenset({"name", "sign", "system", "algebra", "hamiltonian", "casimirs", "forces"})


@dataclass(frozen=True)
class Readable:
    """What can be read of a file.

    Parameters
    ----------
    file : File or None
        Its tables. A misspelled key stands there under the nearest known name.
    said : tuple of str
        What is wrong: the dotted path of each key, and the reason.
    unread : frozenset of str
        The tables and keys at the top that cannot be read, and are not to be looked at.
    """

    file: File | None
    said: tuple[str, ...] = ()
    unread: frozenset[str] = frozenset()

    @property
    def has_system(self) -> bool:
        """Whether everything of which the system is made can be read."""
        return not self.unread & OF_SYSTEM

    def has(self, table: str) -> bool:
        """Whether a table can be read."""
        return table not in self.unread


def readable(raw: Mapping[str, Any]) -> Readable:
    """Return what can be read of the tables of a file, and what is wrong with the rest.

    Parameters
    ----------
    raw : mapping
        The file as dictionaries and lists.

    Returns
    -------
    Readable

    Examples
    --------
    >>> found = readable({"initial": {"x": [1.0]}, "run": {"t_span": [0, 1], "stpe": 0.1}, "method": {"name": 3}})
    >>> found.said, found.file.run.step
    (("run.stpe: unknown key; did you mean 'step'?",), 0.1)
    """
    from pydantic import ValidationError

    from coadjoint.files.configuration_models import File, all_errors

    said: list[str] = []
    unread: set[str] = set()
    rest = _with_known_parameters(raw, said)
    file = None
    # Once as it is written, once with its unknown keys mended, once without the tables that cannot be read.
    for _ in range(3):
        try:
            file = File.model_validate(rest)
            break
        except ValidationError as error:
            said += all_errors(error)
            rest, wrong = _mended(rest, error)
            unread |= wrong
    return Readable(file, tuple(dict.fromkeys(said)), frozenset(unread))


def _with_known_parameters(raw: Mapping[str, Any], said: list[str]) -> Mapping[str, Any]:
    """Return the tables with the parameters of the system and of the scheme under names that these have."""
    system, method = raw.get("system"), raw.get("method")
    known: dict[tuple[str, ...], Iterable[str]] = {}
    if isinstance(system, Mapping) and isinstance(name := system.get("name"), str) and name in ready_made_systems():
        known["system", "parameters"] = inspect.signature(ready_made_systems()[name]).parameters
    if isinstance(method, Mapping) and isinstance(name := method.get("name"), str) and name in registry.names():
        known["method",] = (*registry.parameters_of(name), "name", "parameters")
    from coadjoint.files.configuration_models import unknown_key

    for place, names in known.items():
        table = _at(raw, place)
        if not isinstance(table, Mapping):
            continue
        for key in [key for key in table if key not in names]:
            told = [name for name in names if place != ("method",) or name not in ("name", "parameters")]
            said.append(f"{'.'.join(place)}.{key}: {unknown_key(key, told)}")
            raw = _renamed(raw, (*place, key), names)
    return raw


def _mended(raw: Mapping[str, Any], error: ValidationError) -> tuple[Mapping[str, Any], set[str]]:
    """Return tables without what an error refuses, and the names of those that stand there no more."""
    from coadjoint.files.configuration_models import known_keys

    unread: set[str] = set()
    for entry in error.errors():
        place = tuple(str(key) for key in entry["loc"])
        if entry["type"] == "extra_forbidden":
            raw = _renamed(raw, place, known_keys(place[:-1]))
        elif place:
            unread.add(place[0])
    kept = {key: value for key, value in raw.items() if key not in unread}
    return {**kept, **{key: IN_PLACE[key] for key in unread if key in IN_PLACE}}, unread


def _at(raw: Any, place: Iterable[str]) -> Any:
    for key in place:
        raw = raw.get(key) if isinstance(raw, Mapping) else None
    return raw


def _renamed(raw: Mapping[str, Any], place: tuple[str, ...], known: Iterable[str]) -> Mapping[str, Any]:
    """Return tables with an unknown key under the nearest known name, or without it, if there is none that is free."""
    key = place[0]
    if len(place) > 1:
        return {**raw, key: _renamed(raw[key], place[1:], known)}
    near = nearest(key, known)
    if near is None or near in raw:
        return {name: value for name, value in raw.items() if name != key}
    return {near if name == key else name: value for name, value in raw.items()}
