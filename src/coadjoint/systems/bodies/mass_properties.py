"""Mass properties of a body: mass, centre of mass, and inertia tensor about it, with the frame and the units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import warn_caller
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import html_table, short
from coadjoint.validation import Immutable, read_finite, read_list, read_positive, set_fields

Floats = npt.NDArray[np.float64]
Surface = tuple[Floats, npt.NDArray[np.int64]]
"""Vertices (n, 3) and triangles (m, 3) of a surface."""
Number = TypeVar("Number", np.float64, np.int64)

FILE_DIGITS = 1e-3
"""Largest excess of a moment over the sum of the others, relative to it, that is rounding in a file of three digits."""
ROUNDING = 64 * UNIT_ROUNDOFF
"""Relative size of what sums of a few rounded terms leave."""


@suggest_keywords
class MassProperties(Immutable):
    """Mass, centre of mass and inertia tensor of a rigid body, as `co.bodies.read` returns them.

    Choose it to carry a body from a file or a CAD report to `co.systems.body`, `co.systems.bodies`,
    `co.systems.gravitating_bodies` and the others that take an inertia about the centre of mass. All vectors and
    tensors have components along the axes of `frame`, which are also the body axes of these systems.

    The off-diagonal entries are those of the tensor, ``inertia[0, 1] = -integral of x y dm``: minus the products of
    inertia. URDF (``ixy``), SDF and MJCF (``fullinertia``) have the same sign. A CAD report that lists positive
    products of inertia needs their signs changed.

    Parameters
    ----------
    mass : float
        Mass, positive.
    inertia : (3, 3) or (3,)
        Inertia tensor about the centre of mass, or its moments if the axes of the frame are principal axes (mass times
        length squared).
    centre_of_mass : (3,)
        Position of the centre of mass in the frame (length).
    frame : str
        What the origin and the axes are, for messages and for the representation.
    units : str
        Units of mass and length, such as ``"kg, m"``.
    radius : float, optional
        Distance from the centre of mass that no matter exceeds (length), if it is known.
    third_moments : (3, 3, 3), optional
        Integrals of ``y_a y_b y_c dm``, y from the centre of mass, in the axes of the frame.
    fourth_moments : (3, 3, 3, 3), optional
        Integrals of ``y_a y_b y_c y_d dm``. With `third_moments` for ``gravitating_bodies(..., order=4)``.
    surface : tuple of (n, 3) and (m, 3), optional
        Closed surface of a homogeneous body, as a mesh has it: vertices from the centre of mass in the axes of the
        frame (length), and of each triangle the numbers of its vertices, counter-clockwise seen from outside. For
        ``gravitating_bodies(..., order="polyhedron")``, which validates that it is closed.

    Attributes
    ----------
    moments : ndarray, shape (3,)
        Principal moments of inertia, ascending.
    axes : ndarray, shape (3, 3)
        Principal axes as columns, in the axes of the frame, right-handed: ``axes @ diag(moments) @ axes.T`` is the
        tensor.

    Raises
    ------
    TypeError, ValueError
        A mass that is not positive, a tensor of another shape, not symmetric, or that no body has: a negative moment,
        or one that exceeds the sum of the other two by more than 0.1 per cent, the rounding in files of few digits.

    Warns
    -----
    UserWarning
        A moment is larger than the mass can have within `radius`.

    Examples
    --------
    >>> import coadjoint as co
    >>> part = co.bodies.MassProperties(2.0, [[1.0, 0.1, 0.0], [0.1, 1.5, 0.0], [0.0, 0.0, 2.0]], frame="CAD axes")
    >>> part.moments.round(6)
    array([0.980742, 1.519258, 2.      ])
    >>> co.systems.body(part).name
    'body'
    """

    def __init__(
        self,
        mass: float,
        inertia: npt.ArrayLike,
        centre_of_mass: npt.ArrayLike = (0.0, 0.0, 0.0),
        frame: str = "",
        units: str = "",
        radius: float | None = None,
        third_moments: npt.ArrayLike | None = None,
        fourth_moments: npt.ArrayLike | None = None,
        surface: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    ) -> None:
        for name, text in (("frame", frame), ("units", units)):
            if not isinstance(text, str):
                raise TypeError(f"{name} is {short(text)}; give a text")
        what = f"inertia of {frame}" if frame else "inertia"
        tensor = read_finite(inertia, what)
        if tensor.shape == (3,):
            tensor = np.diag(tensor)
        if tensor.shape != (3, 3):
            raise ValueError(f"{what} has shape {tensor.shape}; give a symmetric (3, 3), or three principal moments")
        size = float(np.abs(tensor).max())
        if np.abs(tensor - tensor.T).max() > ROUNDING * size:
            raise ValueError(f"{what} is not symmetric; give one tensor with equal entries at [i, j] and [j, i]")
        tensor = 0.5 * tensor + 0.5 * tensor.T
        centre = read_finite(centre_of_mass, "centre_of_mass")
        if centre.shape != (3,):
            raise ValueError(f"centre_of_mass has shape {centre.shape}; give three numbers")
        set_fields(
            self,
            mass=read_positive(mass, f"mass of {frame}" if frame else "mass"),
            inertia=_fixed(tensor),
            centre_of_mass=_fixed(centre),
            frame=frame,
            units=units,
            radius=None if radius is None else read_positive(radius, "radius"),
            third_moments=_moments_of_order(third_moments, "third_moments", 3),
            fourth_moments=_moments_of_order(fourth_moments, "fourth_moments", 4),
            surface=None if surface is None else read_surface(surface, "surface"),
        )
        if (self.third_moments is None) != (self.fourth_moments is None):
            raise ValueError("third_moments and fourth_moments belong together; give both or neither")
        self._check(what)

    mass: float
    inertia: Floats
    centre_of_mass: Floats
    frame: str
    units: str
    radius: float | None
    third_moments: Floats | None
    fourth_moments: Floats | None
    surface: Surface | None

    def _check(self, what: str) -> None:
        """Raise ValueError for a tensor that no body has; warn of a moment that its size does not allow."""
        low, middle, high = self.moments.tolist()
        text = f"{low:.6g}, {middle:.6g} and {high:.6g}"
        if low < -ROUNDING * abs(high):
            raise ValueError(
                f"{what} has the principal moments {text}, and no body has a negative one; check the signs of the "
                "products of inertia, and whether the tensor is about the centre of mass"
            )
        if high - middle - low > FILE_DIGITS * high:
            raise ValueError(
                f"{what} has the principal moments {text}; the largest exceeds the sum of the other two, which no body "
                "has: check its units, signs and order, and whether it is about the centre of mass"
            )
        if self.radius is not None and high > self.mass * self.radius * self.radius * (1.0 + ROUNDING):
            warn_caller(
                f"{what} has the moment {high:.6g}, for which its mass of {self.mass:.6g} would lie at "
                f"{np.sqrt(high / self.mass):.6g} from the centre of mass, but the body ends at {self.radius:.6g}; "
                "check the units of mass and length",
                UserWarning,
            )

    @cached_property
    def _principal(self) -> tuple[Floats, Floats]:
        size = float(np.abs(self.inertia).max())
        moments, axes = np.linalg.eigh(self.inertia / size if size else self.inertia)
        # The largest component of each axis is positive, and the three are right-handed.
        axes = axes * np.sign(axes[np.abs(axes).argmax(axis=0), range(3)])
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return _fixed(moments * size), _fixed(axes)

    @property
    def moments(self) -> Floats:
        """Principal moments of inertia, ascending, (3,)."""
        return self._principal[0]

    @property
    def axes(self) -> Floats:
        """Principal axes as columns, in the axes of the frame, (3, 3)."""
        return self._principal[1]

    @suggest_keywords
    def about(self, point: npt.ArrayLike) -> Floats:
        """Return the inertia tensor about another point of the body, such as the pivot of a top.

        Parameters
        ----------
        point : (3,)
            The point in the frame (length).

        Returns
        -------
        ndarray, shape (3, 3)
            In the axes of the frame, by the theorem of Steiner: the lever of a `co.systems.heavy_top` about this point
            is ``mass * gravity * (centre_of_mass - point)``.

        Examples
        --------
        >>> import coadjoint as co
        >>> ball = co.bodies.MassProperties(2.0, (0.1, 0.1, 0.1), centre_of_mass=(0.0, 0.0, 1.0))
        >>> ball.about((0.0, 0.0, 0.0)).diagonal()
        array([2.1, 2.1, 0.1])
        """
        position = read_finite(point, "point")
        if position.shape != (3,):
            raise ValueError(f"point has shape {position.shape}; give three numbers")
        return self.inertia + self.mass * _of_point(self.centre_of_mass - position)

    def __repr__(self) -> str:
        products = self.inertia[(0, 0, 1), (1, 2, 2)].tolist()
        entries = [
            f"mass={self.mass:.6g}",
            f"centre_of_mass={_shown(self.centre_of_mass)}",
            f"moments={_shown(self.moments)}",
            f"Ixx, Iyy, Izz={_shown(self.inertia.diagonal())}",
            f"Ixy, Ixz, Iyz={_shown(products)} (Ixy = -integral of x y dm)",
            *([f"frame={self.frame!r}"] if self.frame else []),
            *([f"units={self.units!r}"] if self.units else []),
        ]
        return f"MassProperties({', '.join(entries)})"

    def _repr_html_(self) -> str:
        rows: dict[str, Any] = {
            "mass": f"{self.mass:.6g}",
            "centre of mass": _shown(self.centre_of_mass),
            **{f"inertia, row {name}": _shown(row) for name, row in zip("xyz", self.inertia, strict=True)},
            "sign of products": "Ixy = -integral of x y dm",
            "principal moments": _shown(self.moments),
            "frame": self.frame,
            "units": self.units,
        }
        return html_table("Mass properties", rows)


InertiaLike = npt.ArrayLike | MassProperties
"""Principal moments, a tensor, or a body from a file."""


def _shown(values: Iterable[float]) -> str:
    return f"({', '.join(f'{value:.6g}' for value in values)})"


def _fixed(array: npt.NDArray[Number]) -> npt.NDArray[Number]:
    array.setflags(write=False)
    return array


def _moments_of_order(values: Any, what: str, order: int) -> Floats | None:
    """Validate a symmetric tensor of moments, or None."""
    if values is None:
        return None
    tensor = read_finite(values, what)
    if tensor.shape != (3,) * order:
        raise ValueError(f"{what} has shape {tensor.shape}; give a symmetric {(3,) * order}")
    if np.abs(tensor - tensor.swapaxes(0, -1)).max() > ROUNDING * np.abs(tensor).max() or (
        np.abs(tensor - tensor.swapaxes(0, 1)).max() > ROUNDING * np.abs(tensor).max()
    ):
        raise ValueError(f"{what} is not symmetric in its axes; give the integrals of products of coordinates")
    return _fixed(tensor)


def read_surface(given: Any, what: str) -> Surface:
    """Validate vertices, (n, 3), and triangles of their numbers, (m, 3); not that they are a closed surface."""
    rule = "give a pair of vertices (n, 3) and triangles (m, 3)"
    given = read_list(given, what, rule)
    if len(given) != 2:
        raise ValueError(f"{what} is {short(given)}; {rule}")
    points, numbers = read_finite(given[0], f"vertices of {what}"), read_finite(given[1], f"triangles of {what}")
    for array, name in ((points, "vertices"), (numbers, "triangles")):
        if array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise ValueError(f"{name} of {what} have shape {array.shape}; give (number, 3)")
    if (np.floor(numbers) != numbers).any() or numbers.min() < 0 or numbers.max() >= len(points):
        raise ValueError(
            f"triangles of {what} must be whole numbers from 0 to {len(points) - 1}, those of its vertices; give three "
            "of each"
        )
    return _fixed(points), _fixed(numbers.astype(np.int64))


def _of_point(d: Floats) -> Floats:
    """Return the inertia tensor of a unit mass at a position."""
    return np.asarray((d * d).sum() * np.eye(3) - np.outer(d, d))


def product(A: Floats, B: Floats) -> Floats:
    """Return the product of small matrices, with the same bits on every machine."""
    return np.asarray(np.einsum("ij,jk->ik", A, B))


def turned(R: Floats, v: Floats) -> Floats:
    """Return the product of a matrix and a vector, with the same bits on every machine."""
    return np.asarray(np.einsum("ij,j->i", R, v))


class Pose:
    """A rotation and a position, from a frame to the one in which they are given."""

    def __init__(self, rotation: Floats, position: Floats) -> None:
        self.rotation, self.position = rotation, position

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(product(self.rotation, other.rotation), turned(self.rotation, other.position) + self.position)


def identity_pose() -> Pose:
    """Return the pose of a frame in itself."""
    return Pose(np.eye(3), np.zeros(3))


def placed(body: MassProperties, pose: Pose, frame: str) -> MassProperties:
    """Return the same body in the frame in which the pose of its own frame is given."""
    R = pose.rotation
    third, fourth, surface = body.third_moments, body.fourth_moments, body.surface
    return _derived(
        body,
        inertia=_fixed(_symmetric(product(product(R, body.inertia), R.T))),
        centre_of_mass=_fixed(turned(R, body.centre_of_mass) + pose.position),
        frame=frame,
        third_moments=None if third is None else _fixed(np.einsum("ai,bj,ck,ijk->abc", R, R, R, third)),
        fourth_moments=None if fourth is None else _fixed(np.einsum("ai,bj,ck,dl,ijkl->abcd", R, R, R, R, fourth)),
        surface=None if surface is None else (_fixed(np.einsum("ij,nj->ni", R, surface[0])), surface[1]),
    )


def composed(parts: Sequence[MassProperties], frame: str) -> MassProperties:
    """Return one rigid body of several in the same frame; higher moments and surfaces are left out."""
    total = sum(part.mass for part in parts)
    centre = np.asarray(sum((part.mass / total * part.centre_of_mass for part in parts), np.zeros(3)))
    away = [part.centre_of_mass - centre for part in parts]
    pairs = list(zip(parts, away, strict=True))
    tensor = sum((part.inertia + part.mass * _of_point(d) for part, d in pairs), np.zeros((3, 3)))
    radii = [float(np.linalg.norm(d)) + part.radius for part, d in pairs if part.radius is not None]
    return _derived(
        parts[0],
        mass=total,
        inertia=_fixed(_symmetric(np.asarray(tensor))),
        centre_of_mass=_fixed(centre),
        frame=frame,
        radius=max(radii) if len(radii) == len(parts) else None,
        third_moments=None,
        fourth_moments=None,
        surface=None,
    )


def _derived(body: MassProperties, **changed: Any) -> MassProperties:
    """Return mass properties that follow from checked ones, which are not checked again."""
    made = object.__new__(MassProperties)
    names = MassProperties.__annotations__
    set_fields(made, **{name: getattr(body, name) for name in names} | changed)
    return made


def _symmetric(tensor: Floats) -> Floats:
    return np.asarray(0.5 * tensor + 0.5 * tensor.T)
