"""Torques that depend on the attitude, as functions of the state of a system of bodies."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.systems.user_functions import callable_from_compiled

PER_BODY = 12  # L, and the three space axes seen from the body
SAMPLE_ATTITUDE = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0


def attitude_arguments(torque: Callable[..., Any]) -> str | None:
    """Return "x, A" or "x, A, t" for a function whose second parameter is named A; None for any other.

    Examples
    --------
    >>> attitude_arguments(lambda x, A, t: A[2]), attitude_arguments(lambda x, t: x)
    ('x, A, t', None)
    """
    try:
        signature = inspect.signature(getattr(torque, "py_func", torque))
    except (TypeError, ValueError):
        return None
    parameters = list(signature.parameters.values())
    if len(parameters) < 2 or parameters[1].name != "A":
        return None
    more = [one for one in parameters[2:] if one.default is one.empty or one.name == "t"]
    if [one.name for one in more] not in ([], ["t"]) or any(one.kind is one.VAR_POSITIONAL for one in parameters):
        names = ", ".join(one.name for one in parameters)
        raise TypeError(f"the torque is a function of ({names}); give one of (x, A) or (x, A, t)")
    return "x, A, t" if more else "x, A"


def check_attitude(system: Any) -> None:
    """Raise TypeError for a system without attitudes in its state."""
    if not getattr(system, "has_attitude", False):
        raise TypeError(
            f"the torque is a function of the attitude A, which the state of {system.name} does not have; take "
            "co.systems.body(inertia) or co.systems.bodies, whose states have it"
        )


def torque_shape(system: Any) -> tuple[int, ...]:
    """Return the shape of the torques on all bodies of a system, (3,) or (k, 3)."""
    return (*system.bodies, 3)


def torque_on_state(torque: Callable[..., Any], arguments: str, system: Any) -> tuple[Callable[..., Any], str]:
    """Return the contribution to x' of a torque of (x, A) or (x, A, t) as a function of (x) or (x, t), and which.

    The torque returns (3,) or (k, 3) in the frames of the bodies; Numba compiles both functions.
    """
    function = callable_from_compiled(torque)
    if not system.bodies:

        def of_body(x: Any) -> Any:
            result = 0.0 * x
            result[:3] = function(x, x[3:12].reshape(3, 3))
            return result

        def of_body_in_time(x: Any, t: Any) -> Any:
            result = 0.0 * x
            result[:3] = function(x, x[3:12].reshape(3, 3), t)
            return result

        return (of_body_in_time, "x, t") if arguments == "x, A, t" else (of_body, "x")
    count = system.bodies[0]
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
