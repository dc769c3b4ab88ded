"""Forces of the registry as text."""

from __future__ import annotations

import inspect
from typing import Any

import coadjoint as co

VALUES = {
    "rate": "0.2",
    "torque": "0.1 * np.cos(np.arange({0.dim}))",
    "alpha": "0.05",
    "nu": "0.02",
    "beta": "0.5",
    "energy_rate": "0.1",
    "band": "(1, 2)",
    "seed": "3",
    "temperature": "0.1",
    "function": "f.damped",
    "mu": "0.5",
    "position": "(1.0, -0.5, 0.25)",
    "moment": "(0.1, 0.2, -0.1)",
    "B": "(0.3, -0.2, 0.1)",
    "pressure": "0.05",
    "sun": "(0.6, 0.0, 0.8)",
    "density": "0.05",
    "velocity": "(1.0, 0.5, 0.0)",
    "areas": "(0.5,)",
    "normals": "((0.6, 0.8, 0.0),)",
    "centres": "((0.0, 0.2, 0.3),)",
    "stiffness": "0.1",
    "damping": "0.2",
}
"""A value for each parameter; a force with a new one needs an entry here."""
OF_MATRICES = "0.1 * system.algebra.projected(np.random.default_rng(5).normal(size={0.shape}) * (0.5 + 0.5j))"
GIVEN_ANYWAY = ("temperature", "seed")


def force_text(name: str, system: Any) -> str:
    """Return a registered force as text; with matrices `system` is the name of the system."""
    parameters = inspect.signature(getattr(co.forces, name)).parameters.values()
    given = [p.name for p in parameters if p.default is p.empty or p.name in GIVEN_ANYWAY]
    values = VALUES | ({"torque": OF_MATRICES} if system.has_matrices else {})
    return f"co.forces.{name}({', '.join(f'{key}={values[key].format(system)}' for key in given)})"


def is_noise(name: str) -> bool:
    """Return whether a force draws random numbers."""
    return "seed" in inspect.signature(getattr(co.forces, name)).parameters
