"""Torques: functions of state and time with their flow, constant torques, and functions of the attitude."""

from __future__ import annotations

import types
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.angular_velocity import PER_BODY, velocities_of
from coadjoint.systems.forces.base import Force, ForceReader, check_state, read_state, sample_states, state_vector
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.systems.user_functions import (
    KNOWN_NAMES,
    check_arguments,
    kind_of_name,
    names_of,
    parameters_of_function,
    takes_time,
)
from coadjoint.validation import as_tuples, read_finite, read_numbers, set_fields

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

    @property
    def has_memory(self) -> bool:
        """Whether it is a law that takes and returns a memory, which a sampled force keeps."""
        return False

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        function, arguments = self.on_state(system)
        return np.asarray(function(*(x.copy() if one == "x" else t for one in arguments.split(", "))))

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
    if not system.has_attitude:
        raise TypeError(
            f"{what} is a function of the attitude A, which the state of {system.name} does not have; take "
            "co.systems.body(inertia) or co.systems.bodies, whose states have it"
        )


def torque_shape(system: Any) -> tuple[int, ...]:
    """Return the shape of the torques on all bodies of a system, (3,) or (k, 3)."""
    return (*system.bodies, 3)


def places_of_torques(system: Any) -> NDArray[np.int64]:
    """Return the coordinates that torques on all bodies change, of the shape of these."""
    return np.asarray(PER_BODY * np.arange(system.bodies[0])[:, None] + np.arange(3) if system.bodies else np.arange(3))


def is_on_bodies(shape: tuple[int, ...], system: Any) -> bool:
    """Return whether values of this shape are torques on bodies, in their frames, and not derivatives of the state."""
    return hasattr(system, "bodies") and shape == torque_shape(system) != (system.dim,)


def torque_vector(torque: Any, system: Any) -> NDArray[np.float64]:
    """Return the contribution to x' of a constant torque, (n,), also of one on bodies."""
    if not is_on_bodies(np.shape(torque), system):
        return state_vector(torque, system)
    result = np.zeros(system.dim)
    result[places_of_torques(system)] = torque
    return result


def attitude_of_body(x: Any, t: Any) -> Any:
    """Return the attitude in the state of one body; Numba compiles it."""
    return x[3:PER_BODY].reshape(3, 3)


def torque_on_state(torque: Callable[..., Any], arguments: str, system: Any) -> tuple[Callable[..., Any], str]:
    """Return the contribution to x' of a torque on bodies as a function of (t), (x) or (x, t), and which."""
    velocities = velocities_of(system) if "omega" in arguments else None
    return _torque_on_state(torque, arguments, system.bodies, system.dim, velocities)


@lru_cache(maxsize=64)
def _torque_on_state(
    torque: Callable[..., Any], arguments: str, bodies: tuple[int, ...], dim: int, velocities: Any
) -> tuple[Callable[..., Any], str]:
    count = bodies[0] if bodies else 1

    def attitudes_of_bodies(x: Any, t: Any) -> Any:
        return np.ascontiguousarray(x[: PER_BODY * count].reshape(count, 4, 3)[:, 1:, :])

    def place_on_body(value: Any, result: Any) -> Any:
        if len(value) != 3:
            raise ValueError("a torque has other than three components")
        for i in range(3):  # a slice compiles in seconds
            result[i] = value[i]
        return result

    def place_on_bodies(values: Any, result: Any) -> Any:
        for k in range(count):
            for i in range(3):
                result[PER_BODY * k + i] = values[k, i]
        return result

    placed = place_on_bodies if bodies else place_on_body
    if arguments == "t":
        return lambda t: placed(torque(t), 0.0 * t + np.zeros(dim)), "t"  # an array of JAX if t is one
    attitudes = attitudes_of_bodies if bodies else attitude_of_body
    called, which = torque, arguments
    if arguments not in PLAIN:
        called, which = _called_in_order(torque, arguments, attitudes, velocities)
    if which == "x":
        return lambda x: placed(called(x), 0.0 * x), which
    return lambda x, t: placed(called(x, t), 0.0 * x), which


@lru_cache(maxsize=64)
def law_with_memory(law: Torque, system: Any, begin: int, count: int) -> Callable[..., Any]:
    """Return torque and new memory, (3 + count,), as a function of (x, t); `begin` is the place of the memory in x."""
    arguments = law._arguments()
    velocities = velocities_of(system) if "omega" in arguments else None

    def memory(x: Any, t: Any) -> Any:
        return x[begin : begin + count].copy()

    called, which = _called_in_order(law.function, arguments, attitude_of_body, velocities, memory)
    timed: Callable[..., Any] = called if which == "x, t" else lambda x, t: called(x)

    def evaluated(x: Any, t: Any) -> Any:
        torque, new = timed(x, t)
        result = 0.0 * x[: 3 + count]
        if len(torque) != 3 or len(new) != count:
            raise ValueError("a law returns a torque or a memory of another length")
        for i in range(3):  # a slice compiles in seconds
            result[i] = torque[i]
        for i in range(count):
            result[3 + i] = new[i]
        return result

    return evaluated


def _called_in_order(
    function: Callable[..., Any], arguments: str, attitudes: Any = None, velocities: Any = None, memory: Any = None
) -> tuple[Callable[..., Any], str]:
    """Return a function of other arguments as one of (x) or (x, t), and which."""
    values = {"x": lambda x, t: x, "t": lambda x, t: t, "A": attitudes, "omega": velocities, "memory": memory}
    names = arguments.split(", ")
    first, second, third, fourth, fifth = (values[name] for name in (*names, *["x"] * (5 - len(names))))
    of_state: list[Callable[..., Any]] = [
        lambda x: function(first(x, 0.0)),
        lambda x: function(first(x, 0.0), second(x, 0.0)),
        lambda x: function(first(x, 0.0), second(x, 0.0), third(x, 0.0)),
        lambda x: function(first(x, 0.0), second(x, 0.0), third(x, 0.0), fourth(x, 0.0)),
    ]
    of_time: list[Callable[..., Any]] = [
        lambda x, t: function(first(x, t)),
        lambda x, t: function(first(x, t), second(x, t)),
        lambda x, t: function(first(x, t), second(x, t), third(x, t)),
        lambda x, t: function(first(x, t), second(x, t), third(x, t), fourth(x, t)),
        lambda x, t: function(first(x, t), second(x, t), third(x, t), fourth(x, t), fifth(x, t)),
    ]
    chosen = (of_time if "t" in names else of_state)[len(names) - 1]
    return chosen, "x, t" if "t" in names else "x"


def sample_state(x: NDArray[Any], system: Any) -> NDArray[Any]:
    """Return a sample point, with rotations as attitudes."""
    if not system.has_attitude:
        return x
    y = x.copy()
    count = len(system.inertias)
    y[: PER_BODY * count].reshape(count, 4, 3)[:, 1:] = SAMPLE_ATTITUDE
    return y


ON_BODIES = {"A", "omega"}
"""Names of arguments that bodies have beside the state: the attitude and the angular velocity."""
OF_LAWS = {*ON_BODIES, "memory"}
"""Those of laws that are sampled, which may also take their memory."""
STATE_AND_TIME = {name: kind for kind in ("x", "t") for name in KNOWN_NAMES[kind]}
PLAIN = "t", "x", "x, t"
"""Arguments of functions that are called as they are."""
ATTITUDES = ("r", "q", *KNOWN_NAMES["A"])
"""Names of a second argument that is meant to be an attitude, in small letters."""


@suggest_keywords
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
        The torque, or a function of ``t``, of ``x``, or of ``(x, t)`` that returns it, shape (n,). The argument of a
        function of one is the time if it is named t or time, and the state if it is named x, y, state, momentum or, of
        a matrix, W. For a `MatrixSystem` the torque and x are matrices (N, N), and the torque lies in the algebra. For
        bodies and tops, such as ``co.systems.body``, also the torque in the frame of the body, (3,), or of k bodies
        (k, 3), of which a function may also ask for ``omega``, the angular velocity in the frame of the body, and, if
        attitudes are in the state, for ``A``, the attitude from the body to space, (3, 3) or (k, 3, 3). Two to four of
        ``x``, ``A``, ``omega`` and ``t`` may stand in any order. A law that is sampled may also ask for its
        ``memory``, and then returns the torque and the new memory, see `Sampled`.
    arguments : mapping, optional
        Values of the last arguments of the function, by name: numbers and arrays, such as gains. They are parameters
        of the run, by which it can be differentiated, as ``Torque.arguments.gain``.

    Raises
    ------
    ValueError, TypeError
        Values that are not finite or of the wrong shape, a function of other arguments, one of the attitude for a
        system without attitudes in its state, or one of a memory that is not sampled.

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

    A gain of which the run is differentiated:

    >>> def damper(omega, gain):
    ...     return -gain * omega
    >>> law = co.forces.Torque(damper, arguments={"gain": 0.5})
    >>> ready = co.prepare(co.systems.body((1, 2, 2.5)).with_forces(law), co.Splitting(), step=0.125)
    >>> x0 = ready.system.state(angular_velocity=(0.0, 0.0, 1.0))
    >>> sol, pullback = ready.vjp(x0, t_span=(0, 1))
    >>> bool(abs(pullback(x=np.eye(12)[[2]] * (sol.t == 1.0)[:, None])["Torque.arguments.gain"] + np.exp(-0.2)) < 1e-6)
    True
    """

    torque: Any
    arguments: Any = field(default=(), kw_only=True, repr=False)

    example: ClassVar = {"torque": (0.1, -0.2, 0.3)}
    uses_energy: ClassVar[bool] = False
    named_values: ClassVar[tuple[str, ...]] = ("arguments",)

    def __post_init__(self) -> None:
        set_fields(self, arguments=_read_arguments(self.arguments, self.torque))
        if not self.is_constant_torque:
            self._arguments()
        else:
            set_fields(self, torque=read_state(self.torque, "the torque"))

    @property
    def function(self) -> Callable[..., Any]:
        """The function of the state and the time, with the values of the other arguments."""
        return _with_values(self.torque, self.arguments) if self.arguments else cast(Callable[..., Any], self.torque)

    def _arguments(self) -> str:
        """Return the arguments of the function in its order, such as "t", "x", "x, t" or "omega, A, t"."""
        parameters = parameters_of_function(self.function)
        required = [one for one in parameters if one.default is one.empty or one.name == "t"]
        kinds = [one.name if one.name in OF_LAWS else STATE_AND_TIME.get(one.name, "") for one in required]
        if all(kinds) and len({*kinds}) == len(kinds) and (len(kinds) > 1 or {*kinds} & OF_LAWS):
            return ", ".join(kinds)
        if {*kinds} & OF_LAWS:
            raise TypeError(
                f"the torque is a function of {names_of(parameters)}; give it arguments among x, A, omega and t, and "
                "memory of a law that is sampled, each once"
            )
        if len(parameters) > 1 and parameters[1].name.lower() in ATTITUDES:
            raise TypeError(
                f"the torque is a function of {names_of(parameters)}; its second argument is the time t, unless it is "
                "named A: name the attitude A, of systems such as co.systems.body, and the time t"
            )
        is_alone = len(parameters) > 0 and sum(one.default is one.empty for one in parameters) < 2
        kind = kind_of_name(parameters[0].name) if is_alone else "x"
        if kind == "t":
            check_arguments(self.function, "the torque", "t")
            return "t"
        timed = takes_time(self.function, "the torque")
        if kind != "x" and not timed:
            raise TypeError(
                f"the torque is a function of {names_of(parameters[:1])}; name this argument t if it is the time, or x "
                "if it is the state"
            )
        return "x, t" if timed else "x"

    @property
    def is_constant_torque(self) -> bool:
        """Whether the torque is no function."""
        return not callable(self.torque)

    def check(self, system: Any) -> None:
        if self.is_constant_torque:
            shape = np.shape(self.torque)
            if hasattr(system, "bodies") and shape not in ((system.dim,), torque_shape(system)):
                raise ValueError(f"the torque has the shape {shape}; {system.name} needs {shapes_on(system)}")
            if not is_on_bodies(shape, system):
                check_state(self.torque, "the torque", system)
            return
        arguments = self._arguments()
        if self.has_memory:
            raise TypeError(
                "the torque is a function of a memory, which laws have that are sampled; give co.forces.Sampled("
                "Torque(function), period, memory={name: size}), or an actuator in place of Sampled"
            )
        if "A" in arguments:
            check_attitude(system)
        if "omega" in arguments and not hasattr(system, "bodies"):
            raise TypeError(
                f"the torque is a function of the angular velocity omega, and {system.name} is no body; write it as a "
                "function of the state x"
            )
        of_bodies = "A" in arguments or "omega" in arguments
        shape = torque_shape(system) if of_bodies else (system.dim,)
        value, failure = _value_at_sample(self.function, arguments, system)
        if failure is not None:
            raise ValueError(
                f"the torque, called with ({arguments}), fails at every sample point ({failure}); correct the function"
            )
        if system.has_matrices:
            system.read(value, "the value of the torque")
            return
        torque = read_numbers(value, "the value of the torque")
        if torque.shape != shape and not is_on_bodies(torque.shape, system):
            raise ValueError(
                f"the torque, called with ({arguments}), returns shape {torque.shape}; {system.name} needs "
                f"{shape if of_bodies else shapes_on(system)}"
            )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        if self.is_constant_torque:
            return torque_vector(self.torque, system)
        if system.has_matrices:
            torque = self.function(*_call_arguments(self._arguments(), system.from_vector(x), t))
            return np.asarray(system.to_vector(torque))
        return super().field(system, x, t)

    @property
    def sees_attitude(self) -> bool:
        """Whether it is a function of the attitude."""
        return not self.is_constant_torque and "A" in self._arguments()

    @property
    def has_memory(self) -> bool:
        return not self.is_constant_torque and "memory" in self._arguments()

    def _needs_energy(self, system: Any) -> bool:
        return not self.is_constant_torque and "omega" in self._arguments()

    def values_with_memory(self, system: Any, x: NDArray[Any], t: float, memory: NDArray[Any]) -> Any:
        """Return what the function of a law with a memory returns."""
        return self.function(*_call_arguments(self._arguments(), x, t, system, memory))

    def law_on_state(self, system: Any) -> tuple[Any, str]:
        if self.is_constant_torque:
            return constant_in_time(np.array(self.torque)), "t"
        arguments = self._arguments()
        return (self.function, arguments) if arguments in PLAIN else self.on_state(system)

    def on_state(self, system: Any) -> tuple[Any, str]:
        if self.is_constant_torque:
            return constant_in_time(torque_vector(self.torque, system)), "t"
        arguments = self._arguments()
        if ON_BODIES & {*arguments.split(", ")} or (
            hasattr(system, "bodies") and is_on_bodies(_shape_of_values(self.function, arguments, system), system)
        ):
            return torque_on_state(self.function, arguments, system)
        return (self.function, arguments) if arguments in PLAIN else _in_order(self.function, arguments)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        if self.is_constant_torque:
            return np.asarray(x + tau * torque_vector(self.torque, system))
        return super().flow(system, x, t, tau)

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        if self.is_constant_torque:
            return reader.constant(torque_vector(self.torque, system))
        return super().describe_to(reader, system)


def _read_arguments(value: Any, torque: Any) -> tuple[tuple[str, Any], ...]:
    """Validate values of the last arguments of a function, a mapping or pairs, and return pairs in their order."""
    try:
        given = {} if value is None else dict(value)
    except (TypeError, ValueError):
        raise TypeError(f'arguments is {short(value)}; give names with values: {{"gain": 0.5}}') from None
    if not given:
        return ()
    if not callable(torque):
        raise TypeError("arguments was given, and the torque is constant; give a function of them")
    names = [one.name for one in parameters_of_function(torque)]
    last = names[len(names) - len(given) :]
    if {*last} != {*given} or len(given) == len(names) or {*given} & {*OF_LAWS, *STATE_AND_TIME}:
        raise TypeError(
            f"arguments has values of {', '.join(map(str, given))}, and the torque is a function of "
            f"({', '.join(names)}); give those of its last arguments, behind the state and the time"
        )
    return tuple((name, as_tuples(read_finite(given[name], f"{name} of the torque"))) for name in last)


@lru_cache(maxsize=1024)
def _with_values(function: Any, arguments: tuple[tuple[str, Any], ...]) -> Callable[..., Any]:
    """Return a function with values of its last arguments as their defaults, which are data of machine code."""
    plain = getattr(function, "py_func", function)
    values = tuple(
        np.array(value) if isinstance(value, tuple) else value if isinstance(value, complex) else float(value)
        for _, value in arguments
    )
    return types.FunctionType(plain.__code__, plain.__globals__, plain.__name__, values, plain.__closure__)


def shapes_on(system: Any) -> str:
    """Return the shapes of constant torques on a system as text."""
    own = torque_shape(system) if hasattr(system, "bodies") else (system.dim,)
    return f"({system.dim},)" + (f", or {own} in body frames" if own != (system.dim,) else "")


def _value_at_sample(torque: Callable[..., Any], arguments: str, system: Any) -> tuple[Any, str | None]:
    """Return the value at a sample point, and None or why there is none at any of them."""
    for sample in sample_states(system):
        try:
            with np.errstate(all="ignore"):
                return torque(
                    *_call_arguments(arguments, sample_state(sample, system), sample_time_of(torque), system)
                ), None
        except (ArithmeticError, ValueError, TypeError, IndexError) as reason:  # possibly outside its domain
            failure = in_one_line(str(reason), 200)
    return None, failure


@lru_cache(maxsize=64)
def _shape_of_values(torque: Callable[..., Any], arguments: str, system: Any) -> tuple[int, ...]:
    return np.shape(_value_at_sample(torque, arguments, system)[0])


@lru_cache(maxsize=64)
def _in_order(torque: Callable[..., Any], arguments: str) -> tuple[Callable[..., Any], str]:
    return _called_in_order(torque, arguments)


def _call_arguments(arguments: str, x: Any, t: Any, system: Any = None, memory: Any = None) -> tuple[Any, ...]:
    values: dict[str, Callable[[], Any]] = {
        "x": lambda: x,
        "t": lambda: t,
        "memory": lambda: memory,
        "A": lambda: system.attitudes(x),
        "omega": lambda: velocities_of(system)(x, t),
    }
    return tuple(values[name]() for name in arguments.split(", "))
