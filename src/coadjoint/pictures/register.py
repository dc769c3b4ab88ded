"""Registry of the kinds of pictures, which are functions in the files of the folder `kinds`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from coadjoint.errors import check_name_is_free, unknown_name
from coadjoint.keyword_hints import suggest_keywords, unknown_picture
from coadjoint.short_repr import short
from coadjoint.systems.coordinates import number_of_coordinate
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_integer

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
    stacked; two `low` pictures share a column (a function of the run, if it depends on that). `projection` is that of
    Matplotlib axes. Kinds with `moves` can be updated to another time for movies; those with an option `at` show a
    single time. ``help`` of a kind explains its options.
    """

    name: str
    prepare: Prepare = field(repr=False)
    over_time: bool = False
    projection: str | None = None
    low: bool | Callable[[Any], bool] = False
    moves: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "__doc__", f"{self.usage}\n\n{inspect.getdoc(self.prepare)}")

    @property
    def options(self) -> Mapping[str, inspect.Parameter]:
        return MappingProxyType(dict(list(inspect.signature(self.prepare).parameters.items())[1:]))

    @property
    def usage(self) -> str:
        """A `Picture` of this kind with all options and their default values; those without one are needed."""
        options = (
            name if option.default is inspect.Parameter.empty else f"{name}={option.default!r}"
            for name, option in self.options.items()
        )
        return f"Picture({', '.join([repr(self.name), *options])})"

    @property
    def shows_one_time(self) -> bool:
        """Whether the picture shows a single time, given by the option `at`."""
        return "at" in self.options

    def is_low(self, drawn: Any) -> bool:
        return self.low(drawn) if callable(self.low) else self.low

    def check(self, picture: Picture) -> None:
        """Raise ValueError for options that this kind does not have, and CannotShow without those that it needs."""
        known = list(self.options)
        for option in picture.options:
            if option not in known:
                if not known:
                    raise ValueError(f"a picture of the kind {self.name!r} takes no options, and was given {option!r}")
                raise unknown_name(f"option of the picture {self.name!r}", option, known)
        needed = [name for name, option in self.options.items() if option.default is inspect.Parameter.empty]
        missing = [name for name in needed if name not in picture.options]
        if missing:
            example = ", ".join(f"{name}=..." for name in needed)
            raise CannotShow(
                f"the picture {self.name!r} needs {' and '.join(missing)}, which this system does not declare; give "
                f"co.plotting.Picture({self.name!r}, {example}), and see help(co.plotting.kinds()[{self.name!r}])"
            )


_KINDS: dict[str, Kind] = {}
KINDS_PACKAGE = "coadjoint.pictures.kinds"


@suggest_keywords
def kind(
    name: str,
    *,
    over_time: bool = False,
    projection: str | None = None,
    low: bool | Callable[[Any], bool] = False,
    moves: bool = False,
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

    Raises
    ------
    ValueError
        Another kind has this name.
    """

    def register(prepare: Prepare) -> Prepare:
        if not prepare.__module__.startswith(KINDS_PACKAGE):
            kinds()  # names of the library are taken
        check_name_is_free("kind of picture", name, prepare, _KINDS[name].prepare if name in _KINDS else None)
        _KINDS[name] = Kind(name, prepare, over_time, projection, low, moves)
        return prepare

    return register


@suggest_keywords
def kinds() -> Mapping[str, Kind]:
    """Return all kinds by name, after importing the files of the folder `kinds`.

    Returns
    -------
    mapping of str to Kind

    Examples
    --------
    >>> list(kinds()["body axis"].options)
    ['axis', 'up', 'vertical', 'view']
    """
    package = importlib.import_module(KINDS_PACKAGE)
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return MappingProxyType(dict(sorted(_KINDS.items())))


def read_picture(given: Any) -> tuple[Kind, Picture]:
    """Return the kind of a picture and the picture, from a name or a `Picture`."""
    if not isinstance(given, str | Picture):
        raise TypeError(f"a panel is {short(given)}; give the name of a kind of picture, or a Picture")
    picture = Picture(given) if isinstance(given, str) else given
    known = kinds()
    if picture.kind not in known:
        raise unknown_picture(picture.kind, known)
    kind = known[picture.kind]
    kind.check(picture)
    return kind, picture


def coordinate_index(names: Sequence[str], chosen: Any) -> int:
    """Return the index of a coordinate given by number or name."""
    if isinstance(chosen, str):
        return number_of_coordinate(names, chosen)
    return read_integer(chosen, "a coordinate", 0, len(names) - 1)
