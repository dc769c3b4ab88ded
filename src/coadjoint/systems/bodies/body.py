"""One rigid body with its attitude in the state, for torques that see the attitude, and the algebras of such bodies."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.classical import so
from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import copies, direct_sum, semidirect
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.short_repr import short
from coadjoint.systems.bodies.body_systems import BodySystem
from coadjoint.systems.bodies.inertia import (
    energy_with_rotors,
    inverse_of_moving,
    names_of_rotors,
    read_body_inertia,
    read_rotors,
)
from coadjoint.systems.bodies.mass_properties import InertiaLike
from coadjoint.systems.bodies.rigid_body import rotations
from coadjoint.systems.closed_forms.closed_form import move_state
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution, free_motion
from coadjoint.systems.coordinates import numberless
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.registry import ready_made
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.validation import as_tuples, read_bool, read_integer

AXES = ("X", "Y", "Z")
SECOND_AXIS = ("Y1", "Y2", "Y3")
MAX_RECORDED_BODIES = 64
"""Largest number of bodies whose axes are recorded as Casimirs in every run."""


@cache
def attitude_algebra() -> LieAlgebra:
    """Return so(3) acting on X, Y, Z, the space axes seen from the body; its matrices are (6, 6), rotations first."""
    rotations = so(3).representation
    assert rotations is not None
    action = np.zeros((3, 9, 9))
    for k in range(3):
        action[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = rotations
    g = semidirect(so(3), action)
    matrices = np.zeros((PER_BODY, 6, 6))
    matrices[:3, :3, :3] = rotations
    for k in range(3):
        matrices[range(3 + 3 * k, 6 + 3 * k), range(3), 3 + k] = 1.0
    basis = tuple(f"{letter}{i}" for letter in ("L", *AXES) for i in (1, 2, 3))
    return LieAlgebra(
        np.column_stack([*g.triples]), dim=PER_BODY, basis=basis, name="so(3) ⋉ R^(3 x 3)", representation=matrices
    )


@lru_cache(maxsize=16)
def with_carried(g: LieAlgebra, names: tuple[str, ...]) -> LieAlgebra:
    """Return an algebra of body with further coordinates that commute with all: motion carries them unchanged."""
    if not names:
        return g
    assert g.representation is not None
    matrices = np.zeros((g.dim + len(names), *g.representation.shape[1:]))
    matrices[: g.dim] = g.representation
    label = f"{g.name} + R^{len(names)}"
    return LieAlgebra._from_valid(g.triples, len(matrices), (*g.basis, *names), label, matrices, {})


@lru_cache(maxsize=16)
def bodies_algebra(count: int) -> LieAlgebra:
    """Return the algebra of (L, X, Y, Z) of each body, the momenta p and positions r of all centres, and z."""
    # With the body sign, -1, the bracket z = [p, r] makes ``r' = dH/dp``.
    g = direct_sum(copies(attitude_algebra(), count), heisenberg(3 * count))
    numbered = range(1, count + 1)
    basis = (
        *(f"{name}[{body}]" for body in numbered for name in attitude_algebra().basis),
        *(f"{letter}{i}[{body}]" for letter in ("p", "r") for body in numbered for i in (1, 2, 3)),
        "z",
    )
    name = f"{count} so(3) ⋉ R^(3 x 3) + heisenberg({3 * count})"
    return LieAlgebra._from_valid(g.triples, g.dim, basis, name, None, {})


def axis_products(count: int, dim: int, alone: bool = False) -> KnownInvariants:
    """Return the products of the space axes of each body, which are Casimirs; none of more than 64 bodies."""
    found: dict[str, Callable[[], Quadratic]] = {}
    for body in range(count if count <= MAX_RECORDED_BODIES else 0):
        for a in range(3):
            for b in range(a, 3):
                label = f"{AXES[a]}.{AXES[b]}"
                name = label if alone or dim == PER_BODY else f"{label} [{body + 1}]"
                found[name] = partial(_axis_product, dim, body, a, b)
    return KnownInvariants(found)


@lru_cache(maxsize=1024)
def _axis_product(dim: int, body: int, a: int, b: int) -> Quadratic:
    """Return the product of two space axes of a body, which members of an ensemble share."""
    return _form(dim, [(_axis(body, a, i), _axis(body, b, i), 1.0 + (a == b)) for i in range(3)])


def momentum_in_space(count: int, dim: int, alone: bool = False, turning: bool = True) -> KnownInvariants:
    """Return the components in space of the total momentum, and if `turning` the angular one, sum of A L + r x p."""
    # They are integrals at the states of bodies, where z = 1 and the axes are orthonormal, and not at others.
    found: dict[str, Callable[[], Quadratic]] = {}
    positions = dim > PER_BODY and not alone
    for axis in range(3) if positions else ():
        linear = np.zeros(dim)
        linear[PER_BODY * count + axis : (PER_BODY + 3) * count : 3] = 1.0
        found[f"total p{axis + 1}"] = partial(quadratic_form, dim, [], linear)
    for axis in range(3) if turning else ():
        pairs = [(PER_BODY * body + i, _axis(body, axis, i), 1.0) for body in range(count) for i in range(3)]
        second, third = (axis + 1) % 3, (axis + 2) % 3
        for body in range(count) if positions else ():
            p, r = PER_BODY * count + 3 * body, (PER_BODY + 3) * count + 3 * body
            pairs += [(p + third, r + second, 1.0), (p + second, r + third, -1.0)]
        found[f"total L{axis + 1}"] = partial(_form, dim, pairs)
    return KnownInvariants(found)


@lru_cache(maxsize=64)
def central_coordinate(dim: int) -> Quadratic:
    """Return the Casimir z, the last coordinate, which members of an ensemble share."""
    linear = np.zeros(dim)
    linear[-1] = 1.0
    return quadratic_form(dim, [], linear)


def _axis(body: int, axis: int, component: int) -> int:
    return PER_BODY * body + 3 + 3 * axis + component


def _form(dim: int, pairs: list[tuple[int, int, float]]) -> Quadratic:
    """Return the quadratic function with M_ij = M_ji = value for pairs (i, j, value)."""
    both = {(i, j): value for i, j, value in pairs} | {(j, i): value for i, j, value in pairs}
    return quadratic_form(dim, sorted((i, j, value) for (i, j), value in both.items()), np.zeros(dim))


def quadratic_form(dim: int, entries: list[tuple[int, int, float]], linear: npt.NDArray[np.float64]) -> Quadratic:
    """Return the function with these entries (i, j, M_ij), of both triangles, and linear coefficients."""
    rows, columns = (np.array([entry[k] for entry in entries], dtype=np.int64) for k in (0, 1))
    values = np.array([entry[2] for entry in entries], dtype=np.float64)
    return Quadratic.from_entries(dim, rows, columns, values, linear, 0.0)


Floats = npt.NDArray[np.float64]

MAX_HELD = 4096
"""Largest count of numbers that forces hold: far above that of any spacecraft, and small in memory."""


def _energy(
    inertia: npt.NDArray[Any], wheels: npt.NDArray[Any], *, gyros: npt.ArrayLike, attitude: bool, held: Any
) -> tuple[npt.NDArray[Any]]:
    """Return the matrix of the energy; its first three coordinates are the momentum."""
    held = len(held) if np.ndim(held) else held
    first, momenta = PER_BODY if attitude else 3, np.asarray(gyros, dtype=np.float64).reshape(-1, 2, 3)
    if len(wheels) + len(momenta) == 0:
        return (_in_state(inverse_of_moving(inertia), first + held),)
    tensor = inertia if inertia.ndim == 2 else np.diag(inertia)
    dim = first + len(wheels) + 2 * len(momenta) + held
    return (energy_with_rotors(tensor, wheels.reshape(-1, 3), momenta, first, dim),)


def _in_state(M: npt.NDArray[Any], dim: int) -> npt.NDArray[Any]:
    """Return the matrix of the energy of a state from the inverse inertia, (3,) or (3, 3)."""
    matrix = np.zeros((dim,) * M.ndim, dtype=M.dtype)
    matrix[tuple(slice(0, 3) for _ in M.shape)] = M
    return matrix


ATTITUDE = {
    "L": ("momentum", "mass length^2/time"),
    **{axis: ("axis", "1") for axis in AXES},
    "k": ("momentum", "mass length^2/time"),
    "cos": ("angle", "1"),
    "sin": ("angle", "1"),
    "held": ("memory", ""),
}
"""Kinds and units of the coordinates of a body, its rotors, and what forces hold."""
IN_SPACE = {
    **{name: ATTITUDE[name] for name in ("L", *AXES)},
    "p": ("momentum", "mass length/time"),
    "r": ("position", "length"),
    "z": ("constant", "1"),
}
"""Kinds and units of the coordinates of bodies with positions."""


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    coordinates=ATTITUDE,
    gallery_entry=GalleryEntry(
        x0=(0.01, 1.0, 0.01, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        t_span=(0.0, 90.0),
        step=0.05,
        caption="A body that spins about its middle axis, with its attitude in the state: the axis flips periodically "
        "in space. Left, the vertical as seen from the body, which its attitude turns.",
        pictures=(Picture("body axis", axis=1, up=SECOND_AXIS),),
        components=Picture("components", chosen=SECOND_AXIS, quantity="second axis of space, seen from the body"),
        quantity="state",
    ),
)
def body(
    inertia: InertiaLike = (1.0, 2.0, 2.5),
    attitude: bool = True,
    wheels: npt.ArrayLike = (),
    gyros: npt.ArrayLike = (),
    held: int | Sequence[str] = 0,
) -> BodySystem:
    """Return a rigid body with its attitude in the state: a satellite, a gyroscope, a rod.

    Choose it if a torque depends on the attitude, such as that of a pointing controller: ``co.forces.Torque(lambda x,
    A, t: ...)``, or if the body carries reaction wheels or control-moment gyros. For the free motion of the momentum
    alone `rigid_body` is cheaper, and for bodies with positions see `bodies`. The state is (L, X, Y, Z): the angular
    momentum in the body frame, and the three space axes seen from the body, which are the rows of the attitude A, from
    the body to space. The algebra is so(3) acting on three copies of R^3, with sign -1: ``L' = L cross Omega``, ``X' =
    X cross Omega``, and so on, ``Omega = I^-1 L``.

    With wheels and gyros L is the momentum of all together, ``Omega = M (L - R y)``, and the state ends with y: the
    momentum k of each wheel about its axis in space, and the cosine and the sine of each gimbal angle. Motion does not
    change y, and forces on y do not change L, so that motors keep the momentum in space to rounding.

    Parameters
    ----------
    inertia : (3,), (3, 3) or co.bodies.MassProperties
        Principal moments of inertia, or the inertia tensor in the body frame (mass times length squared), of the body
        with its wheels and gyros, locked. The moment along a rod is zero, and the other two are equal.
    attitude : bool
        Whether the attitude is part of the state; without it the state is L, as that of `rigid_body`.
    wheels : (m, 3)
        Reaction wheels: of each its moment of inertia about its axis, times the unit vector of the axis. Their motors
        are `co.forces.ReactionWheels`.
    gyros : (g, 2, 3)
        Control-moment gyros with a single gimbal: of each the momentum of its rotor at the gimbal angles 0 and 90
        degrees, orthogonal vectors of equal length. Their motors are `co.forces.ControlMomentGyros`.
    held : int or sequence of str
        Count, or names, of numbers at the end of the state that sampled forces hold; ``with_forces`` sets it.

    Returns
    -------
    BodySystem
        State: 12 numbers and those above; ``state(attitude=, angular_velocity=, wheel_speeds=, gimbal_angles=)`` makes
        it, and ``attitudes(x)``, ``angular_velocity(x, frame=)``, ``angular_momentum(x, frame=)``, ``wheel_speeds(x)``,
        ``gimbal_angles(x)`` read it. Solutions have ``rotation``, ``angular_velocity`` and ``angular_momentum``.
        Casimirs: the products of the axes, ``"X.X"``, ..., ``"Y.Z"``. Integrals of the free body: ``"total L1"``,
        ``"total L2"``, ``"total L3"``, the momentum in space. Without wheels and gyros ``exact(x0, t)`` in closed form,
        and with ``Splitting(parts="free_body")`` the free motion is one exact part, which turns the axes.

    Raises
    ------
    TypeError, ValueError
        `inertia` has another shape, or is not finite, symmetric and positive, but for the moment along a rod. `wheels`
        or `gyros` has another shape or a zero vector, or the moments of wheels exceed `inertia`.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Examples
    --------
    >>> import coadjoint as co
    >>> sat = co.systems.body((1.0, 2.0, 2.5))
    >>> x0 = sat.state(angular_velocity=(0.0, 0.0, 0.5))
    >>> sol = co.integrate(sat, x0, (0, 2), 0.1, co.Splitting(parts="free_body"))
    >>> sol.rotation[-1].as_rotvec().round(12)
    array([0., 0., 1.])
    """
    found = read_body_inertia(inertia)
    if not found.tensor.any():
        raise ValueError("inertia is zero: a point does not rotate; use co.systems.bodies for points with positions")
    turning, steering = read_rotors(wheels, gyros, found)
    attitude = read_bool(attitude, "attitude")
    carried = names_of_rotors(turning, steering)
    algebra = with_carried(attitude_algebra() if attitude else rotations(3), carried)
    held_names = _read_held(held, algebra.basis)
    count = len(held_names)
    algebra = with_carried(attitude_algebra() if attitude else rotations(3), (*carried, *held_names))
    parameters = {"inertia": found.given, "attitude": attitude, "wheels": as_tuples(turning)}
    parameters |= {"gyros": as_tuples(steering), "held": count if held_names == _numbered(count) else held_names}
    if carried:
        (M,) = _energy(found.tensor, turning, gyros=steering, attitude=attitude, held=count)
    else:
        M = _in_state(found.inverse, algebra.dim)
    return BodySystem(
        found,
        algebra,
        Quadratic(M),
        casimirs=axis_products(1, algebra.dim, alone=True) if attitude else None,
        integrals=momentum_in_space(1, algebra.dim, alone=True) if attitude else None,
        parameters=parameters,
        exact=None if carried else _closed_form(found.inverse, algebra.dim, attitude),
        wheels=turning,
        gyros=steering,
        held=count,
        layout={"coordinates": dict.fromkeys(map(numberless, held_names), "memory")} if count else None,
        sign=-1,
        name="body",
    )


def _numbered(count: int) -> tuple[str, ...]:
    """Return the names of commands that forces hold."""
    return tuple(f"held{i + 1}" for i in range(count))


def _read_held(held: Any, others: Sequence[str]) -> tuple[str, ...]:
    """Validate a count of numbers that forces hold, or their names, and return the names."""
    if not isinstance(held, (list, tuple, np.ndarray)) or (isinstance(held, np.ndarray) and not held.ndim):
        return _numbered(read_integer(held, "held", 0, MAX_HELD))
    names = tuple(map(str, held[: MAX_HELD + 1]))
    if not 0 < len(names) <= MAX_HELD or any(not re.fullmatch(r"[A-Za-z_]+[0-9]+", name) for name in names):
        raise ValueError(
            f"held is {short(held)}; give a count of at most {MAX_HELD}, or names, each with a number: integral1"
        )
    taken = [name for k, name in enumerate(names) if name in (*others, *names[:k])]
    if taken:
        raise ValueError(f"held has the name {taken[0]}, which is that of another coordinate; give other names")
    return names


def _closed_form(M: Floats, dim: int, in_state: bool) -> Callable[..., Any]:
    """Return the closed form of the free body, with the attitude beside the state if that is the momentum alone."""
    if dim == 3:
        return partial(exact_solution, M, -1)
    return partial(move_state, "body", dim, partial(_motion, M, PER_BODY if in_state else 3))


def _motion(M: Floats, moving: int, start: Floats, times: Floats) -> Floats:
    """Return the states of the free body, whose axes its attitude turns; the coordinates after the first are kept."""
    turning, kept = np.split(start, [moving])
    L, turned = free_motion(M, -1, turning[:3], times)
    axes = np.einsum("ai,...ij->...aj", turning[3:].reshape(-1, 3), turned)
    parts = L, axes.reshape(len(times), moving - 3), np.tile(kept, (len(times), 1))
    return np.concatenate(parts, axis=-1)
