"""Rigid bodies under their mutual gravity: to second or fourth order in their sizes, or of polyhedra the full field."""

from __future__ import annotations

from functools import lru_cache, partial
from itertools import combinations_with_replacement, permutations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.long_operations import warn_caller
from coadjoint.short_repr import short
from coadjoint.systems.bodies.bodies import (
    BodiesSystem,
    inertial_parameters,
    kinetic_matrix,
    potential_coordinates,
    system_of_bodies,
)
from coadjoint.systems.bodies.body import IN_SPACE, momentum_in_space
from coadjoint.systems.bodies.body_pictures import (
    distances_of_bodies,
    drawn_bodies,
    paths_of_bodies,
    position_of_first,
    relative_positions,
    turning_bodies,
)
from coadjoint.systems.bodies.closed_surfaces import moments_of
from coadjoint.systems.bodies.inertia import BodyInertia, anisotropic_part, check_products, read_bodies, read_in_range
from coadjoint.systems.bodies.mass_properties import read_surface
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import FunctionOfConstants
from coadjoint.systems.hamiltonians.mutual_gravity import mutual_gravity, traceless_multipoles
from coadjoint.systems.hamiltonians.polyhedron_gravity import Polyhedron, polyhedron, polyhedron_gravity
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, is_integer, read_finite, read_list

Floats = npt.NDArray[np.float64]

ORDERS = (0, 2, 4)
"""Orders of the expansion in the sizes that are implemented."""
POLYHEDRON = "polyhedron"
"""The order of bodies of which some have the full field of their surface."""
MAX_TRIANGLES = 10**5
"""Largest number of triangles of a polyhedron: 6 ms for each evaluation of its field."""
CENTRED = 1e-6
"""Largest distance of the centre of mass of a surface from its origin, relative to its size, that is rounding."""
SAME_INERTIA = 1e-2
"""Largest difference of an inertia from that of the homogeneous polyhedron, relative to it, that does not warn."""


PRIMARY, SECONDARY = (0.38, 0.39, 0.42), (0.0010, 0.0013, 0.0014)
DISTANCE, LIBRATION = 3.0, 0.4


def _binary() -> Floats:
    """Return a moon on a circle around a fast rotator, turned from the direction of its planet by 0.4."""
    masses = np.array([1.0, 0.01])
    rate = np.sqrt(masses.sum() / DISTANCE**3)
    pair = gravitating_bodies((PRIMARY, SECONDARY), masses)
    r = DISTANCE * np.array([-masses[1], masses[0]]) / masses.sum()
    zero, c, s = np.zeros(2), np.cos(LIBRATION), np.sin(LIBRATION)
    turned = [np.eye(3), [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]]
    return pair.state(
        np.stack([r, zero, zero], axis=1),
        np.stack([zero, rate * r, zero], axis=1),
        turned,
        [[0.01, 0.0, 1.0], [0.0, 0.0, rate]],
    )


def _libration(x: Any, k: int) -> Any:
    """Return the angle of the first axis of body k to the line from the first body, in the plane of the first orbit."""
    apart, X = relative_positions(x)[..., k - 2, :], x[..., PER_BODY * (k - 1) + 3 :]
    along = X[..., 0] * apart[..., 0] + X[..., 3] * apart[..., 1]
    across = X[..., 0] * apart[..., 1] - X[..., 3] * apart[..., 0]
    return -np.degrees(np.arctan2(across, along))


def _librations(dim: int) -> dict[str, Any]:
    names = {k: f"libration[{k}]" if drawn_bodies(dim)[-1] > 2 else "libration" for k in drawn_bodies(dim, 2)}
    return {name: partial(_libration, k=k) for k, name in names.items()}


def _beside_points(system: Any) -> dict[str, Any]:
    """Return the pictures of bodies of which some are points: librations of the others only, or distances."""
    turning = turning_bodies(system)
    if turning is None:
        return {}
    librations = {f"libration[{k}]": partial(_libration, k=k) for k in turning if k > 1}
    if librations:
        return {"components": Picture("components", functions=librations, quantity="angle of the body [degrees]")}
    single = len(system.inertias) == 1
    distances = Picture("components", functions=distances_of_bodies, quantity="distance of the centres")
    changes: dict[str, Any] = {"components": position_of_first() if single else distances}
    if not turning:
        weights = system.masses / system.masses.sum()
        centre = None if single else lambda r: np.einsum("k,...kj->...j", weights, r)[..., None, :]
        title = "path of the point" if single else "orbits about the centre of mass"
        changes["pictures"] = (paths_of_bodies(system, title, centre),)
    return changes


def _relative(component: int) -> Any:
    """Return the function of states for a component of the positions relative to the first body."""
    return lambda x: relative_positions(x)[..., component]


def _energy(
    inertias: npt.NDArray[Any],
    masses: npt.NDArray[Any],
    G: npt.NDArray[Any],
    *,
    order: Any,
    higher_moments: Any,
    surfaces: Any,
) -> tuple[npt.NDArray[Any]]:
    return kinetic_matrix(inertias, masses)


def _potential(
    inertias: npt.NDArray[Any],
    masses: npt.NDArray[Any],
    G: npt.NDArray[Any],
    *,
    order: Any,
    higher_moments: Any,
    surfaces: Any,
) -> FunctionOfConstants:
    tensors = [np.diag(one) if one.ndim == 1 else 0.5 * (one + one.T) for one in inertias]
    coordinates = potential_coordinates(len(masses))
    if order == POLYHEDRON:
        shapes = [None if one is None else _shape_of(*one, f"surfaces[{k}]") for k, one in enumerate(surfaces)]
        # The second moments of a polyhedron are those of its surface, as the others are.
        tensors = [
            tensor if shape is None else mass * shape.inertia
            for tensor, mass, shape in zip(tensors, masses, shapes, strict=True)
        ]
        anisotropic = np.stack([anisotropic_part(one) for one in tensors])
        fields = [None if shape is None else shape.field for shape in shapes]
        return polyhedron_gravity(coordinates, masses, anisotropic, G, fields)
    anisotropic = np.stack([anisotropic_part(one) * (order > 0) for one in tensors])
    multipoles = None if higher_moments is None else _multipoles(np.asarray(higher_moments))
    return mutual_gravity(coordinates, masses, anisotropic, G, order, multipoles)


class _Shape(NamedTuple):
    """The field of a homogeneous polyhedron, and its inertia tensor per mass."""

    field: Polyhedron
    inertia: Floats


@lru_cache(maxsize=8)
def _shape_of(vertices: Any, triangles: Any, what: str) -> _Shape:
    """Validate the surface of a body, of which members of an ensemble and derivatives share the table."""
    found = moments_of(*read_surface((vertices, triangles), what), what)
    away = float(np.sqrt((found.centre**2).sum()))
    if away > CENTRED * found.radius:
        raise ValueError(
            f"{what} has its centre of mass at ({', '.join(f'{c:.6g}' for c in found.centre)}); subtract this from its "
            "vertices, which are positions from the centre of mass"
        )
    inertia = np.trace(found.second) * np.eye(3) - found.second
    return _Shape(polyhedron(found.points, found.triangles, found.volume), inertia)


def _read_surfaces(given: Any, order: Any, bodies: tuple[BodyInertia, ...], masses: Floats) -> Any:
    """Return of each body its surface as tuples, or None; None if the order is another one."""
    if given is not None and order != POLYHEDRON:
        raise ValueError(f"surfaces was given with order={order}; they have an effect with order={POLYHEDRON!r}")
    if order != POLYHEDRON:
        return None
    surfaces: Any = [None if one.source is None else one.source.surface for one in bodies]
    if given is not None:
        surfaces = read_list(given, "surfaces", "give one surface for each body, or None for a body that has none")
    if len(surfaces) != len(bodies):
        raise ValueError(f"surfaces has {len(surfaces)} entries, and inertias {len(bodies)} bodies; give one for each")
    found: list[Any] = []
    for k, one in enumerate(surfaces):
        if one is None or (hasattr(one, "__len__") and not len(one)):
            found.append(None)
            continue
        what = f"surfaces[{k}]"
        points, triangles = read_surface(one, what)
        if len(triangles) > MAX_TRIANGLES:
            raise ValueError(
                f"{what} has {len(triangles)} triangles; at most {MAX_TRIANGLES} are supported: simplify the mesh"
            )
        found.append((as_tuples(points), as_tuples(triangles)))
        _warn_of_inertia(masses[k] * _shape_of(*found[k], what).inertia, bodies[k].tensor, k)
    if not any(found):
        raise ValueError(
            f"order is {POLYHEDRON!r}, and none of the bodies has a surface; give bodies from meshes (co.bodies.read), "
            "or surfaces="
        )
    return tuple(found)


def _warn_of_inertia(homogeneous: Floats, tensor: Floats, k: int) -> None:
    """Warn if a body has another inertia than the homogeneous one of its surface."""
    off = float(np.abs(tensor - homogeneous).max() / np.abs(homogeneous).max())
    if off > SAME_INERTIA:
        warn_caller(
            f"inertias[{k}] differs by {off:.2g} of its size from that of the homogeneous body in surfaces[{k}], by "
            "which its field is computed; check the units of both, or take a body from co.bodies.read",
            UserWarning,
        )


THIRD, FOURTH = (list(combinations_with_replacement(range(3), order)) for order in (3, 4))
"""Indices of the third and fourth moments of a body, in the order of its row."""


def _multipoles(rows: Floats) -> tuple[Floats, Floats]:
    """Return the multipoles of third and fourth order of each body, (k, 27) and (k, 81), from its moments."""
    found = []
    for row in rows:
        third, fourth = np.empty((3,) * 3), np.empty((3,) * 4)
        for tensor, indices, values in ((third, THIRD, row[: len(THIRD)]), (fourth, FOURTH, row[len(THIRD) :])):
            for index, value in zip(indices, values, strict=True):
                for one in permutations(index):
                    tensor[one] = value
        found.append(traceless_multipoles(third, fourth))
    return np.array([one.ravel() for one, _ in found]), np.array([one.ravel() for _, one in found])


def _read_higher_moments(given: Any, order: Any, bodies: tuple[BodyInertia, ...], masses: Floats) -> Floats | None:
    """Return the third and fourth moments of each body, (k, 25), or None if all are ellipsoids or order is less."""
    if given is not None:
        rows = read_finite(given, "higher_moments")
        if order != 4:
            raise ValueError(f"higher_moments was given with order={order}; they have an effect to order 4")
        if rows.shape != (len(bodies), len(THIRD) + len(FOURTH)):
            raise ValueError(
                f"higher_moments has shape {rows.shape}; give ({len(bodies)}, {len(THIRD) + len(FOURTH)}), of each "
                "body the 10 third and the 15 fourth moments"
            )
        return rows
    if order != 4 or all(one.source is None or one.source.third_moments is None for one in bodies):
        return None
    return np.array([_moments_of(body, mass) for body, mass in zip(bodies, masses.tolist(), strict=True)])


def _moments_of(body: BodyInertia, mass: float) -> list[float]:
    """Return the third and fourth moments of a body; those of a homogeneous ellipsoid if they are not known."""
    source = body.source
    if source is not None and source.third_moments is not None and source.fourth_moments is not None:
        return [float(source.third_moments[i]) for i in THIRD] + [float(source.fourth_moments[i]) for i in FOURTH]
    S = 0.5 * np.trace(body.tensor) * np.eye(3) - body.tensor
    fourth = [S[a, b] * S[c, d] + S[a, c] * S[b, d] + S[a, d] * S[b, c] for a, b, c, d in FOURTH]
    return [0.0] * len(THIRD) + [5.0 / (7.0 * mass) * float(value) for value in fourth]


@ready_made(
    unit="z",
    coordinates=IN_SPACE,
    energy=_energy,
    potential=_potential,
    gallery_entry=GalleryEntry(
        x0=_binary,
        t_span=(0.0, 200.0),
        step=0.1,
        parameters={"inertias": (PRIMARY, SECONDARY), "masses": (1.0, 0.01)},
        caption="A binary asteroid: a moon on a circle around a fast rotator. Its long axis librates about the line of "
        "the centres; right, its path around the primary, which the oblateness of the primary turns slowly.",
        pictures=(
            Picture(
                "phase portrait",
                across=_relative(0),
                up=_relative(1),
                labels=("$r_1$", "$r_2$"),
                equal=True,
                curves=lambda dim: [f"body {k}" for k in drawn_bodies(dim, 2)],
                title="orbits relative to the first body",
            ),
        ),
        components=Picture("components", functions=_librations, quantity="angle of the moon [degrees]"),
        quantity="state",
        variant=_beside_points,
    ),
)
def gravitating_bodies(
    inertias: Any = ((1.0, 2.0, 2.5), (1.0, 1.0, 1.5)),
    masses: npt.ArrayLike | None = None,
    G: float = 1.0,
    order: int | str = 2,
    higher_moments: npt.ArrayLike | None = None,
    surfaces: Any = None,
) -> BodiesSystem:
    """Return rigid bodies under their mutual gravity: the full problem of two or more bodies, orbits and rotations.

    Choose it for binary asteroids, planets with moons, or a satellite and its planet where the orbit feels the
    rotation. For a satellite about a point alone, all in the body frame, see `satellite`. As `bodies`, with ``V = -G
    sum over pairs of m_i m_j/s + (m_j (tr I_i - 3 u . I_i u) + m_i (tr I_j - 3 u . I_j u))/(2 s^3)``, s the distance
    of the centres and u its direction: MacCullagh's expansion to the second moments of both bodies. It is computed from
    the anisotropic parts of the inertias alone, so that torques do not lose digits. To order 4 the terms of both second
    moments together, and of third and fourth moments, are added: those of bodies from meshes, and of homogeneous
    ellipsoids of these inertias for others. Terms that are left out are about (size/s)^4 of the leading one to order 2,
    and (size/s)^6 to order 4, for bodies that are symmetric about their centres, and a power less for others.

    Parameters
    ----------
    inertias : sequence of k (3,), (3, 3) or co.bodies.MassProperties
        Principal moments or inertia tensor of each body, in its own frame (mass times length squared), or a body from a
        file (`co.bodies.read`). The moment along a rod is zero, and so are those of a point.
    masses : (k,), optional
        Masses, positive. By default those of bodies from files, and otherwise 3 and 1.
    G : float
        Gravitational constant, positive; 6.6743e-11 in SI units.
    order : {2, 4, 0, "polyhedron"}
        Order of the expansion in the sizes of the bodies; to order 0 they attract each other as points. With
        ``"polyhedron"`` those with a surface have their full field, and the others are of order 2.
    higher_moments : (k, 25), optional
        Third and fourth moments of each body about its centre of mass, for `order` 4: integrals over the mass of the
        products xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz, then xxxx, xxxy, ..., zzzz of the coordinates in its
        frame (mass times length cubed, and to the fourth). By default those of bodies from meshes, and of ellipsoids.
    surfaces : sequence of k (vertices, triangles) or None, optional
        Closed surface of each body for ``order="polyhedron"``, None or () for a body without one: vertices (n, 3) from
        its centre of mass in its frame (length), and triangles (m, 3), the numbers of their vertices counter-clockwise
        seen from outside, at most 10^5. The mass is spread evenly within it. By default those of bodies from meshes.

    Returns
    -------
    BodiesSystem
        As from `bodies`. Integrals: the total momentum ``"total p1"``, ... and angular momentum ``"total L1"``, ... in
        space. Their spins about an axis of symmetry are constant as well.

    Raises
    ------
    TypeError, ValueError
        Arguments of wrong shapes, moments or masses that no body has, `G` that is not positive, another order,
        `higher_moments` without order 4, `surfaces` without the order of polyhedra or the reverse, or a surface that is
        open, turned inside out, or not about its centre of mass. From the energy and its gradient: a state with a body
        on or below the surface of a polyhedron.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body; or an inertia differs by
        more than 1 per cent from that of the homogeneous body in its surface.

    Notes
    -----
    MacCullagh (1855); Maciejewski, Celest. Mech. Dyn. Astron. 63, 1 (1995), for the full two-body problem. The fourth
    moments of an ellipsoid are 5/(7 m) times the products of its second moments. Polyhedra: Werner and Scheeres,
    Celest. Mech. Dyn. Astron. 65, 313 (1997). The rounding of their field is about 1e-15 (s/size)^2 of it; beyond 500
    sizes, where this is as large as what the second order leaves out, they are of second order. With
    ``Splitting(parts="free_body")`` the parts are the free bodies, one kick, and straight paths of the centres.

    Examples
    --------
    >>> import coadjoint as co
    >>> pair = co.systems.gravitating_bodies(masses=(3.0, 1.0))
    >>> x0 = pair.state([[-1, 0, 0], [3, 0, 0]], [[0, -0.25, 0], [0, 0.75, 0]], angular_velocities=[[0, 0, 0.3]] * 2)
    >>> sol = co.integrate(pair, x0, (0, 10), 0.05, co.Splitting(order=4, parts="free_body"))
    >>> bool(sol.drift()["energy"] < 1e-6), sol.rotation.as_matrix().shape
    (True, (402, 3, 3))

    The force on a point over a vertex of a tetrahedron, whose surface is given, and over a face of it:

    >>> corners = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
    >>> faces = [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]
    >>> rock = co.systems.gravitating_bodies(
    ...     [[1.2] * 3, [0, 0, 0]], (3.0, 1.0), order="polyhedron", surfaces=[(corners, faces), None]
    ... )
    >>> for place in ([1.2, 1.2, 1.2], [-1.2, -1.2, -1.2]):
    ...     rock.vector_field(rock.state([[0, 0, 0], place]))[27:30].round(3)
    array([-0.456, -0.456, -0.456])
    array([0.376, 0.376, 0.376])
    """
    found, m = read_bodies(inertias, masses, (3.0, 1.0))
    gravity = read_in_range(G, "G")
    full = isinstance(order, str) and order == POLYHEDRON
    if not full and (not is_integer(order) or order not in ORDERS):
        raise ValueError(
            f"order is {short(order)}; mutual gravity is implemented to order 0, 2 or 4 in the sizes, and with "
            f"order={POLYHEDRON!r} in full"
        )
    check_products("G and masses", lambda: gravity * m[:, None] * m)
    others: dict[str, Any] = {"order": POLYHEDRON if full else int(order)}
    higher = _read_higher_moments(higher_moments, others["order"], found, m)
    others["higher_moments"] = None if higher is None else as_tuples(higher)
    others["surfaces"] = _read_surfaces(surfaces, others["order"], found, m)
    parameters = {**inertial_parameters(found, m), "G": gravity, **others}
    tensors = np.array([one.tensor for one in found])
    V = _potential(tensors, m, np.array(gravity), **others).hamiltonian()
    integrals = momentum_in_space(len(found), 18 * len(found) + 1)
    return system_of_bodies("gravitating_bodies", found, m, V, parameters, integrals)
