"""Potential energy of particles with finite width, to second order: as a polynomial or as Python functions."""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.user_functions import callable_from_compiled, check_derivative

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
DerivativeFunctions = tuple[Callable[..., Any], ...]  # a function of one number and its first three derivatives

BYTES_PER_COORDINATE_POWER = 16  # memory of a monomial, for each coordinate


def validate_potential(argument: Any, what: str) -> DerivativeFunctions | None:
    """Validate a function and its first three derivatives; None if `argument` is not callables."""
    if callable(argument) or (isinstance(argument, tuple | list) and any(callable(f) for f in argument)):
        if callable(argument) or len(argument) != 4 or not all(callable(f) for f in argument):
            raise TypeError(f"{what} is {short(argument)}; give a function and its first three derivatives")
        names = [f"{what}[{k}]" for k in range(4)]
        for k in range(3):
            pair = (names[k], names[k + 1])
            check_derivative(argument[k], argument[k + 1], names=pair, shapes=((), ()), n=None, timed=False)
        return tuple(argument)
    return None


def check_even(chain: DerivativeFunctions, what: str) -> None:
    """Raise ValueError if a potential is not even."""
    for r in (0.375, 1.5):
        right, left = float(chain[0](r)), float(chain[0](-r))
        if not abs(right - left) <= 64 * UNIT_ROUNDOFF * (abs(right) + abs(left)):
            raise ValueError(f"{what} is {right:g} at {r} and {left:g} at {-r}; the potential of a pair is even")


def energy_coefficients(w: Numbers, W: Numbers, U: Floats) -> dict[tuple[int, ...], Any]:
    """Return the coefficients of H for polynomial potentials, from theirs; see `decorated_particles`."""
    n = len(w)
    dim = 5 * n + 1
    check_available_memory(
        BYTES_PER_COORDINATE_POWER * dim * n * (len(W) + n * len(U) ** 2),
        f"the potentials of {n} particles as a polynomial",
        "give the potentials as functions",
    )
    total: dict[tuple[int, ...], Any] = {}

    def add(c: Any, *powers: tuple[int, int]) -> None:
        if c:
            exponents = [0] * dim
            for coordinate, power in powers:
                exponents[coordinate] += power
            key = tuple(exponents)
            total[key] = total.get(key, 0.0) + c

    x20 = [2 * n + 1 + 3 * a for a in range(n)]
    for a in range(n):
        add(0.5 / w[a], (n + a, 2))
        add(0.5, (x20[a] + 2, 1))
        add((U[2] if len(U) > 2 else 0.0) * w[a], (x20[a], 1))
        for k, c in enumerate(W.tolist()):
            add(w[a] * c, (a, k))
            if k >= 2:
                add(c * k * (k - 1) / 2, (a, k - 2), (x20[a], 1))
        for b in range(a):
            for k, c in enumerate(U.tolist()):
                for j in range(k + 1):
                    add((-1) ** j * comb(k, j) * c * w[a] * w[b], (a, k - j), (b, j))
                for j in range(k - 1):
                    slope = (-1) ** j * comb(k - 2, j) * c * k * (k - 1) / 2
                    add(slope * w[b], (a, k - 2 - j), (b, j), (x20[a], 1))
                    add(slope * w[a], (a, k - 2 - j), (b, j), (x20[b], 1))
    return total


def polynomial_derivatives(coefficients: Floats | None) -> DerivativeFunctions:
    """Return a polynomial and its first three derivatives as functions of one number; zero for None."""

    def polynomial_function(c: Floats) -> Callable[..., Any]:
        def value(x: Any) -> Any:
            total = 0.0
            for k in range(len(c) - 1, -1, -1):
                total = total * x + c[k]
            return total

        return value

    functions = []
    c = np.zeros(1) if coefficients is None else coefficients
    for _ in range(4):
        functions.append(polynomial_function(c))
        c = np.arange(1, len(c)) * c[1:] if len(c) > 1 else np.zeros(1)
    return tuple(functions)


def potential_energy(w: Floats, external: DerivativeFunctions, pair: DerivativeFunctions) -> Hamiltonian:
    """Return the potential energy as a function of (q_1, ..., q_n, x20_1, ..., x20_n); see `decorated_particles`."""
    n = len(w)
    W0, W1, W2, W3 = map(callable_from_compiled, external)
    U0, U1, U2, U3 = map(callable_from_compiled, pair)

    def value(y: Any) -> Any:
        total = 0.0 * y[0]
        for a in range(n):
            q, x = y[a], y[n + a]
            total += w[a] * W0(q) + (W2(q) + U2(0.0) * w[a]) * x / 2
            for b in range(a):
                r = q - y[b]
                total += w[a] * w[b] * U0(r) + U2(r) * (w[b] * x + w[a] * y[n + b]) / 2
        return total

    def gradient(y: Any) -> Any:
        slope = 0.0 * y
        for a in range(n):
            q, x = y[a], y[n + a]
            slope[a] += w[a] * W1(q) + W3(q) * x / 2
            slope[n + a] += (W2(q) + U2(0.0) * w[a]) / 2
            for b in range(a):
                r = q - y[b]
                force = w[a] * w[b] * U1(r) + U3(r) * (w[b] * x + w[a] * y[n + b]) / 2
                slope[a] += force
                slope[b] -= force
                slope[n + a] += U2(r) * w[b] / 2
                slope[n + b] += U2(r) * w[a] / 2
        return slope

    return Hamiltonian(value, gradient)
