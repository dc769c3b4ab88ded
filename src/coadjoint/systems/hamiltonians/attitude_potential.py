"""Potentials V(r, A) of positions and attitudes as functions of the coordinates that they depend on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.user_functions import callable_from_compiled, check_arguments


def attitude_potential(
    potential: Callable[..., Any], gradient: Callable[..., Any] | None, hessian: Callable[..., Any] | None, count: int
) -> Hamiltonian:
    """Return V(r, A) of `count` bodies as a function of the entries of A, (count, 3, 3), then of r, (count, 3)."""
    # `gradient` returns the derivatives by r and by A, and `hessian` those of all entries, (12 count, 12 count).
    energy, axes = callable_from_compiled(potential), 9 * count

    def value(y: Any) -> Any:
        return energy(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))

    if gradient is None:
        return Hamiltonian(value)
    slopes = callable_from_compiled(gradient)

    def derivative(y: Any) -> Any:
        by_r, by_A = slopes(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))
        result = 0.0 * y
        for k in range(count):
            for i in range(3):
                result[axes + 3 * k + i] = by_r[k, i]
                for j in range(3):
                    result[9 * k + 3 * i + j] = by_A[k, i, j]
        return result

    if hessian is None:
        return Hamiltonian(value, derivative)
    curvatures = callable_from_compiled(hessian)

    def second(y: Any) -> Any:
        return curvatures(y[axes:].reshape(count, 3), y[:axes].reshape(count, 3, 3))

    return Hamiltonian(value, derivative, second)


def check_potential(potential: Any, gradient: Any, hessian: Any) -> None:
    """Raise TypeError unless each is None or a function of (r, A), and each derivative has the one before."""
    if potential is None and gradient is not None:
        raise TypeError("gradient was given without potential; give both, or neither for free bodies")
    if gradient is None and hessian is not None:
        raise TypeError("hessian was given without gradient; give both, or neither to derive them from potential")
    for value, what in ((potential, "potential"), (gradient, "gradient"), (hessian, "hessian")):
        if value is not None:
            check_arguments(value, what, "r, A")
