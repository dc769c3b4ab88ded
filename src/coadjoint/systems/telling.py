"""What does a user of a system want to see first? A run and its pictures, as data without Matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.given import read_finite, read_flag, read_list, read_number, read_positive, read_title, read_whole
from coadjoint.wording import short

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, init=False)
class Picture:
    """A kind of picture by its name, with its options.

    Parameters
    ----------
    kind : str
        Such as ``"body axis"``; ``coadjoint.pictures.register.kinds`` has them all.
    **options
        Of that kind, as its function in the folder ``pictures/kinds`` says.

    Examples
    --------
    >>> Picture("body axis", axis=1)
    Picture('body axis', axis=1)
    """

    kind: str
    options: Mapping[str, Any]

    def __init__(self, kind: str, **options: Any) -> None:
        object.__setattr__(self, "kind", read_title(kind, "kind of a picture"))
        object.__setattr__(self, "options", options)

    def __repr__(self) -> str:
        return f"Picture({', '.join([repr(self.kind), *(f'{key}={short(v)}' for key, v in self.options.items())])})"


@dataclass(frozen=True)
class Telling:
    """The run of a ready-made system that the gallery shows, and its pictures.

    Parameters
    ----------
    x0 : array_like, shape (n,) or (members, n), or function that returns it
        A good start; a function where it takes a formula. Of systems of matrices (N, N) or (members, N, N).
    t_span : (float, float)
        Start and end.
    step : float
        A step at which the suggested scheme shows the motion truly.
    says : str
        In one or two sentences what is to be seen; it stands under the picture, and in its place for who cannot see it.
    pictures : sequence of Picture
        What `Solution.plot` draws beside components and drift. Of those that a run cannot show, for its dimension or
        since no attitude was carried, none is drawn.
    components : Picture
        Which components, or which functions of them, are drawn over time.
    parameters : mapping
        Of the system, where those by default tell less.
    attitude : bool
        Whether the group element is carried.
    save_every : int
        As for `integrate`.
    coordinates : sequence of str, or function of the dimension that returns it
        Names of the coordinates, such as ``("E", "P", "D")``; by default those of the basis.
    quantity : str
        What the coordinates are, for the label of their axis.

    Raises
    ------
    TypeError, ValueError
        A value is none of these.

    Examples
    --------
    >>> Telling((0.0, 1.0, 0.01), (0.0, 10.0), 0.1, "A flip.", [Picture("body axis", axis=1)]).t_span
    (0.0, 10.0)
    """

    x0: npt.ArrayLike | Callable[[], npt.ArrayLike]
    t_span: tuple[float, float]
    step: float
    says: str
    pictures: tuple[Picture, ...] = ()
    components: Picture = Picture("components")
    parameters: Mapping[str, Any] = field(default_factory=dict)
    attitude: bool = False
    save_every: int = 1
    coordinates: tuple[str, ...] | Callable[[int], tuple[str, ...]] = ()
    quantity: str = "momentum"

    def __post_init__(self) -> None:
        keep = object.__setattr__
        keep(self, "t_span", tuple(read_number(t, "a time of t_span") for t in _listed(self.t_span, "t_span")))
        keep(self, "step", read_positive(self.step, "step"))
        keep(self, "save_every", read_whole(self.save_every, "save_every"))
        keep(self, "attitude", read_flag(self.attitude, "attitude"))
        pictures = _listed(self.pictures, "pictures")
        for picture in (*pictures, self.components):
            if not isinstance(picture, Picture):
                raise TypeError(f"a picture is {short(picture)}; give a Picture, such as Picture('body axis', axis=1)")
        keep(self, "pictures", pictures)
        for text, what in ((self.says, "says"), (self.quantity, "quantity")):
            if not isinstance(text, str) or not text:
                raise TypeError(f"{what} is {short(text)}; give a text")

    def start(self) -> npt.NDArray[Any]:
        """Return the start, or one for each member.

        Returns
        -------
        ndarray, shape (n,) or (members, n)
        """
        given = self.x0() if callable(self.x0) else self.x0
        # A complex matrix is read where the run begins.
        return np.array(given) if np.iscomplexobj(given) else read_finite(given, "x0")

    def names(self, dim: int) -> tuple[str, ...]:
        """Return the names of so many coordinates, or none where they are not named.

        Parameters
        ----------
        dim : int
            The dimension.

        Returns
        -------
        tuple of str
        """
        given = tuple(self.coordinates(dim)) if callable(self.coordinates) else tuple(self.coordinates)
        return given if len(given) == dim else ()


def _listed(given: Any, what: str) -> tuple[Any, ...]:
    return read_list(given, what, "give a list")
