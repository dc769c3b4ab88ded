"""Registry of ready-made systems: each is one file in a folder of `FOLDERS`, registered by a decorator."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar, overload

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import GalleryEntry

Builder = TypeVar("Builder", bound=Callable[..., Any])

FOLDERS = ("bodies", "fluids", "lattices", "examples")

_REGISTRY: dict[str, Callable[..., Any]] = {}
_GALLERY_ENTRIES: dict[str, GalleryEntry] = {}


@overload
def ready_made(function: Builder) -> Builder: ...


@overload
def ready_made(*, gallery_entry: GalleryEntry) -> Callable[[Builder], Builder]: ...


@suggest_keywords
def ready_made(function: Any = None, *, gallery_entry: GalleryEntry | None = None) -> Any:
    """Register a function that makes a system, under its own name.

    Parameters
    ----------
    function : callable
        The decorated function.
    gallery_entry : GalleryEntry, optional
        Example run and pictures of the system, used by `Solution.plot` and ``coadjoint gallery``.

    Returns
    -------
    callable
        The function itself; with only `gallery_entry`, a decorator.

    Raises
    ------
    TypeError
        `gallery_entry` is not a `GalleryEntry`.
    """
    if not isinstance(gallery_entry, GalleryEntry | None):
        raise TypeError(f"gallery_entry is {short(gallery_entry)}; give a coadjoint.systems.gallery_entry.GalleryEntry")

    def register(builder: Builder) -> Builder:
        wrapped = suggest_keywords(builder)
        _REGISTRY[wrapped.__name__] = wrapped
        if gallery_entry is not None:
            _GALLERY_ENTRIES[wrapped.__name__] = gallery_entry
        return wrapped

    return register if function is None else register(function)


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
    """Return the example run and pictures of a ready-made system; None for any other system, or if it declares none.

    Examples
    --------
    >>> gallery_entry_of("rigid_body").attitude, gallery_entry_of("a system of mine")
    (True, None)
    """
    ready_made_systems()
    return _GALLERY_ENTRIES.get(name)


def gallery_systems() -> tuple[str, ...]:
    """Return the names of the ready-made systems that declare an example run and pictures, sorted."""
    return tuple(name for name in sorted(ready_made_systems()) if gallery_entry_of(name) is not None)
