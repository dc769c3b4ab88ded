"""Descent of the energy of spins in small rotations, which stays in the valley of its start."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.long_operations import note_progress
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = npt.NDArray[np.float64]

FIRST_TURN, LARGEST_TURN = 1e-4, 0.05  # radians of any spin in the first and in one step, which may not cross barriers
MAX_STEPS = 50_000


class SpinSurface:
    """The energy of directions of spins (sites, 3) of constant lengths, plus a linear one, and its derivatives."""

    def __init__(self, system: Any, x: Floats, linear: Any = 0.0) -> None:
        self.system, self.linear = system, linear
        self.lengths = np.linalg.norm(x.reshape(-1, 3), axis=1, keepdims=True)
        anywhere = normalized(np.random.default_rng(0).standard_normal(self.lengths.shape[:1] + (3,)))
        self._typical = float(np.abs(self.gradient(anywhere) - self.linear).max(initial=0.0))

    def directions(self, x: Floats) -> Floats:
        """Return the directions of a state; zero where a spin has no length."""
        return x.reshape(-1, 3) / np.where(self.lengths > 0.0, self.lengths, 1.0)

    def state(self, s: Floats) -> Floats:
        return (self.lengths * s).ravel()

    def energy(self, s: Floats) -> float:
        return float(self.system.energy(self.state(s)) + (self.linear * s).sum())

    def scale(self, gradient: Floats) -> float:
        """Return the size of the fields: the gradients of terms of degree four may vanish at a minimum."""
        return max(float(np.abs(gradient).max(initial=0.0)), self._typical)

    def gradient(self, s: Floats) -> Floats:
        """Return the derivatives of the energy by directions, also along them."""
        return self.lengths * np.asarray(self.system.hamiltonian.gradient(self.state(s))).reshape(-1, 3) + self.linear


def tangential(s: Floats, v: Floats) -> Floats:
    """Return the parts of vectors perpendicular to directions."""
    return v - (v * s).sum(axis=-1, keepdims=True) * s


def normalized(s: Floats) -> Floats:
    """Return vectors at length one; zero remains."""
    lengths = np.linalg.norm(s, axis=-1, keepdims=True)
    return s / np.where(lengths > 0.0, lengths, 1.0)


def angles(s: Floats, other: Floats) -> Floats:
    """Return the angles between directions, (..., sites), accurate also for small ones."""
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(s - other, axis=-1), 0.0, 1.0)))


def tilted(s: Floats, angle: float, seed: int) -> Floats:
    """Return directions that are turned at random by angles of this order."""
    noise = np.random.default_rng(seed).standard_normal(s.shape)
    return normalized(s + angle * tangential(s, noise))


def descend(surface: SpinSurface, s: Floats, tolerance: float) -> Floats:
    """Return the minimum of the valley of s: torques at most a tolerance times the largest field.

    Steps are those of Barzilai and Borwein, at most `LARGEST_TURN`, and halved where the energy rises.
    """
    energy, gradient = surface.energy(s), surface.gradient(s)
    torque, step = tangential(s, gradient), np.inf
    for count in range(MAX_STEPS):
        scale = surface.scale(gradient)
        largest = float(np.linalg.norm(torque, axis=1).max(initial=0.0))
        if largest <= tolerance * scale:
            return s
        if count % 1000 == 999:
            note_progress(f"a minimum, now with torques of {largest / scale:.1e} of the fields")
        step = min(step, (LARGEST_TURN if count else FIRST_TURN) / largest)
        rounding = 64.0 * UNIT_ROUNDOFF * scale * len(s)
        while True:
            moved = normalized(s - step * torque)
            new = surface.energy(moved)
            if new <= energy + rounding or step * largest < UNIT_ROUNDOFF:
                break
            step *= 0.5
        gradient = surface.gradient(moved)
        turned, changed = moved - s, tangential(moved, gradient) - torque
        curvature = float((turned * changed).sum())
        step = float((turned**2).sum()) / curvature if curvature > 0.0 else np.inf
        s, energy, torque = moved, new, torque + changed
    raise RuntimeError(
        f"no minimum of {surface.system.name} was found in {MAX_STEPS} steps: torques are {largest / scale:.1e} of the "
        "fields; give a start nearer to one, or a larger tolerance"
    )
