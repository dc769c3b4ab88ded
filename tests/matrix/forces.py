"""Registered forces: by the example of their class, as objects and as text."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

import coadjoint as co

from . import functions
from .results import momenta

TORQUE = "0.1 * np.cos(np.arange({0.dim}))"
OF_MATRICES = "0.1 * system.algebra.projected(np.random.default_rng(5).normal(size={0.shape}) * (0.5 + 0.5j))"


def force_text(name: str, system: Any) -> str:
    """Return a registered force as text; with matrices `system` is the name of the system."""
    given = {key: repr(value) for key, value in getattr(co.forces, name).example.items()}
    if name == "OwnForce":
        given = {"function": "f.damped"}
    if name == "Torque":
        given = {"torque": (OF_MATRICES if system.has_matrices else TORQUE).format(system)}
        if not system.has_matrices and not (taken := momenta(system)).all():
            given["torque"] += f" * np.array({taken.astype(int).tolist()})"
    return f"co.forces.{name}({', '.join(f'{key}={value}' for key, value in given.items())})"


def is_noise(name: str) -> bool:
    """Return whether a force draws random numbers."""
    return bool(getattr(co.forces, name).random)


def force_on(name: str, system: Any) -> co.forces.Force:
    """Return a registered force for a system."""
    if name in ("OwnForce", "Torque"):
        return eval(force_text(name, system), {"np": np, "co": co, "f": functions, "system": system})
    kind = getattr(co.forces, name)
    return kind(**kind.example)


FIRST_FITTING = (
    lambda: co.systems.rigid_body((1.0, 2.0, 2.5)),
    lambda: co.systems.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3), gyros=np.eye(3)[[(0, 1), (1, 2), (2, 0)]]),
    lambda: co.systems.torus_euler(N=5),
    lambda: co.systems.spin_lattice("chain", 3),
)


def first_fitting(name: str) -> Any:
    """Return a system with a registered force."""
    for system in (make() for make in FIRST_FITTING):
        with suppress(TypeError, ValueError):
            return system.with_forces(force_on(name, system))
    raise ValueError(f"no system takes {name}")
