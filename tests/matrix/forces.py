"""Forces of the registry as text."""

from __future__ import annotations

import inspect
from contextlib import suppress
from typing import Any

import numpy as np

import coadjoint as co

from . import functions
from .results import momenta

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
    if not system.has_matrices and not (taken := momenta(system)).all():
        values["torque"] += f" * np.array({taken.astype(int).tolist()})"
    return f"co.forces.{name}({', '.join(f'{key}={values[key].format(system)}' for key in given)})"


def is_noise(name: str) -> bool:
    """Return whether a force draws random numbers."""
    return "seed" in inspect.signature(getattr(co.forces, name)).parameters


def forces_on(system: Any) -> list[co.forces.Force]:
    """Return the registered forces that act on a system of vectors, dampers in place of springs without an attitude."""
    space = {"np": np, "co": co, "f": functions}
    names = [name for name in co.forces.names() if not issubclass(getattr(co.forces, name), co.forces.Sampled)]
    texts = [force_text(name, system) for name in names]
    laws = [text.replace("stiffness=0.1", "stiffness=0.0") for text in texts if "stiffness" in text]
    found = []
    for text in (*texts, *laws, *(f"co.forces.Sampled({text}, 0.25)" for text in laws)):
        with suppress(TypeError, ValueError, AttributeError):
            force = eval(text, space)
            system.with_forces(force)
            found.append(force)
    return found
