"""Runs without integration, the axes of one picture, and the geometry of spheres, for tests that read artists back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

import coadjoint as co

Picture = co.plotting.Picture
T0 = 7.3
SENSES = [1.0, -1.0]
TURN = 2.0 * np.pi * np.arange(200) / 200
VIEW = (35.0, 22.0)
BODY = co.systems.rigid_body((1.0, 2.0, 3.0))
SPIN = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 1.0]))
BARE = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.7]), casimirs={})


def made(x: Any, system: Any = BODY, t: Any = None, **series: Any) -> co.Solution:
    """Return a solution of given states, of members if x is (k, members, n); there are no states between them."""
    t = T0 + 0.01 * np.arange(len(x)) if t is None else t
    members = x.ndim - len(getattr(system, "shape", (1,))) - 1
    empty = dict.fromkeys(("events", "carried", "attitude", "incomplete", "t_eval", "choice"))
    fields = {**empty, "energy": np.zeros(x.shape[: 1 + members]), "casimirs": {}, "work": {}, "observed": {}}
    fields |= {"stats": SimpleNamespace(seconds=0.0, steps=1), **series}
    fields.setdefault("failed", np.zeros(x.shape[1], dtype=bool) if members else None)
    invariants = {"energy": fields["energy"], **fields["casimirs"]}
    start = {"x0": x[0], "t_span": (t[0], t[-1]), "initial": {name: values[0] for name, values in invariants.items()}}

    def at(self: co.Solution, times: Any) -> Any:
        raise ValueError("there are no states between the saved points")

    methods = {"__init__": lambda self: None, "at": at}
    return type("Made", (co.Solution,), {"t": t, "x": x, "system": system, **start, **fields, **methods})()


def made_at(t: Any, x: Any, system: Any = BODY, **series: Any) -> co.Solution:
    """Return a solution of given times and states."""
    return made(x, system, t, **series)


def shown(run: Any, picture: Any, members: Any = None, **options: Any) -> Any:
    """Return the axes of one picture as `plot` draws it, without the time of a layout."""
    if isinstance(picture, str) and (options or run.__class__.__name__ == "Made"):
        picture = Picture(picture, **options)
    kind = co.plotting.kinds()[picture if isinstance(picture, str) else picture.kind]
    axes = Figure().add_subplot(projection=kind.projection)
    run.plot([picture], axes=axes, members=members)
    return axes


def axes_of(run: Any, name: str, members: Any = None, **options: Any) -> Any:
    """Return the axes of a kind of picture with its own defaults, whatever the system declares."""
    return shown(run, Picture(name, **options), members)


def data(line: Any) -> np.ndarray:
    return np.asarray(line.get_data(), dtype=np.float64)


PALETTE = [line.get_color() for line in axes_of(made(np.ones((3, 3))), "components").lines[:3]]


def colour(i: int) -> Any:
    """Return the colour of one of the first three lines."""
    return PALETTE[i]


class MemberColours:
    """Colours of members: parts of viridis by their energies at the start."""

    def __init__(self, run: Any, lightest: float = 0.88) -> None:
        energy = np.atleast_1d(run.initial["energy"])
        self.shares = lightest * (energy - energy.min()) / np.ptp(energy)

    def __getitem__(self, m: int) -> Any:
        return colormaps["viridis"](self.shares[m])


class Globe:
    """Seen from a direction (degrees around the third axis, and above the plane of the others)."""

    def __init__(self, view: tuple[float, float] = VIEW) -> None:
        around, above = np.radians(view)
        towards = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
        right = np.array([-np.sin(around), np.cos(around), 0.0])
        self.frame = np.stack([right, np.cross(towards, right), towards])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places in the picture, and the depths towards the viewer."""
        seen = np.asarray(points) @ self.frame.T
        return seen[..., :2], seen[..., 2]


def rotations(axis: Any, angles: np.ndarray) -> np.ndarray:
    """Return rotations about an axis, (k, 3, 3)."""
    u = np.array(axis, dtype=np.float64) / np.linalg.norm(axis)
    hat = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    s, c = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + s * hat + (1.0 - c) * hat @ hat


def spinning(phase: np.ndarray, t: np.ndarray, sense: float = 1.0) -> Any:
    """Return a spin that turns at the rate 1."""
    rising = np.sign(SPIN.vector_field(np.array([1.0, 0.0, 0.0]))[1])
    return made(np.stack([np.cos(phase), sense * rising * np.sin(phase), 0.0 * t + 0.5], axis=-1), SPIN, t)


def partial(*args: Any, **options: Any) -> co.Solution:
    """Return the part of a run that fails."""
    try:
        co.integrate(*args, **options)
    except co.IntegrationError as error:
        return error.partial
    raise AssertionError("the run did not fail")
