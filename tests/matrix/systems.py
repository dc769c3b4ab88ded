"""Systems as text: the registry, and systems on algebras of the catalogue with every kind of Hamiltonian."""

from __future__ import annotations

import inspect
import re
from functools import cache

import numpy as np

import coadjoint as co

SMALL = {"N": 5, "n": 3, "p": 2, "q": 1, "eps": 1}
"""Sizes of what would be large, and parameters that are whole numbers."""
LARGEST = 15


def numbers_of(values: np.ndarray) -> str:
    """Return an array as text."""
    return f"np.array({np.round(values, 3).tolist()})"


@cache
def algebra_text(name: str) -> str | None:
    """Return an algebra of the catalogue with parameters that it accepts; None if it is large or of one dimension."""
    given: dict[str, float] = {}
    values = iter((0.5, -0.5, 0.25, 1.0, -0.25) * 4)
    while True:
        try:
            dim = co.algebras.get(name, **given).dim
            break
        except ValueError as refusal:
            needed = re.search(r"needs the parameter '(\w+)'", str(refusal))
            names = [needed[1]] if needed else [key for key in given if key not in SMALL]
            for key in names:
                given[key] = SMALL.get(key, 4 if name.startswith("sp(") else next(values))
    options = "".join(f", {key}={value}" for key, value in given.items())
    return f"co.algebras.get({name!r}{options})" if 1 < dim <= LARGEST else None


def drawn_system(rng: np.random.Generator, timed: bool = False) -> str:
    """Return a system on an algebra of the catalogue."""
    names = co.algebras.names()
    text = None
    while text is None:
        text = algebra_text(names[rng.integers(len(names))])
    n = eval(text, {"co": co}).dim
    B = rng.uniform(-0.4, 0.4, (n, n))
    full = np.round(np.diag(rng.uniform(0.4, 1.4, n)) + B + B.T, 2)
    kind = rng.integers(5)
    if timed:
        wells = ", ".join(f"{i}: f.DRIVEN" for i in range(min(n, 2)))
        H = f"co.Quadratic({numbers_of(np.diag(full))}) + co.Separable({{{wells}}})"
    elif kind == 0:
        H = f"co.Quadratic({numbers_of(np.diag(full))})"
    elif kind == 1:
        H = f"co.Quadratic({numbers_of(full)}, linear={numbers_of(rng.uniform(-0.5, 0.5, n))})"
    elif kind == 2:
        H = f"co.Quadratic({numbers_of(full)})"
    elif kind == 3:
        terms = {tuple((2 * np.eye(n, dtype=int)[i]).tolist()): float(np.round(full[i, i], 2)) for i in range(n)}
        terms[tuple((3 * np.eye(n, dtype=int)[0]).tolist())] = 0.3
        terms[tuple((4 * np.eye(n, dtype=int)[n - 1]).tolist())] = 0.1
        terms[tuple((np.eye(n, dtype=int)[0] + np.eye(n, dtype=int)[n - 1]).tolist())] = -0.4
        H = f"co.Polynomial({terms})"
    else:
        wells = ", ".join(f"{i}: f.WELL" for i in range(n))
        H = f"co.Separable({{{wells}}})"
    return f"co.LiePoissonSystem({text}, {H}, sign={int(rng.choice([-1, 1]))})"


@cache
def registered(name: str) -> str:
    """Return a registered system, of a small size."""
    parameters = inspect.signature(getattr(co.systems, name)).parameters
    given = [f"{key}={SMALL[key]}" for key in parameters if key in SMALL]
    return f"co.systems.{name}({', '.join(given)})"


@cache
def systems() -> tuple[str, ...]:
    """Return every registered system."""
    return tuple(registered(name) for name in co.systems.names())


@cache
def varied(text: str, m: int) -> str:
    """Return a system like this one with another constant, if it has one, for member `m` of a batch."""
    if m == 0:
        return text
    if not text.startswith("co.systems."):
        text = re.sub(r"co\.Quadratic\(", f"co.Quadratic({1 + m / 8} * ", text)
        return text.replace("co.Polynomial(", f"{1 + m / 8} * co.Polynomial(")
    name = text.removeprefix("co.systems.").partition("(")[0]
    for key, parameter in inspect.signature(getattr(co.systems, name)).parameters.items():
        default = parameter.default
        if key in SMALL or not isinstance(default, float | tuple) or not np.ndim(default) < 2 or not np.all(default):
            continue
        value = default * (1 + m / 8) if isinstance(default, float) else (default[0] * (1 + m / 8), *default[1:])
        changed = f"{text[:-1]}{'' if text.endswith('()') else ', '}{key}={value})"
        try:
            eval(changed, {"co": co})
        except (TypeError, ValueError):
            continue
        return changed
    return text
