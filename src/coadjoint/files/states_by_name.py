"""Which initial state does a configuration file name? One that its system makes, such as a random vorticity."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.files.configuration_parts import ConfigurationError, section
from coadjoint.given import check_parameters, read_choice

if TYPE_CHECKING:
    from coadjoint.files.configuration_models import File, InitialTable


def check_named(name: str, file: File) -> None:
    """Refuse a state by name where no ready-made system is named.

    Parameters
    ----------
    name : str
        The file's name, for messages.
    file : File
        Its checked tables.

    Raises
    ------
    ConfigurationError
        With the key.
    """
    if file.initial.kind is not None and file.system is None:
        raise ConfigurationError(f"{name}: initial.kind: only ready-made systems have states by name; give x")


def state_by_name(name: str, given: InitialTable, system: Any) -> Any:
    """Return the initial state that a file names, or None where it names none.

    Parameters
    ----------
    name : str
        The file's name: for messages, and its folder is where a relative ``path`` begins.
    given : InitialTable
        Its table.
    system : object
        What moves. One that knows states by name lists them as ``states_by_name``, and has a method for each.

    Returns
    -------
    ndarray or None

    Raises
    ------
    ConfigurationError
        The system has no such state, with the nearest name; or the state no such parameter, or a value is wrong.
    """
    from coadjoint.files.configuration_models import unknown_key

    if given.kind is None:
        return None
    family = getattr(system, "system", system)
    with section(name, "initial.kind"):
        if not (known := getattr(family, "states_by_name", ())):
            raise ValueError(f"{family.name} has no initial states by name; give x")
        make = getattr(family, read_choice(given.kind, "initial state", known))
    parameters = inspect.signature(make).parameters
    for key in given.parameters:
        if key not in parameters:
            raise ConfigurationError(f"{name}: initial.{key}: {unknown_key(key, parameters)}")
    chosen = dict(given.parameters)
    if isinstance(chosen.get("path"), str):
        chosen["path"] = str(Path(name).parent / chosen["path"])
    with section(name, "initial"):
        required = [key for key, parameter in parameters.items() if parameter.default is inspect.Parameter.empty]
        check_parameters(given.kind, chosen, parameters, required)
        try:
            return make(**chosen)
        except OSError as reason:
            raise ValueError(f"{reason.filename or given.kind}: {reason.strerror or reason}") from None
