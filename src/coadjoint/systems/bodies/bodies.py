"""Several rigid bodies in space, with a potential of their positions and attitudes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.invariants.sampled_checks import evaluate, sample_points
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.bodies.body import (
    IN_SPACE,
    axis_products,
    bodies_algebra,
    central_coordinate,
    momentum_in_space,
    quadratic_form,
)
from coadjoint.systems.bodies.body_pictures import momenta_of_bodies, pictures_beside_points
from coadjoint.systems.bodies.body_systems import (
    Bodies,
    joined,
    over_members,
    read_angular_velocities,
    read_attitudes,
    read_states,
    read_vectors,
)
from coadjoint.systems.bodies.inertia import BodyInertia, inverse_of_moving, read_bodies
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.forces.torque import SAMPLE_ATTITUDE
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.registry import ready_made
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import as_tuples, set_fields

Floats = npt.NDArray[np.float64]
Made = TypeVar("Made", bound="BodiesSystem")

ROD_TORQUE = 2.0**-30
"""Largest torque along a rod, relative to the derivatives of the potential, that is taken for their rounding."""


class BodiesSystem(Bodies):
    """Several bodies with their centres in space; `bodies` and `gravitating_bodies` make it."""

    def __init__(self, inertias: tuple[BodyInertia, ...], masses: Floats, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        set_fields(self, inertias=inertias, masses=masses, bodies=(len(inertias),))

    masses: Floats

    def positions(self, x: npt.ArrayLike) -> Floats:
        """Return the positions of the centres of mass in space.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., k, 3)
        """
        return self._centres(x, PER_BODY + 3)

    def velocities(self, x: npt.ArrayLike) -> Floats:
        """Return the velocities of the centres of mass in space.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., k, 3)
        """
        return self._centres(x, PER_BODY) / self.masses[:, None]

    def _centres(self, x: Any, begin: int) -> Floats:
        states, count = read_states(self, x), len(self.inertias)
        return states[..., begin * count : (begin + 3) * count].reshape(*states.shape[:-1], count, 3).copy()

    @suggest_keywords
    def state(
        self,
        positions: npt.ArrayLike,
        velocities: npt.ArrayLike | None = None,
        attitudes: Any = None,
        angular_velocities: npt.ArrayLike | None = None,
        *,
        scalar_first: bool = False,
        degrees: bool = False,
        frame: str = "body",
    ) -> Floats:
        """Return the state of k bodies at positions in space, with attitudes and velocities.

        Parameters
        ----------
        positions : (k, 3)
            Of the centres of mass, in space.
        velocities : (k, 3), optional
            Of the centres, in space; zero by default.
        attitudes : k of (3, 3), (4,) or scipy.spatial.transform.Rotation, optional
            From each body to space, as an array, a list, or a Rotation of length k; by default those of space.
        angular_velocities : (k, 3), optional
            In radians per time; zero by default.
        scalar_first : bool
            Whether quaternions are (w, x, y, z) instead of (x, y, z, w).
        degrees : bool
            Whether the angular velocities are in degrees per time.
        frame : {"body", "space"}
            Frame of the angular velocities: that of each body, or space.

        Returns
        -------
        ndarray, shape (dim,) or (members, dim)
            With an axis of members if an argument has one before the stated shape.

        Raises
        ------
        TypeError, ValueError
            Wrong shapes, no rotations, or an angular velocity along a rod.

        Examples
        --------
        >>> import coadjoint as co
        >>> pair = co.systems.gravitating_bodies(masses=(3.0, 1.0))
        >>> x0 = pair.state([[0, 0, 0], [4, 0, 0]], velocities=[[0, -0.25, 0], [0, 0.75, 0]])
        >>> pair.velocities(x0)[1]
        array([0.  , 0.75, 0.  ])
        """
        shape, bodies = (*self.bodies, 3), self.bodies
        still = np.zeros(shape)
        r = read_vectors(positions, "positions", shape)
        v = still if velocities is None else read_vectors(velocities, "velocities", shape)
        given = np.tile(np.eye(3), (*bodies, 1, 1)) if attitudes is None else attitudes
        A = read_attitudes(given, "attitudes", bodies, scalar_first)
        turning = still if angular_velocities is None else angular_velocities
        omega = read_angular_velocities(turning, "angular_velocities", A, bodies, frame, degrees)
        L = self._momentum(omega, "angular_velocities")
        L, A, r, p = over_members((L[..., None, :], 3), (A, 3), (r, 2), (v * self.masses[:, None], 2))
        parts = np.concatenate([L, A], axis=-2).reshape(*r.shape[:-2], -1), joined(p), joined(r)
        return np.concatenate([*parts, np.ones((*r.shape[:-2], 1))], axis=-1)


def kinetic_matrix(inertias: npt.NDArray[Any], masses: npt.NDArray[Any]) -> tuple[npt.NDArray[Any]]:
    """Return the matrix of the energy of free bodies, by its diagonal if all inertias are moments."""
    count = len(inertias)
    M = np.zeros((18 * count + 1,) * (inertias.ndim - 1), dtype=np.result_type(inertias, masses))
    for k, inertia in enumerate(inertias):
        inverse = inverse_of_moving(inertia)
        # Entries of a tensor are differentiated one by one, as if it were not symmetric.
        M[(slice(PER_BODY * k, PER_BODY * k + 3),) * M.ndim] = 0.5 * (inverse + inverse.T)
    p = np.arange(PER_BODY * count, (PER_BODY + 3) * count)
    M[(p,) * M.ndim] = 1.0 / np.repeat(masses, 3)
    return (M,)


def _tumbling() -> Floats:
    """Return two bodies apart that spin about axes near their middle ones."""
    return bodies().state([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], angular_velocities=[[0.01, 0.5, 0.01], [1.0, 0.01, 0.2]])


@ready_made(
    unit="z",
    coordinates=IN_SPACE,
    energy=kinetic_matrix,
    gallery_entry=GalleryEntry(
        x0=_tumbling,
        t_span=(0.0, 90.0),
        step=0.05,
        caption="Two free bodies: the angular momentum of each, as seen from its body, moves on a sphere; that of the "
        "asymmetric body flips between the poles of its middle axis, that of the symmetric one moves on a circle.",
        pictures=(Picture("directions", vectors=momenta_of_bodies, title="angular momenta in the body frames"),),
        components=Picture("components", chosen=(0, 1, 2), quantity="angular momentum of the first body"),
        quantity="state",
        variant=pictures_beside_points,
    ),
)
def bodies(
    inertias: Any = ((1.0, 2.0, 2.5), (1.0, 1.0, 1.5)),
    masses: npt.ArrayLike | None = None,
    potential: Callable[..., Any] | None = None,
    gradient: Callable[..., Any] | None = None,
    hessian: Callable[..., Any] | None = None,
) -> BodiesSystem:
    """Return k rigid bodies in space with any potential V(r, A) of their positions and attitudes.

    Choose it for molecules, magnets, tethered or docking spacecraft, or one body in a field of force; for mutual
    gravity see `gravitating_bodies`. Each body has the state (L, X, Y, Z) of `body`; the momenta and positions of the
    centres are canonical pairs in space beside it, so that orbits and rotations may have any ratio of sizes. Sign -1,
    ``H = sum of L . I^-1 L / 2 + |p|^2/(2 m) + V``. Positions and attitudes commute, so V is one exact kick.

    Parameters
    ----------
    inertias : sequence of k (3,), (3, 3) or co.bodies.MassProperties
        Principal moments or inertia tensor of each body, in its own frame (mass times length squared), or a body from a
        file (`co.bodies.read`). The moment along a rod is zero, and so are those of a point.
    masses : (k,), optional
        Masses, positive. By default those of bodies from files, and otherwise 1 for each of two.
    potential : callable, optional
        Pure function of ``(r, A)`` that returns the energy: positions (k, 3) in space, and attitudes (k, 3, 3) from
        each body to space, so that ``r[i] + A[i] @ b`` is the point b of body i. Numba compiles it. By default the
        bodies are free.
    gradient : callable, optional
        Function of the same arguments that returns the pair of derivatives by r, (k, 3), and by A, (k, 3, 3), of
        independent entries. Without it the operations of `potential` are recorded and differentiated, as those of a
        `Hamiltonian`, and so are second derivatives.
    hessian : callable, optional
        Function of the same arguments that returns the second derivatives, (12 k, 12 k), by the entries of A in the
        order A[0, 0, 0], A[0, 0, 1], ..., then those of r. Needed with `gradient` for derivatives of runs.

    Returns
    -------
    BodiesSystem
        State: (L, X, Y, Z) of each body, all p, all r, and 1, together 18 k + 1 numbers; ``state(positions=,
        velocities=, attitudes=, angular_velocities=)`` makes it, and ``positions(x)``, ``velocities(x)``,
        ``attitudes(x)``, ``angular_velocity(x, frame=)``, ``angular_momentum(x, frame=)`` read it. Solutions have
        ``positions``, ``velocities``, ``rotation``, ``angular_velocity`` and ``angular_momentum``. Casimirs: z, which
        is 1, and the products of the axes of at most 64 bodies. Integrals of free bodies: the total momentum and
        angular momentum in space. A potential is not stored in ``parameters``.

    Raises
    ------
    TypeError, ValueError
        Arguments of wrong shapes, moments or masses that no body has, or a potential that is no function of (r, A),
        cannot be differentiated, contradicts its gradient, or turns a rod about its axis or a point.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Examples
    --------
    A spring from a point of a body to the end of a rod:

    >>> import coadjoint as co
    >>> def spring(r, A):
    ...     ends = r[0] + A[0, :, 0] - r[1] + A[1, :, 2]
    ...     return 0.5 * (ends * ends).sum()
    >>> pair = co.systems.bodies([(1, 2, 2.5), (2, 2, 0)], [1.0, 2.0], potential=spring)
    >>> x0 = pair.state([[0, 0, 0], [3, 0, 0]], angular_velocities=[[0, 0.1, 0], [0.2, 0, 0]])
    >>> sol = co.integrate(pair, x0, (0, 1), 0.01, co.Splitting(order=4, parts="free_body"))
    >>> sol.positions.shape, bool(sol.drift()["energy"] < 1e-8)
    ((101, 2, 3), True)
    """
    found, m = read_bodies(inertias, masses, (1.0, 1.0))
    check_potential(potential, gradient, hessian)
    V = None if potential is None else attitude_potential(potential, gradient, hessian, len(found))
    if V is not None:
        try:
            V = V.bind(PER_BODY * len(found))
        except (TypeError, ValueError) as reason:
            raise type(reason)(f"potential: {reason}") from reason
        _check_rods(V, found)
    parameters = None
    if V is None:
        parameters = {**inertial_parameters(found, m), "potential": None, "gradient": None, "hessian": None}
    integrals = momentum_in_space(len(found), 18 * len(found) + 1) if V is None else {}
    return system_of_bodies("bodies", found, m, V, parameters, integrals)


def system_of_bodies(
    name: str,
    inertias: tuple[BodyInertia, ...],
    masses: Floats,
    potential: Hamiltonian | None,
    parameters: Mapping[str, Any] | None,
    integrals: Mapping[str, Any],
    kind: type[Made] = BodiesSystem,  # type: ignore[assignment]
) -> Made:
    """Return the system of bodies with a potential of the entries of all attitudes, then of all positions."""
    count = len(inertias)
    algebra = bodies_algebra(count)
    pieces: list[tuple[Any, Any]] = []
    kinetic = _kinetic_energy(inertias, masses, algebra.dim)
    if potential is not None:
        pieces.append((tuple(potential_coordinates(count).tolist()), potential))
    H = kinetic + SplitHamiltonian(pieces) if pieces else kinetic
    return kind(
        inertias,
        masses,
        algebra,
        H,
        sign=-1,
        casimirs={"z": central_coordinate(algebra.dim), **axis_products(count, algebra.dim)},
        name=name,
        parameters=parameters,
        integrals=integrals,
    )


def potential_coordinates(count: int) -> npt.NDArray[np.int64]:
    """Return the coordinates on which a potential depends: the entries of all attitudes, then the positions."""
    axes = np.arange(PER_BODY * count).reshape(count, PER_BODY)[:, 3:].ravel()
    return np.concatenate([axes, np.arange((PER_BODY + 3) * count, (PER_BODY + 6) * count)])


def _check_rods(potential: Hamiltonian, inertias: tuple[BodyInertia, ...]) -> None:
    """Raise ValueError if a potential has a torque along a rod or on a point, which has no moment of inertia there."""
    for y in sample_points(PER_BODY * len(inertias)):
        y[: 9 * len(inertias)] = np.tile(SAMPLE_ATTITUDE.ravel(), len(inertias))
        slope = evaluate(potential.gradient, y, False)
        if slope is None:
            continue
        for k, inertia in enumerate(inertias):
            axes, slopes = (array[9 * k : 9 * k + 9].reshape(3, 3) for array in (y, slope))
            torque, size = np.cross(axes, slopes).sum(axis=0), float(np.abs(slopes).sum())
            turned = 0.0 if inertia.rotating is None else np.abs(torque - inertia.rotating @ torque).max()
            if turned > ROD_TORQUE * size:
                raise ValueError(
                    f"potential has a torque on body {k} where inertias[{k}] is zero: about the axis of a rod, or on a "
                    "point; give a potential that does not depend on this rotation, or the body a moment there"
                )


def _kinetic_energy(inertias: tuple[BodyInertia, ...], masses: Floats, dim: int) -> Quadratic:
    entries: list[tuple[int, int, float]] = []
    for k, inertia in enumerate(inertias):
        inverse = np.diag(inertia.inverse) if inertia.inverse.ndim == 1 else inertia.inverse
        begin = PER_BODY * k
        entries += [(begin + i, begin + j, float(inverse[i, j])) for i, j in zip(*np.nonzero(inverse), strict=True)]
    begin = PER_BODY * len(inertias)
    entries += [(begin + i, begin + i, 1.0 / m) for i, m in enumerate(np.repeat(masses, 3).tolist())]
    return quadratic_form(dim, entries, np.zeros(dim))


def inertial_parameters(inertias: tuple[BodyInertia, ...], masses: Floats) -> dict[str, Any]:
    """Return inertias and masses as plain numbers; moments as tensors where another body has one."""
    given = [inertia.given for inertia in inertias]
    if len({np.ndim(one) for one in given}) > 1:
        given = [as_tuples(inertia.tensor) for inertia in inertias]
    return {"inertias": tuple(given), "masses": tuple(masses.tolist())}


def attitude_potential(
    potential: Callable[..., Any], gradient: Callable[..., Any] | None, hessian: Callable[..., Any] | None, count: int
) -> Hamiltonian:
    """Return V(r, A) of `count` bodies as a function of the entries of A, (count, 3, 3), then of r, (count, 3)."""
    # `gradient` returns the derivatives by r and by A, and `hessian` those of all entries, (12 count, 12 count).
    axes = 9 * count

    def value(y: Any) -> Any:
        return potential(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))

    if gradient is None:
        return Hamiltonian(value)

    def derivative(y: Any) -> Any:
        by_r, by_A = gradient(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))
        result = 0.0 * y
        for k in range(count):
            for i in range(3):
                result[axes + 3 * k + i] = by_r[k, i]
                for j in range(3):
                    result[9 * k + 3 * i + j] = by_A[k, i, j]
        return result

    if hessian is None:
        return Hamiltonian(value, derivative)

    def second(y: Any) -> Any:
        return hessian(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))

    return Hamiltonian(value, derivative, second)


def check_potential(potential: Any, gradient: Any, hessian: Any) -> None:
    """Raise TypeError unless each is None or a function of (r, A), and each derivative has the one before."""
    if potential is None and gradient is not None:
        raise TypeError("gradient was given without potential; give both, or neither for free bodies")
    if gradient is None and hessian is not None:
        raise TypeError("hessian was given without gradient; give both, or neither to derive them from potential")
    for value, what in ((potential, "potential"), (gradient, "gradient"), (hessian, "hessian")):
        if value is not None:
            check_arguments(value, what, "r, A")
