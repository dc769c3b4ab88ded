"""Torques by functions of state and time: their flow, and functions of the attitude as functions of the state."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.user_functions import callable_from_compiled

PER_BODY = 12  # L, and the three space axes seen from the body
SAMPLE_ATTITUDE = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0

# Nodes and weights of the five-point Gauss-Legendre rule on (-1, 1).
NODES = (-0.9061798459386640, -0.5384693101056831, 0.0, 0.5384693101056831, 0.9061798459386640)
WEIGHTS = (0.23692688505618908, 0.47862867049936647, 0.5688888888888889, 0.47862867049936647, 0.23692688505618908)


class StateTorque(Force):
    """Base class of torques that are functions of the time, of the state, or of both."""

    # The flow of a function of the time is its integral by the five-point Gauss-Legendre rule; that of a function of
    # the state a step of the classical Runge-Kutta method, and in schemes of higher order an extrapolated midpoint
    # rule.

    @abstractmethod
    def on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        """Return the contribution to x', (dim,), as a function for Numba, and its arguments: "t", "x", "x, t"."""

    def law_on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        """Return `on_state` for a controller, which reads only the first three numbers of a result of any length."""
        return self.on_state(system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        function, arguments = self.on_state(system)
        return np.asarray(function(*({"x": x, "t": t}[one] for one in arguments.split(", "))))

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if self.tangent(system, x, t, tau) is not None:
            pairs = zip(NODES, WEIGHTS, strict=True)
            return np.asarray(
                x + 0.5 * tau * sum(w * self.field(system, x, t + 0.5 * tau * (1.0 + c)) for c, w in pairs)
            )
        k1 = self.field(system, x, t)
        k2 = self.field(system, x + 0.5 * tau * k1, t + 0.5 * tau)
        k3 = self.field(system, x + 0.5 * tau * k2, t + 0.5 * tau)
        k4 = self.field(system, x + tau * k3, t + tau)
        return np.asarray(x + tau * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0)

    def flow_of_order(self, system: Any, x: NDArray[Any], t: Any, tau: Any, order: int) -> NDArray[Any]:
        columns = extrapolation_columns(order)
        if not columns or self.tangent(system, x, t, tau) is not None:
            return self.flow(system, x, t, tau)
        first, change = self.field(system, x, t), np.zeros_like(x)
        for k, weight in enumerate(extrapolation_weights(columns), 1):
            length = tau / (2 * k)
            before, now = np.zeros_like(x), length * first
            for m in range(1, 2 * k):
                before, now = now, before + 2.0 * length * self.field(system, x + now, t + m / (2 * k) * tau)
            change = change + weight * now
        return np.asarray(x + change)

    def tangent(self, system: Any, x: NDArray[Any], t: float, tau: float) -> NDArray[np.float64] | None:
        """Return one, or None for a function of the state."""
        return np.array(1.0) if self.on_state(system)[1] == "t" else None

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.function(*self.on_state(system))


def extrapolation_columns(order: int) -> int:
    """Return the columns of the extrapolated flow of a function of the state in schemes of this order, 0 without it."""
    # Column k is Gragg's midpoint rule in 2 k substeps.
    return 0 if order <= 4 else (order + 1) // 2


def extrapolation_weights(columns: int) -> list[float]:
    """Return the weights of the columns, which cancel the terms tau^2, tau^4, ... of their errors."""
    numbers = range(1, columns + 1)
    return [float(np.prod([k * k / (k * k - i * i) for i in numbers if i != k])) for k in numbers]


def constant_in_time(torque: NDArray[np.float64]) -> Callable[..., Any]:
    """Return a constant as a function of the time."""

    def constant(t: Any) -> Any:
        return torque.copy()

    return constant


def check_attitude(system: Any, what: str = "the torque") -> None:
    """Raise TypeError for a system without attitudes in its state."""
    if not getattr(system, "has_attitude", False):
        raise TypeError(
            f"{what} is a function of the attitude A, which the state of {system.name} does not have; take "
            "co.systems.body(inertia) or co.systems.bodies, whose states have it"
        )


def torque_shape(system: Any) -> tuple[int, ...]:
    """Return the shape of the torques on all bodies of a system, (3,) or (k, 3)."""
    return (*system.bodies, 3)


def torque_on_state(torque: Callable[..., Any], arguments: str, system: Any) -> tuple[Callable[..., Any], str]:
    """Return the contribution to x' of a torque of (x, A) or (x, A, t) as a function of (x) or (x, t), and which."""
    return _torque_on_state(torque, arguments, system.bodies)


@lru_cache(maxsize=64)
def _torque_on_state(
    torque: Callable[..., Any], arguments: str, bodies: tuple[int, ...]
) -> tuple[Callable[..., Any], str]:
    function = callable_from_compiled(torque)
    if not bodies:

        def of_body(x: Any) -> Any:
            result = 0.0 * x
            result[:3] = function(x, x[3:12].reshape(3, 3))
            return result

        def of_body_in_time(x: Any, t: Any) -> Any:
            result = 0.0 * x
            result[:3] = function(x, x[3:12].reshape(3, 3), t)
            return result

        return (of_body_in_time, "x, t") if arguments == "x, A, t" else (of_body, "x")
    count = bodies[0]
    end = PER_BODY * count

    def of_bodies(x: Any) -> Any:
        torques = function(x, np.ascontiguousarray(x[:end].reshape(count, 4, 3)[:, 1:, :]))
        result = 0.0 * x
        for k in range(count):
            for i in range(3):
                result[PER_BODY * k + i] = torques[k, i]
        return result

    def of_bodies_in_time(x: Any, t: Any) -> Any:
        torques = function(x, np.ascontiguousarray(x[:end].reshape(count, 4, 3)[:, 1:, :]), t)
        result = 0.0 * x
        for k in range(count):
            for i in range(3):
                result[PER_BODY * k + i] = torques[k, i]
        return result

    return (of_bodies_in_time, "x, t") if arguments == "x, A, t" else (of_bodies, "x")


def sample_state(x: NDArray[Any], system: Any) -> NDArray[Any]:
    """Return a sample point with rotations as attitudes."""
    y = x.copy()
    count = len(system.inertias)
    y[: PER_BODY * count].reshape(count, 4, 3)[:, 1:] = SAMPLE_ATTITUDE
    return y
