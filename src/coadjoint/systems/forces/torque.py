"""A torque: constant, or a function of time, of the state, and of the attitude in it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.systems.forces.base import ForceReader
from coadjoint.systems.forces.rates import check_state, has_matrix_state, read_state, sample_states, state_vector
from coadjoint.systems.forces.state_torque import (
    StateTorque,
    check_attitude,
    constant_in_time,
    sample_state,
    torque_on_state,
    torque_shape,
)
from coadjoint.systems.user_functions import SAMPLE_TIME, takes_time
from coadjoint.validation import read_numbers

ATTITUDES = ("attitude", "r", "rotation", "q", "quaternion", "orientation", "dcm")
"""Names of a second argument that is meant to be an attitude, in small letters."""


@dataclass(frozen=True)
class Torque(StateTorque):
    """A torque in the body frame, ``x' = N``: a thruster, a motor, a control law, radiation pressure.

    The flow of a constant torque is exact. That of a function of time is its integral by the five-point Gauss-Legendre
    rule, exact for polynomials of degree nine. That of a function of the state is a step of the classical fourth-order
    Runge-Kutta method, whose local error is of fifth order in the step, below that of the splitting.

    A function must be pure; Numba compiles it, as those of a `Hamiltonian`.

    Parameters
    ----------
    torque : (n,) or (N, N) array_like, or callable
        The torque, or a function of ``t``, of ``x``, or of ``(x, t)`` that returns it, shape (n,). A function of one
        argument is a function of time if that argument is named ``t``. For a `MatrixSystem` the torque and x are
        matrices (N, N), and the torque lies in the algebra. For systems with attitudes in their states, such as
        ``co.systems.body``, also a function of ``(x, A)`` or ``(x, A, t)``: x is the state and A the attitude from the
        body to space, (3, 3), of k bodies (k, 3, 3); it returns the torque in the frame of the body, (3,) or (k, 3).

    Raises
    ------
    ValueError, TypeError
        Values that are not finite or of the wrong shape, a function of other arguments, or one of the attitude for a
        system without attitudes in its state.

    Examples
    --------
    >>> import coadjoint as co
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.Torque((0, 0, 0.5)))
    >>> co.integrate(body, (0.0, 0.0, 1.0), t_span=(0, 2), step=0.125).x[-1]
    array([0., 0., 2.])

    A spring and a damper that point the body at rest in space, with the rotation vector of small angles:

    >>> def pointing(x, A):
    ...     error = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    ...     return -0.5 * error - x[:3]
    >>> body = co.systems.body(inertia=(1, 2, 2.5)).with_forces(co.forces.Torque(pointing))
    >>> x0 = body.state(angular_velocity=(0.3, 0.0, 0.0))
    >>> sol = co.integrate(body, x0, t_span=(0, 40), step=0.05)
    >>> bool(sol.rotation[-1].magnitude() < 1e-6)
    True
    """

    torque: Any

    uses_energy: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if callable(self.torque):
            self._arguments()
        else:
            object.__setattr__(self, "torque", read_state(self.torque, "the torque"))

    def _arguments(self) -> str:
        """Return the arguments of the function: "t", "x", "x, t", "x, A" or "x, A, t"."""
        if (of_attitude := attitude_arguments(self.torque)) is not None:
            return of_attitude
        parameters = _parameters(self.torque)
        if takes_time(self.torque, "the torque"):
            if len(parameters) > 1 and parameters[1].name.lower() in ATTITUDES:
                raise TypeError(
                    f"the torque is a function of {_names(parameters)}; its second argument is the time t, unless it "
                    "is named A: name the attitude A, of systems such as co.systems.body, and the time t"
                )
            return "x, t"
        return "t" if parameters and parameters[0].name == "t" else "x"

    def check(self, system: Any) -> None:
        if not callable(self.torque):
            check_state(self.torque, "the torque", system)
            return
        arguments, failure = self._arguments(), ""
        shape: tuple[int, ...] = (system.dim,)
        samples = sample_states(system)
        if "A" in arguments:
            check_attitude(system)
            shape, samples = torque_shape(system), [sample_state(x, system) for x in samples]
        for x in samples:
            try:
                with np.errstate(all="ignore"):
                    value = self.torque(*_call_arguments(arguments, x, SAMPLE_TIME, system))
            except (ArithmeticError, ValueError, TypeError, IndexError) as reason:  # possibly outside its domain
                failure = in_one_line(str(reason), 200)
                continue
            if has_matrix_state(system):
                system.read(value, "the value of the torque")
                return
            torque = read_numbers(value, "the value of the torque")
            if torque.shape != shape:
                has_attitude = "A" not in arguments and getattr(system, "has_attitude", False)
                hint = f", or {torque_shape(system)} of a function of (x, A)" if has_attitude else ""
                raise ValueError(
                    f"the torque, called with ({arguments}), returns shape {torque.shape}; {system.name} needs "
                    f"{shape}{hint}"
                )
            return
        raise ValueError(
            f"the torque, called with ({arguments}), fails at every sample point ({failure}); correct the function"
        )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        if not callable(self.torque):
            return state_vector(self.torque, system)
        if has_matrix_state(system):
            torque = self.torque(*_call_arguments(self._arguments(), system.from_vector(x), t))
            return np.asarray(system.to_vector(torque))
        return super().field(system, x, t)

    @property
    def sees_attitude(self) -> bool:
        """Whether it is a function of the attitude."""
        return callable(self.torque) and "A" in self._arguments()

    def law_on_state(self, system: Any) -> tuple[Any, str]:
        if not callable(self.torque):
            return constant_in_time(np.array(self.torque)), "t"
        return self.on_state(system)

    def on_state(self, system: Any) -> tuple[Any, str]:
        if not callable(self.torque):
            return constant_in_time(state_vector(self.torque, system)), "t"
        arguments = self._arguments()
        return torque_on_state(self.torque, arguments, system) if "A" in arguments else (self.torque, arguments)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if not callable(self.torque):
            return np.asarray(x + tau * state_vector(self.torque, system))
        return super().flow(system, x, t, tau)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        if callable(self.torque):
            return super().describe_to(reader, system)
        return reader.constant(state_vector(self.torque, system))


def is_constant_torque(force: Any) -> bool:
    """Return whether a force is a torque that is no function."""
    return isinstance(force, Torque) and not callable(force.torque)


def _call_arguments(arguments: str, x: Any, t: Any, system: Any = None) -> tuple[Any, ...]:
    if "A" in arguments:
        A = system.attitudes(x)
        return (x, A, t) if "t" in arguments else (x, A)
    return {"t": (t,), "x": (x,), "x, t": (x, t)}[arguments]


def attitude_arguments(torque: Callable[..., Any]) -> str | None:
    """Return "x, A" or "x, A, t" for a function whose second parameter is named A; None for any other."""
    parameters = _parameters(torque)
    if len(parameters) < 2 or parameters[1].name != "A":
        if any(one.name == "A" and one.default is one.empty for one in parameters):
            raise TypeError(f"the torque is a function of {_names(parameters)}; give one of (x, A) or (x, A, t)")
        return None
    more = [one for one in parameters[2:] if one.default is one.empty or one.name == "t"]
    if [one.name for one in more] not in ([], ["t"]) or any(one.kind is one.VAR_POSITIONAL for one in parameters):
        raise TypeError(f"the torque is a function of {_names(parameters)}; give one of (x, A) or (x, A, t)")
    return "x, A, t" if more else "x, A"


def _parameters(torque: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function; none of a built-in one without a signature."""
    try:
        return list(inspect.signature(getattr(torque, "py_func", torque)).parameters.values())
    except (TypeError, ValueError):
        return []


def _names(parameters: list[inspect.Parameter]) -> str:
    return f"({', '.join(one.name for one in parameters)})"
