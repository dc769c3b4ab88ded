"""Systems and schemes of the self-test."""

from __future__ import annotations

import importlib.resources
import json
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra import catalogue
from coadjoint.methods import registry
from coadjoint.methods.forced import check_supports
from coadjoint.methods.protocol.method import Method
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems

Array = NDArray[Any]

SYSTEM_NAMES = {
    "so(3)": "rigid_body",
    "se(3)": "heavy_top",
    "so(4)": "so_n_body",
    "A3,7": "paper_a37",
    "su(3)": "",
    "so(5)": "matrix_body",
    "torus": "torus_euler",
}


@cache
def systems() -> Mapping[str, Any]:
    """Return the systems by the name of their algebra: bodies, a top, a solvable algebra, matrices."""
    factories = ready_made_systems()
    result = {key: factories[name]() for key, name in SYSTEM_NAMES.items() if name not in ("", "torus_euler")}
    result["su(3)"] = LiePoissonSystem(catalogue.get("su(3)"), Quadratic(np.linspace(0.5, 2.25, 8)), name="su(3)")
    result["torus"] = factories["torus_euler"](N=5)
    return {key: result[key] for key in SYSTEM_NAMES}


def state_of(system: Any, number: int = 0) -> Array:
    """Return a state of cosines of 1 + `number`, 2 + `number`, ...; a random one for complex matrices."""
    if not system.has_matrices:
        return np.cos(1.0 + number + np.arange(system.dim))
    if system.complex:
        return np.asarray(system.random(1 + number, degrees=(1, 2)))  # type: ignore[attr-defined]
    return as_matrix(np.cos(1.0 + number + np.arange(10)), 5)


def as_matrix(entries: Array, n: int) -> Array:
    """Return the skew matrix with the given entries below the diagonal, row by row."""
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n, -1)] = entries
    return matrix - matrix.T


@cache
def references() -> Mapping[str, Array]:
    """Return reference states at t = 1, computed with 40 digits; the torus has none."""
    file = importlib.resources.files(__package__) / "references.json"
    states = json.loads(file.read_text(encoding="utf-8"))["states"]
    return {key: as_matrix(np.array(state), 5) if key == "so(5)" else np.array(state) for key, state in states.items()}


def schemes(index: int = 0) -> list[Method]:
    """Return one example of every scheme of the library, by default the first."""
    kinds = [registry.scheme(name) for name in registry.names()]
    return [kind.examples()[index] for kind in kinds if kind.__module__.startswith("coadjoint.")]


def more_schemes() -> list[Method]:
    """Return the first and last example of every scheme, such as one of a higher order."""
    return list(dict.fromkeys([*schemes(), *schemes(-1)]))


def supported_systems(method: Method) -> dict[str, Any]:
    """Return the systems that a scheme supports, by name."""
    supported = {}
    for key, system in systems().items():
        try:
            check_supports(system, method)
        except (TypeError, ValueError):
            continue
        supported[key] = system
    return supported
