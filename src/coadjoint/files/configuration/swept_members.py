"""Systems and initial states of the members of a sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.files.configuration.construction import section, system_of_file
from coadjoint.files.configuration.initial_states import initial_state
from coadjoint.files.configuration.named_states import state_by_name
from coadjoint.files.configuration.sweeps import STATE_KEY, parse_key
from coadjoint.files.configuration.swept_settings import move_on_orbit
from coadjoint.memory import check_available_memory
from coadjoint.runs.start import momenta_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.system_checks import unforced

if TYPE_CHECKING:
    from collections.abc import Callable

    from coadjoint.files.configuration.models import File
    from coadjoint.files.configuration.sweeps import KeyPath, Sweep

BYTES_PER_SYSTEM = 4000


def swept_system(sweep: Sweep, file: File, checked: Callable[[dict[str, Any]], File]) -> Any:
    """Return the common system of all members, or a `Batch` if the sweep changes it.

    `file` is the first member; `checked` validates the tables of a member.
    """
    axes = sweep.axes_of(_is_system_key)
    if not axes:
        return system_of_file(sweep.name, file)
    with section(sweep.name, "sweep.over"):
        check_available_memory(BYTES_PER_SYSTEM * sweep.members, f"a sweep of {sweep.members} systems")
    found = sweep.each(axes, lambda member: system_of_file(sweep.name, checked(sweep.member_tables(member))))
    with section(sweep.name, "sweep.over"):
        return Batch(found)


def _is_system_key(place: KeyPath) -> bool:
    return place[0] != "initial"


def swept_states(sweep: Sweep, file: File, system: Any, checked: Callable[[dict[str, Any]], File]) -> Any:
    """Return the initial states of the members, (members, ...), as `integrate` takes them."""
    name = sweep.name
    systems = list(system) if isinstance(system, Batch) else [system] * sweep.members
    if file.initial.kind is not None:
        return np.stack(
            sweep.each(
                list(range(len(sweep.axes))),
                lambda member: state_by_name(name, checked(sweep.member_tables(member)).initial, systems[member]),
            )
        )
    with section(name, "initial.x"):
        base = np.asarray(initial_state(systems[0], file.initial.x, Path(name).parent))
        if not momenta_of(systems[0], base)[1]:
            raise ValueError(
                f"x0 has the shape {base.shape}, already an ensemble; give one state, and sweep over 'initial.x'"
            )
        check_available_memory(3 * base.nbytes * sweep.members, f"the states of {sweep.members} members")
    states = np.repeat(base[None] if base.dtype.kind == "c" else base[None].astype(np.float64), sweep.members, axis=0)
    for axis, numbers in zip(sweep.axes, sweep.numbers.T, strict=True):
        for place, settings in axis.settings.items():
            if parse_key(place)[:2] != STATE_KEY:
                continue
            with section(name, f"sweep.over.{place}"):
                _set(states, place, settings, numbers, systems, place in sweep.orbits)
    return states


def _set(states: Any, place: str, settings: Any, numbers: Any, systems: list[Any], orbit: bool) -> None:
    """Set a key of the states of all members."""
    keys = parse_key(place)
    if orbit:
        for member, system in enumerate(systems):
            algebra = unforced(system).algebra
            if getattr(algebra, "triples", None) is None:
                raise ValueError(f"{system.name} has no algebra with structure constants; sweep over values instead")
            states[member] = move_on_orbit(algebra, states[member], settings[numbers[member]])
        return
    given = initial_state(systems[0], settings, Path()) if keys == STATE_KEY else settings
    array = np.asarray(given)
    if array.dtype.kind not in "iufc" or array.shape[1:] != states[(0, *keys[2:])].shape:
        raise ValueError(f"each setting must be of shape {states[(0, *keys[2:])].shape}, of numbers")
    states[(slice(None), *keys[2:])] = array[numbers]
