"""Registry of the kinds of pictures; each kind is one file in the folder `kinds`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from coadjoint.errors import unknown_name
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_choice

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Update = Callable[[int], None]
"""Updates a drawn picture to another saved point."""
Paint = Callable[["Axes"], Update | None]
"""Draws a picture into axes; kinds with `Kind.moves` return an `Update`."""
Prepare = Callable[..., Paint]
"""Function of a `coadjoint.pictures.plot_data.PlottedRun` and options that returns a `Paint`."""


class CannotShow(ValueError):
    """The run lacks what a picture needs; the message names what is missing and how to provide it."""


@dataclass(frozen=True)
class Kind:
    """A kind of picture.

    ``prepare(drawn, **options)`` returns a `Paint`, or raises `CannotShow`. `over_time` panels are wide and low, and
    stacked; two `low` pictures share a column. `projection` is that of Matplotlib axes. Kinds with `moves` show a
    single time, and can be updated to another one for movies.
    """

    name: str
    prepare: Prepare
    over_time: bool = False
    projection: str | None = None
    low: bool = False
    moves: bool = False

    def check(self, picture: Picture) -> None:
        """Raise ValueError, with the nearest option, for options that this kind does not have."""
        known = list(inspect.signature(self.prepare).parameters)[1:]
        for option in picture.options:
            if option not in known:
                if not known:
                    raise ValueError(f"a picture of the kind {self.name!r} takes no options, and was given {option!r}")
                raise unknown_name(f"option of the picture {self.name!r}", option, known)


_KINDS: dict[str, Kind] = {}


def kind(
    name: str, *, over_time: bool = False, projection: str | None = None, low: bool = False, moves: bool = False
) -> Callable[[Prepare], Prepare]:
    """Register a function that prepares a picture as a kind.

    Parameters
    ----------
    name : str
        The name by which systems and `Solution.plot` refer to it.
    over_time, projection, low, moves
        The fields of `Kind`.

    Returns
    -------
    callable
        A decorator, which returns the function itself.
    """

    def register(prepare: Prepare) -> Prepare:
        _KINDS[name] = Kind(name, prepare, over_time, projection, low, moves)
        return prepare

    return register


def kinds() -> Mapping[str, Kind]:
    """Return all kinds by name, after importing the files of the folder `kinds`.

    Returns
    -------
    mapping of str to Kind

    Examples
    --------
    >>> kinds()["body axis"].over_time
    False
    """
    package = importlib.import_module("coadjoint.pictures.kinds")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return MappingProxyType(dict(sorted(_KINDS.items())))


def read_picture(given: Any) -> tuple[Kind, Picture]:
    """Return the kind of a picture and the picture, from a name or a `Picture`; the message suggests the nearest name.

    Examples
    --------
    >>> read_picture("body axes")
    Traceback (most recent call last):
    ValueError: unknown kind of picture 'body axes'; did you mean 'body axis'?
    """
    if not isinstance(given, str | Picture):
        raise TypeError(f"a panel is {short(given)}; give the name of a kind of picture, or a Picture")
    picture = Picture(given) if isinstance(given, str) else given
    known = kinds()
    kind = known[read_choice(picture.kind, "kind of picture", known)]
    kind.check(picture)
    return kind, picture
