"""Draw `docs/tumbling.png`, the usual steps of a free body beside the exact one: ``python docs/draw_tumbling.py``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import coadjoint as co

PICTURE = Path(__file__).with_name("tumbling.png")
Floats = NDArray[np.float64]
INERTIA, TURNS, STEPS_PER_TURN = np.array([1.0, 1.5, 2.5]), 30, 60
START = np.array([0.05, 1.0, 0.02])
"""Angular velocity, almost about the middle axis."""


def turned(q: Floats, w: Floats) -> Floats:
    """Return half the product of a quaternion (w, x, y, z) with an angular velocity of the body."""
    return 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])


def hat(w: Floats) -> Floats:
    """Return the matrix of the cross product by a vector."""
    return np.cross(np.eye(3), w)


def slope(w: Floats) -> Floats:
    """Return the acceleration by the gyroscopic term."""
    return np.cross(INERTIA * w, w) / INERTIA


def explicit(h: float, w: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Semi-implicit Euler: the new velocity turns the body."""
    w = w + h * slope(w)
    q = q + h * turned(q, w)
    return w, q / np.linalg.norm(q)


def implicit(h: float, w: Floats, q: Floats) -> tuple[Floats, Floats]:
    """One iteration of Newton's method for the implicit gyroscopic term."""
    jacobian = np.diag(INERTIA) + h * (hat(w) @ np.diag(INERTIA) - hat(INERTIA * w))
    w = w - np.linalg.solve(jacobian, h * np.cross(w, INERTIA * w))
    q = q + h * turned(q, w)
    return w, q / np.linalg.norm(q)


def runge_kutta(h: float, w: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Take a step of the classical method of order 4, and normalize the quaternion."""
    a, b = [], []
    for c in (0.0, 0.5, 0.5, 1.0):
        x, p = (w + c * h * a[-1], q + c * h * b[-1]) if a else (w, q)
        a.append(slope(x))
        b.append(turned(p, x))
    w, q = (v + h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3]) for v, k in ((w, a), (q, b)))
    return w, q / np.linalg.norm(q)


def matrix(q: Floats) -> Floats:
    """Return the rotation matrix of a unit quaternion."""
    axis = hat(q[1:])
    return np.eye(3) + 2 * q[0] * axis + 2 * axis @ axis


STEPS: dict[str, Callable[[float, Floats, Floats], tuple[Floats, Floats]]] = {
    "Euler, explicit term": explicit,
    "Euler, implicit term": implicit,
    "Runge-Kutta of order 4": runge_kutta,
}


def states(name: str, h: float, steps: int) -> tuple[Floats, Floats]:
    """Return the momenta of the body, and those in space, of a run by one of the methods or by the exact step."""
    if name == "exact":
        body = co.systems.rigid_body(INERTIA)
        sol = co.integrate(body, INERTIA * START, (0, steps * h), h, co.Splitting(parts="free_body"), attitude=True)
        return sol.x, np.einsum("kij,kj->ki", sol.attitude, sol.x)
    w, q, momenta, space = START, np.array([1.0, 0.0, 0.0, 0.0]), [INERTIA * START], [INERTIA * START]
    for _ in range(steps):
        w, q = STEPS[name](h, w, q)
        momenta.append(INERTIA * w)
        space.append(matrix(q) @ (INERTIA * w))
    return np.array(momenta), np.array(space)


def draw() -> plt.Figure:
    """Return energy, velocity about the middle axis and error of the momentum in space over turns of the body."""
    h = 2 * np.pi / np.linalg.norm(START) / STEPS_PER_TURN
    turns = np.arange(TURNS * STEPS_PER_TURN + 1) / STEPS_PER_TURN
    figure, panels = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    for name, style in zip((*STEPS, "exact"), ("C3", "C1", "C0", "k--"), strict=True):
        x, space = states(name, h, TURNS * STEPS_PER_TURN)
        energy = (x**2 / INERTIA).sum(axis=1)
        error = np.linalg.norm(space - space[0], axis=1) / np.linalg.norm(space[0])
        panels[0].plot(turns, energy / energy[0], style, label=name)
        panels[1].plot(turns, x[:, 1] / INERTIA[1], style)
        panels[2].semilogy(turns[1:], np.maximum(error[1:], 1e-17), style)
    panels[0].set(ylim=(0.5, 1.8))
    panels[1].set(ylim=(-1.5, 1.5))
    titles = ("energy, relative to the start", "velocity about the middle axis", "error of the momentum in space")
    for panel, title in zip(panels, titles, strict=True):
        panel.set(xlabel="turns", title=title)
    figure.legend(loc="outside lower center", ncols=4)
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=75)
