"""Pictures of systems of bodies: of any number of them, and of points, which have no attitude."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.gallery_entry import Picture

MAX_DRAWN_BODIES = 8  # as many as there are colours


def drawn_bodies(dim: int, first: int = 1) -> range:
    """Return the numbers from `first` on, counted from 1, of the bodies that default pictures show."""
    return range(first, min(dim // (PER_BODY + 6), MAX_DRAWN_BODIES) + 1)


def turning_bodies(system: Any) -> list[int] | None:
    """Return the numbers of the drawn bodies that are no points; None if all are, or the system has no bodies."""
    found = [k for k, inertia in enumerate(getattr(system, "inertias", ()), 1) if inertia.tensor.any()]
    if len(found) == len(getattr(system, "inertias", ())):
        return None
    return [k for k in found if k <= MAX_DRAWN_BODIES]


def paths_of_bodies(system: Any, title: str, origin: Any = None) -> Picture:
    """Return the picture of the paths of the centres in the plane of the first two axes, about an origin."""

    def component(i: int) -> Any:
        def of_states(x: Any) -> Any:
            r = system.positions(x)
            return (r if origin is None else r - origin(r))[..., :MAX_DRAWN_BODIES, i]

        return of_states

    return Picture(
        "phase portrait",
        across=component(0),
        up=component(1),
        labels=("$r_1$", "$r_2$"),
        equal=True,
        curves=lambda dim: [f"body {k}" for k in drawn_bodies(dim)],
        title=title,
    )


def position_of_first() -> Picture:
    """Return the picture of the position of the first body over time."""
    return Picture("components", chosen=[f"r{i}[1]" for i in (1, 2, 3)], quantity="position of the first body")


def momenta_of_bodies(dim: int) -> dict[str, list[str]]:
    """Return the coordinates of the angular momentum of each drawn body, by name."""
    return {f"body {k}": [f"L{i}[{k}]" for i in (1, 2, 3)] for k in drawn_bodies(dim)}


def relative_positions(x: Any) -> Any:
    """Return the positions of the other drawn bodies relative to the first, (..., bodies - 1, 3)."""
    count = x.shape[-1] // (PER_BODY + 6)
    r = x[..., (PER_BODY + 3) * count : (PER_BODY + 6) * count].reshape(*x.shape[:-1], count, 3)
    return r[..., 1:MAX_DRAWN_BODIES, :] - r[..., :1, :]


def distance_from_first(x: Any, k: int) -> Any:
    """Return the distance of the centres of body k and the first one."""
    return np.linalg.norm(relative_positions(x)[..., k - 2, :], axis=-1)


def distances_of_bodies(dim: int) -> dict[str, Any]:
    """Return the distances of the other drawn bodies from the first, by name, as functions of states."""
    names = {k: f"from 1 to {k}" if drawn_bodies(dim)[-1] > 2 else "distance" for k in drawn_bodies(dim, 2)}
    return {name: partial(distance_from_first, k=k) for k, name in names.items()}


def third_axes_of_bodies(dim: int) -> dict[str, list[str]]:
    """Return the third axis of each molecule, or body, in space, by its components."""
    return {f"molecule {k}": [f"{axis}3[{k}]" for axis in "XYZ"] for k in drawn_bodies(dim)}


DIPOLES = Picture("directions", vectors=third_axes_of_bodies, title="directions of the dipoles in space")
"""Picture of molecules of water, whose third axes are their dipoles."""


def pictures_beside_points(system: Any) -> dict[str, Any]:
    """Return the pictures of bodies of which some are points: momenta of the others, or paths if there are none."""
    turning = turning_bodies(system)
    if turning is None:
        return {}
    if not turning:
        return {"pictures": (paths_of_bodies(system, "paths of the points"),), "components": position_of_first()}
    momenta = momenta_of_bodies(system.dim)
    shown = {f"body {k}": momenta[f"body {k}"] for k in turning}
    first = f"angular momentum of body {turning[0]}"
    return {
        "pictures": (Picture("directions", vectors=shown, title="angular momenta in the body frames"),),
        "components": Picture("components", chosen=shown[f"body {turning[0]}"], quantity=first),
    }


def pictures_of_molecules(system: Any, declared: Any) -> dict[str, Any]:
    """Return the pictures of molecules of other sites than `declared`: their third axes, or lines; paths of atoms."""
    inertias = getattr(system, "inertias", ())
    if not inertias or (system.parameters or {}).get("sites") == declared:
        return {}
    shown = {}
    for k, inertia in enumerate(inertias[:MAX_DRAWN_BODIES]):
        if inertia.tensor.any():
            axis = np.eye(3)[2] if inertia.rotating is None else np.linalg.eigh(inertia.tensor)[1][:, 0]
            forms = np.zeros((3, system.dim))
            forms[np.arange(9) // 3, PER_BODY * k + 3 + np.arange(9)] = np.tile(axis, 3)
            shown[f"molecule {k + 1}"] = forms
    if not shown:
        single = {"components": position_of_first()} if len(inertias) == 1 else {}
        return {"pictures": (paths_of_bodies(system, "paths of the atoms"),), **single}
    directions = Picture("directions", vectors=shown, title="axes of the molecules in space")
    return {"pictures": (directions, Picture("bodies"))}
