"""Gallery metadata of a ready-made system: an example run and its plots, as data without Matplotlib."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import (
    read_bool,
    read_finite,
    read_integer,
    read_list,
    read_number,
    read_positive,
    read_title,
    set_fields,
)

Floats = npt.NDArray[np.float64]


@suggest_keywords
@dataclass(frozen=True, init=False)
class Picture:
    """A kind of picture, by name, with its options.

    Parameters
    ----------
    kind : str
        Such as ``"body axis"``; see below.
    **options
        Options of that kind; ``help(co.plotting.kinds()["body axis"])`` explains them.

    Notes
    -----
    The kinds and their options (those without a default are needed):

    - ``"body"``: at, axis, up, vertical, view
    - ``"angular momentum"``, ``"angular velocity"``: frame
    - ``"bodies"``: at, view
    - ``"body axis"``: axis, up, vertical, view
    - ``"coadjoint orbit"``: view
    - ``"components"``: chosen, functions, flips, quantity
    - ``"directions"``: vectors (needed), axes_named, title, view
    - ``"drift"``, ``"error"``, ``"observed"``, ``"energy by scale"``: none
    - ``"gimbal angles"``, ``"pointing error"``, ``"torques"``, ``"wheel speeds"``: none
    - ``"eigenvalues"``, ``"field spectra"``: at
    - ``"field"``: width (needed), modes or values, at, label
    - ``"nutation"``: axis, up, turns
    - ``"path in space"``: axis
    - ``"phase ellipse"``: moments or lumps, times, until, labels
    - ``"phase portrait"``: across, up, labels, cyclic, equal, title, curves
    - ``"section"``: event, components
    - ``"space-time"``: sites (needed), label (needed), across, centred, title
    - ``"sphere field"``: values (needed), at, view, label
    - ``"spins"``: at, seen
    - ``"vorticity"``: at, part, projection, centre, limit, layer

    Examples
    --------
    >>> Picture("body axis", axis=1)
    Picture('body axis', axis=1)
    """

    kind: str
    options: Mapping[str, Any]

    def __init__(self, kind: str, **options: Any) -> None:
        set_fields(self, kind=read_title(kind, "kind of a picture"), options=options)

    def __repr__(self) -> str:
        return f"Picture({', '.join([repr(self.kind), *(f'{key}={short(v)}' for key, v in self.options.items())])})"


@suggest_keywords
@dataclass(frozen=True)
class GalleryEntry:
    """Gallery metadata of a ready-made system: an example run and its pictures.

    Parameters
    ----------
    x0 : array_like, shape (n,) or (members, n), or function that returns it
        Initial state; a function if it must be computed. For systems of matrices (N, N) or (members, N, N).
    t_span : (float, float)
        Start and end.
    step : float
        A step with which the suggested scheme resolves the motion.
    caption : str
        Caption of one or two sentences that describes the picture, also used as its alternative text.
    pictures : sequence of Picture
        Pictures that `Solution.plot` draws besides components and drift. Those that a run cannot show, because of its
        dimension or without attitudes, are omitted.
    components : Picture
        The components, or functions of them, drawn over time.
    parameters : mapping
        Parameters of the system, if the defaults are less suitable.
    attitude : bool
        Whether the run computes the group element.
    save_every : int
        As for `integrate`.
    coordinates : sequence of str, or function of the dimension that returns it
        Names of the coordinates, such as ``("E", "P", "D")``; by default those of the basis.
    quantity : str
        Physical quantity of the coordinates, for the label of their axis.
    variant : callable, optional
        Function of a system of this name that returns the fields that depend on its parameters, such as ``{"pictures":
        ...}``.

    Raises
    ------
    TypeError, ValueError
        A value has the wrong type or shape.

    Examples
    --------
    >>> GalleryEntry((0.0, 1.0, 0.01), (0.0, 10.0), 0.1, "A flip.", [Picture("body axis", axis=1)]).t_span
    (0.0, 10.0)
    """

    x0: npt.ArrayLike | Callable[[], npt.ArrayLike]
    t_span: tuple[float, float]
    step: float
    caption: str
    pictures: tuple[Picture, ...] = ()
    components: Picture = Picture("components")
    parameters: Mapping[str, Any] = field(default_factory=dict)
    attitude: bool = False
    save_every: int = 1
    coordinates: tuple[str, ...] | Callable[[int], tuple[str, ...]] = ()
    quantity: str = "momentum"
    variant: Callable[[Any], Mapping[str, Any]] | None = None

    def __post_init__(self) -> None:
        set_fields(
            self,
            t_span=tuple(read_number(t, "a time of t_span") for t in _as_tuple(self.t_span, "t_span")),
            step=read_positive(self.step, "step"),
            save_every=read_integer(self.save_every, "save_every"),
            attitude=read_bool(self.attitude, "attitude"),
        )
        pictures = _as_tuple(self.pictures, "pictures")
        for picture in (*pictures, self.components):
            if not isinstance(picture, Picture):
                raise TypeError(f"a picture is {short(picture)}; give a Picture, such as Picture('body axis', axis=1)")
        set_fields(self, pictures=pictures)
        for text, what in ((self.caption, "caption"), (self.quantity, "quantity")):
            if not isinstance(text, str) or not text:
                raise TypeError(f"{what} is {short(text)}; give a string")

    def start(self) -> npt.NDArray[Any]:
        """Return the initial state, or one for each member.

        Returns
        -------
        ndarray, shape (n,) or (members, n)
        """
        x0 = self.x0() if callable(self.x0) else self.x0
        # Complex matrices are validated by the run.
        return np.array(x0) if np.iscomplexobj(x0) else read_finite(x0, "x0")

    def of(self, system: Any) -> GalleryEntry:
        """Return the entry with the pictures of a system, whose parameters may be others.

        Parameters
        ----------
        system : System
            Of this name.

        Returns
        -------
        GalleryEntry
        """
        changes = {} if self.variant is None else self.variant(system)
        return replace(self, **changes) if changes else self

    def names(self, dim: int) -> tuple[str, ...]:
        """Return the names of `dim` coordinates; empty if they have none.

        Parameters
        ----------
        dim : int
            The dimension.

        Returns
        -------
        tuple of str
        """
        names = tuple(self.coordinates(dim)) if callable(self.coordinates) else tuple(self.coordinates)
        return names if len(names) == dim else ()


def _as_tuple(argument: Any, what: str) -> tuple[Any, ...]:
    return read_list(argument, what, "give a list")


def points_on_sphere(count: int, radius: float = 1.0) -> npt.NDArray[np.float64]:
    """Return `count` points, (count, 3), distributed about evenly on a sphere, along a spiral of the golden angle."""
    k = np.arange(count)
    height = 1.0 - (2.0 * k + 1.0) / count
    angle = math.pi * (3.0 - math.sqrt(5.0)) * k
    distance = np.sqrt(1.0 - height**2)
    return radius * np.stack([distance * np.cos(angle), distance * np.sin(angle), height], axis=-1)
