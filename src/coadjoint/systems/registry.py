"""Registry of ready-made systems: functions in files of `FOLDERS`, registered by a decorator."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from functools import cache, wraps
from inspect import Parameter, signature
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.sampled_checks import VALID
from coadjoint.errors import check_name_is_free
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import GalleryEntry
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.validation import set_fields

Builder = TypeVar("Builder", bound=Callable[..., Any])

FOLDERS = ("bodies", "fluids", "lattices", "examples")


class DeclaredEnergy(NamedTuple):
    """A function from parameters, by name, to the energy; it may need `others` of the arguments of the builder."""

    function: Callable[..., Any]
    parameters: tuple[str, ...]
    others: tuple[str, ...]
    symmetric: tuple[str, ...]
    potential: Callable[..., FunctionOfConstants] | None

    def chosen(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        return {name: arguments[name] for name in (*self.parameters, *self.others)}


_REGISTRY: dict[str, Callable[..., Any]] = {}
_ENERGIES: dict[str, DeclaredEnergy] = {}
_GALLERY_ENTRIES: dict[str, GalleryEntry] = {}
_UNITS: dict[str, tuple[str, ...]] = {}
UNIT_TOLERANCE = 2.0**-40  # deviation of a coordinate from 1 that is taken for rounding, as of a mean of states


@overload
def ready_made(function: Builder) -> Builder: ...


@overload
def ready_made(
    *,
    gallery_entry: GalleryEntry | None = None,
    energy: Callable[..., Any] | None = None,
    potential: Callable[..., FunctionOfConstants] | None = None,
    symmetric: tuple[str, ...] = (),
    unit: str | tuple[str, ...] = (),
    coordinates: Mapping[str, tuple[str, str]] | None = None,
) -> Callable[[Builder], Builder]: ...


@suggest_keywords
def ready_made(
    function: Any = None,
    *,
    gallery_entry: GalleryEntry | None = None,
    energy: Callable[..., Any] | None = None,
    potential: Callable[..., FunctionOfConstants] | None = None,
    symmetric: tuple[str, ...] = (),
    unit: str | tuple[str, ...] = (),
    coordinates: Mapping[str, tuple[str, str]] | None = None,
) -> Any:
    """Register a function that makes a system without forces, under its own name.

    Parameters
    ----------
    function : callable
        The decorated function.
    gallery_entry : GalleryEntry, optional
        Example run and pictures of the system, used by `Solution.plot` and ``coadjoint gallery``.
    energy : callable, optional
        The energy as a plain function, by which runs are differentiated: its positional arguments are the parameters,
        arguments of `function` in arrays of real or complex numbers, and its keyword-only ones are others on which the
        energy depends, as in the ``parameters`` of the system. It returns the arguments of `Quadratic`, M as (n,) or
        (n, n), in a tuple, or a mapping from exponents to coefficients, as for `Polynomial`. It is analytic, validates
        nothing, and may raise ValueError where arguments are tied to each other.
    potential : callable, optional
        A function of the arguments of `energy` that returns a `FunctionOfConstants`, which is added to it: what is not
        a polynomial. Its constants are analytic functions of the parameters.
    symmetric : tuple of str, optional
        Parameters that must be symmetric where they are matrices.
    unit : str or tuple of str, optional
        Casimirs that must be 1 in every initial state, where the system has them: the first one may be a coordinate,
        such as the central one beside canonical pairs; others are squared lengths, ``"|x|^2"`` those of all copies.
    coordinates : mapping, optional
        Kind and unit of coordinates, by their names without numbers, see ``layout`` of `LiePoissonSystem`; by default
        all are momenta.

    Returns
    -------
    callable
        The function itself; without it, a decorator.

    Raises
    ------
    TypeError
        `gallery_entry` is not a `GalleryEntry`, or `energy` is not a function of arguments of `function`.
    ValueError
        Another ready-made system has this name.
    """
    if not isinstance(gallery_entry, GalleryEntry | None):
        raise TypeError(f"gallery_entry is {short(gallery_entry)}; give a coadjoint.systems.gallery_entry.GalleryEntry")
    if energy is not None and not callable(energy):
        raise TypeError(f"energy is {short(energy)}; give a function of the parameters")

    def register(builder: Builder) -> Builder:
        of_library = builder.__module__.startswith("coadjoint.systems.")

        @wraps(builder)
        def hamiltonian(*args: Any, **keywords: Any) -> Any:
            valid = VALID.set(of_library)
            try:
                system = builder(*args, **keywords)
            finally:
                VALID.reset(valid)
            if system.forces:
                raise TypeError(
                    f"{builder.__name__} has forces, and its parameters would not make it again; return the "
                    "Hamiltonian part, to which users add forces by with_forces"
                )
            if system.name != builder.__name__:
                raise TypeError(f"{builder.__name__} returns a system named {system.name!r}; give it its own name")
            if coordinates:
                own = system.layout.get("coordinates", {})
                set_fields(system, _layout=system.layout | {"coordinates": {**coordinates, **own}})
            return system

        wrapped = suggest_keywords(hamiltonian)
        check_name_is_free("ready-made system", builder.__name__, builder, _REGISTRY.get(builder.__name__))
        _REGISTRY[wrapped.__name__] = wrapped
        if gallery_entry is not None:
            _GALLERY_ENTRIES[wrapped.__name__] = gallery_entry
        if energy is not None:
            _ENERGIES[wrapped.__name__] = _declared(builder, energy, symmetric, potential)
        if unit:
            _UNITS[wrapped.__name__] = (unit,) if isinstance(unit, str) else unit
        return cast(Builder, wrapped)

    return register if function is None else register(function)


def _declared(
    builder: Callable[..., Any],
    energy: Callable[..., Any],
    symmetric: tuple[str, ...],
    potential: Callable[..., FunctionOfConstants] | None,
) -> DeclaredEnergy:
    """Return the declaration of an energy; raise TypeError unless its arguments are those of the builder."""
    arguments, known = signature(energy).parameters, signature(builder).parameters
    others = tuple(name for name, one in arguments.items() if one.kind is Parameter.KEYWORD_ONLY)
    names = tuple(name for name in arguments if name not in others)
    unknown = [name for name in arguments if name not in known] + [name for name in symmetric if name not in names]
    if unknown:
        raise TypeError(f"energy of {builder.__name__} has {unknown[0]}, which is none of its arguments")
    return DeclaredEnergy(energy, names, others, tuple(symmetric), potential)


def energy_of(name: str) -> DeclaredEnergy | None:
    """Return the declared energy of a ready-made system; None for any other system, or if it declares none."""
    ready_made_systems()
    return _ENERGIES.get(name)


def has_units(system: Any) -> bool:
    """Return whether Casimirs of the states of this ready-made system must be 1."""
    return system.name in _UNITS


def unit_coordinate(system: Any) -> int | None:
    """Return the number of the coordinate that must be 1 in every state of this ready-made system; None without one."""
    casimir = system.casimirs.get(_UNITS[system.name][0]) if has_units(system) else None
    return None if casimir is None else int(np.argmax(np.abs(casimir.gradient(np.zeros(system.dim)))))


def check_units(system: Any, states: npt.NDArray[np.float64]) -> None:
    """Raise ValueError if a Casimir of states (..., n) must be 1 in this ready-made system, and is not."""
    coordinate = unit_coordinate(system)
    if coordinate is not None:
        wrong = ~(np.abs(states[..., coordinate] - 1.0) <= UNIT_TOLERANCE)
        if wrong.any():
            raise ValueError(
                f"x0[..., {coordinate}] is {states[..., coordinate][wrong].flat[0]:.15g}, and "
                f"{_UNITS[system.name][0]} of {system.name} must be 1; set this coordinate, by which positions and "
                "momenta are canonical pairs, to 1"
            )
    for name in system.casimirs if len(_UNITS.get(system.name, ())) > 1 else ():
        if name.partition(" [")[0] in _UNITS[system.name][1:]:
            values = np.asarray(system.casimirs[name](states))
            wrong = ~(np.abs(values - 1.0) <= UNIT_TOLERANCE)
            if wrong.any():
                raise ValueError(
                    f"{name} of x0 is {values[wrong][0]:.15g}, and must be 1 in {system.name}; give unit vectors"
                )


def ready_made_systems() -> Mapping[str, Callable[..., Any]]:
    """Return all ready-made systems by name; imports every file of `FOLDERS`."""
    _import_folders()
    return MappingProxyType(_REGISTRY)


@cache
def _import_folders() -> None:
    for folder in FOLDERS:
        package = importlib.import_module(f"coadjoint.systems.{folder}")
        for module in pkgutil.iter_modules(package.__path__):
            importlib.import_module(f"{package.__name__}.{module.name}")


def gallery_entry_of(name: str) -> GalleryEntry | None:
    """Return the example run and pictures of a ready-made system; None for any other system, or if it declares none."""
    ready_made_systems()
    return _GALLERY_ENTRIES.get(name)


def gallery_systems() -> tuple[str, ...]:
    """Return the names of the ready-made systems that declare an example run and pictures, sorted."""
    return tuple(name for name in sorted(ready_made_systems()) if gallery_entry_of(name) is not None)
