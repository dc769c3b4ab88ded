"""Which kinds of pictures are there? A kind is one file in the folder `kinds`, and nothing else names it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from coadjoint.errors import unknown_name
from coadjoint.given import read_choice
from coadjoint.systems.telling import Picture
from coadjoint.wording import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Update = Callable[[int], None]
"""What shows another saved point in a picture that was put into axes."""
Paint = Callable[["Axes"], Update | None]
"""What puts a picture into axes; of kinds that `Kind.moves` it returns what shows another time."""
Prepare = Callable[..., Paint]
"""A function of a `coadjoint.pictures.drawn.Drawn` and options that returns a `Paint`."""


class CannotShow(ValueError):
    """A run cannot show a picture; the message says what is missing and what would be right."""


@dataclass(frozen=True)
class Kind:
    """A kind of picture.

    Parameters
    ----------
    name : str
        Its name.
    prepare : callable
        ``prepare(drawn, **options)`` returns the function that draws into axes. It raises `CannotShow` where the run
        has not what is shown.
    over_time : bool
        Whether it is wide and low, over time: such panels stand one over the other.
    projection : str or None
        Of the axes, as Matplotlib calls it.
    low : bool
        Whether two of the kind are drawn one over the other, where others have a column of their own.
    moves : bool
        Whether it is drawn at one time, and can show another one: movies are made of it.
    """

    name: str
    prepare: Prepare
    over_time: bool = False
    projection: str | None = None
    low: bool = False
    moves: bool = False

    def check(self, picture: Picture) -> None:
        """Refuse options that this kind does not have.

        Parameters
        ----------
        picture : Picture
            Of this kind.

        Raises
        ------
        ValueError
            With the nearest option that there is.
        """
        known = list(inspect.signature(self.prepare).parameters)[1:]
        for option in picture.options:
            if option not in known:
                if not known:
                    raise ValueError(f"a picture of the kind {self.name!r} takes no options, and was given {option!r}")
                raise unknown_name(f"option of the picture {self.name!r}", option, known)


_FOUND: dict[str, Kind] = {}


def kind(
    name: str, *, over_time: bool = False, projection: str | None = None, low: bool = False, moves: bool = False
) -> Callable[[Prepare], Prepare]:
    """Register a function that prepares a picture, as a kind.

    Parameters
    ----------
    name : str
        By which systems and `Solution.plot` ask for it.
    over_time, projection, low, moves
        As for `Kind`.

    Returns
    -------
    callable
        A decorator, which returns the function itself.
    """

    def register(prepare: Prepare) -> Prepare:
        _FOUND[name] = Kind(name, prepare, over_time, projection, low, moves)
        return prepare

    return register


def kinds() -> Mapping[str, Kind]:
    """Return all kinds by name; every file of the folder `kinds` is imported for it.

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
    return MappingProxyType(dict(sorted(_FOUND.items())))


def read_picture(given: Any) -> tuple[Kind, Picture]:
    """Return the kind of a picture, and the picture; refuse what is none.

    Parameters
    ----------
    given : str or Picture
        The name of a kind, or a kind with its options.

    Returns
    -------
    Kind
    Picture

    Raises
    ------
    TypeError, ValueError
        No picture, an unknown kind, or an option that it does not have; the nearest name is given.

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
    found = known[read_choice(picture.kind, "kind of picture", known)]
    found.check(picture)
    return found, picture
