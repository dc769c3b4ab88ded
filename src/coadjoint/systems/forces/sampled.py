"""Controllers that are sampled: their torque, or the command of an actuator, is held between samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, sample_points
from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.forces.body_torque import Pointing, check_one_body, limited_by, read_limits
from coadjoint.systems.forces.torque import StateTorque, check_attitude, law_with_memory, sample_state
from coadjoint.validation import read_integer, read_positive

DIFFERENCE_TIME = 2.0**-16  # of differences of a flow, whose error is proportional to its square
MAX_DELAY, MAX_MEMORY = 1000, 4096  # periods, and numbers: far above those of controllers, and small in memory
ON_GRID = 1e-9  # part of a step by which a time may miss a whole number of steps, by rounding


@suggest_keywords
@dataclass(frozen=True)
class Sampled(Force):
    """A torque that is sampled at a rate and held constant in the body frame between samples (zero-order hold).

    Samples are at the multiples of the period: the law is evaluated on the state at the start of the step that begins
    there, before any force acts, and the held torque acts exactly. It is in the state, whose last numbers are those
    that forces hold: ``with_forces`` makes room for them, and ``system.state(...)`` of its result makes states, where
    nothing is held. So runs continue, are stored, and are differentiated as others.

    A law may have a memory, such as the integral of a PID controller, a filter or an estimator: then its function also
    asks for ``memory``, an array, and returns the torque and the new memory. The memory is in the state too, as
    coordinates of the given names, ``integral1`` and so on, and starts at zero, or where ``system.state(...,
    memory={"integral": ...})`` lets it start.

    Parameters
    ----------
    law : Torque, Pointing or another torque on a body
        The torque in the body frame of the state and the time at a sample.
    period : float
        Time between samples, a whole number of steps. Runs start at a whole number of steps.
    max_torque : float or (3,), optional
        Limit of each component.
    memory : mapping, optional
        Names and sizes of what the law remembers: ``{"integral": 3}``. Names are letters. The function sees all in one
        array, in this order.
    delay : int
        Number of periods after which a command acts; until the first does, none acts.
    resolution : float or one for each command, optional
        Commands are rounded to multiples of it; limits are multiples of it too.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        The law is no torque, returns other shapes, or has a memory where none is given, or the system is not made by
        `co.systems.body`. In runs: the step does not divide the period, the start is no whole number of steps, or time
        runs backward.

    Examples
    --------
    >>> import coadjoint as co
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(co.forces.Sampled(law, period=0.5))
    >>> x0 = sat.state([0.6, 0.0, 0.0, 0.8], angular_velocity=(0.1, 0.2, 0.3))
    >>> sol = co.integrate(sat, x0, (0, 60), 0.05)
    >>> bool(sol.rotation[-1].magnitude() < 1e-5), bool((sol.x[21:30, -3:] == sol.x[21, -3:]).all())
    (True, True)

    The integral of the error removes the offset by a constant disturbance:

    >>> import numpy as np
    >>> def pid(A, omega, memory):
    ...     error = 0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    ...     integral = memory + 0.5 * error
    ...     return -0.5 * error - 1.5 * omega - 0.05 * integral, integral
    >>> computer = co.forces.Sampled(co.forces.Torque(pid), period=0.5, memory={"integral": 3})
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(computer, co.forces.Torque((0.02, 0.0, 0.0)))
    >>> sol = co.integrate(sat, sat.state(), (0, 150), 0.125)
    >>> bool(sol.rotation[-1].magnitude() < 1e-5), sol.x[-1, -3:].round(3) + 0.0
    (True, array([0.4, 0. , 0. ]))
    """

    law: Any
    period: float
    max_torque: Any = None
    memory: Any = field(default=None, kw_only=True)
    delay: int = field(default=0, kw_only=True)
    resolution: Any = field(default=None, kw_only=True)
    first: int = field(default=0, kw_only=True)

    example: ClassVar = {"law": Pointing(0.1, 0.2), "period": 0.25}
    reversible: ClassVar[bool] = False
    uses_energy: ClassVar[bool] = False
    sampled: ClassVar[bool] = True
    command_name: ClassVar[str] = "torque"
    selectors: ClassVar[tuple[str, ...]] = ("period", "memory", "delay", "first")
    _limit_of_command: ClassVar[str] = "max_torque"
    _limits: ClassVar[Mapping[str, Callable[..., Any]]] = {"max_torque": read_limits}

    def __post_init__(self) -> None:
        if not isinstance(self.law, StateTorque):
            raise TypeError(
                f"law of {self.label} is {short(self.law)}; give a torque of co.forces, such as Pointing(...) or "
                "Torque(function)"
            )
        self._read(period=read_positive, memory=_read_memory, resolution=partial(read_limits, shape=()))
        self._read(delay=partial(read_integer, minimum=0, maximum=MAX_DELAY), first=partial(read_integer, minimum=0))
        self._read(**self._limits)
        if self.law.has_memory != bool(self.memory):
            given = "is given, and the law does not take it" if self.memory else "is not given, and the law takes one"
            raise TypeError(
                f"memory of {self.label} {given}; give memory={{name: size}} for a co.forces.Torque of a function that "
                "asks for memory, and returns the torque and the new memory"
            )

    @property
    def _remembered(self) -> tuple[tuple[str, int], ...]:
        """Names and sizes of what the law remembers."""
        return tuple(self.memory)

    @property
    def _memory_size(self) -> int:
        """How many numbers the law remembers."""
        return sum(size for _, size in self._remembered)

    @property
    def _measures(self) -> bool:
        """Whether the law is that of the change of a field that the force measures."""
        return False

    def held_names(self, system: Any) -> tuple[str, ...]:
        check_one_body(system, self.label)
        if not hasattr(system, "with_held"):
            raise TypeError(
                f"{self.label} is held in the state, and that of {system.name} has no room for it; take "
                "co.systems.body(inertia), or body(inertia, attitude=False), in place of a top with gravity as a "
                "co.forces.Torque"
            )
        count = self._count(system)
        self._check_resolution(count)
        remembered = (name for name, size in self._remembered for _ in range(size))
        return (*["held"] * (count * (1 + self.delay)), *remembered)

    def _check_resolution(self, count: int) -> None:
        """Raise ValueError for a resolution of another shape, or of which the limit of commands is no multiple."""
        if self.resolution is None:
            return
        if np.shape(self.resolution) not in ((), (count,)):
            raise ValueError(
                f"resolution of {self.label} has the shape {np.shape(self.resolution)}; give one number, or {count}"
            )
        limit = getattr(self, self._limit_of_command)
        steps = np.zeros(1) if limit is None else np.divide(limit, self.resolution)
        if (np.abs(steps - np.rint(steps)) > ON_GRID * steps).any():
            raise ValueError(
                f"{self._limit_of_command} of {self.label} is {short(limit)}, which is no multiple of the resolution "
                f"{short(self.resolution)}; commands are rounded to its multiples, so give one as the limit"
            )

    def _count(self, system: Any) -> int:
        """Return how many numbers are held."""
        return 3

    def held_at(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the command that is held at states (..., dim), (..., count)."""
        begin = _begin(self, system)
        return x[..., begin : begin + self._count(system)]

    def _law(self, system: Any) -> Callable[..., Any]:
        """Return the torque of the law, (3,), followed by its new memory, as a function of (x, t)."""
        if self.memory:
            return law_with_memory(self.law, system, self._first_remembered(system), self._memory_size)
        return _law_of(self.law, system)

    def _first_remembered(self, system: Any) -> int:
        """Return the index in the state of the first number that the law remembers."""
        return _begin(self, system) + self._count(system) * (1 + self.delay)

    def demand(self, system: Any, x: NDArray[Any], t: Any) -> Any:
        """Return the torque of the law, (3,), followed by its new memory."""
        return self._law(system)(x.copy(), t)

    def _command(self, system: Any) -> Callable[..., Any]:
        """Return what is held, as a function of the torque (3,) of the law, of the state and of the time."""
        limited = limited_by(self.max_torque)

        def command(torque: Any, x: Any, t: Any) -> Any:
            return limited(torque)

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        """Return the function (y, t, tau) that moves a state in place; what is held begins at `begin`."""

        def act(y: Any, t: Any, tau: Any) -> None:
            for i in range(3):
                y[i] += tau * y[begin + i]

        return act

    def check(self, system: Any) -> None:
        self.held_names(system)
        x = sample_state(sample_points(system.dim)[0], system)
        if self.memory:
            self._check_memory(system, x)
            return
        if getattr(self.law, "sees_attitude", False) and not self._measures:
            self.law.check(system)
        torque = np.asarray(self.demand(system, x, SAMPLE_TIME))[:3]
        if torque.shape != (3,):
            raise ValueError(f"the law of {self.label} returns {short(torque.tolist())}; it must return (3,)")

    def _check_memory(self, system: Any, x: NDArray[Any]) -> None:
        """Raise an error unless a law with a memory returns a torque and a memory of its shape."""
        if self.law.sees_attitude:
            check_attitude(system)
        size, first = self._memory_size, self._first_remembered(system)
        rule = f"give the torque, (3,), and the new memory, ({size},)"
        try:
            torque, memory = self.law.values_with_memory(system, x, SAMPLE_TIME, x[first : first + size].copy())
        except Exception as reason:  # functions of users raise anything
            failure = f"{type(reason).__name__}: {in_one_line(str(reason), 200)}"
            raise ValueError(f"the law of {self.label} fails at a sample point ({failure}); {rule}") from None
        if (np.shape(torque), np.shape(memory)) != ((3,), (size,)):
            raise ValueError(
                f"the law of {self.label} returns the shapes {np.shape(torque)} and {np.shape(memory)}; {rule}"
            )

    def check_steps(self, t0: float, h: float) -> None:
        super().check_steps(t0, h)
        for what, time in (("period", self.period), ("start", t0)):
            count = time / h
            # A period far below the step is no rounding of zero steps.
            unit = 1.0 if what == "start" else min(1.0, abs(count))
            if abs(count - round(count)) > ON_GRID * max(unit, abs(count) * ON_GRID):
                raise ValueError(
                    f"the {what} {'of the run' if what == 'start' else f'of {self.label}'} is {time:g}, which is not a "
                    f"whole number of steps of {h:g}; samples are at starts of steps, so take a step that divides it"
                )

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the derivative while the command is held."""
        act, (whole, half) = _action(self, system), (np.array(x, dtype=np.float64) for _ in range(2))
        act(whole, t, DIFFERENCE_TIME)
        act(half, t, 0.5 * DIFFERENCE_TIME)
        return np.asarray((4.0 * half - whole - 3.0 * np.asarray(x)) / DIFFERENCE_TIME)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        """Return the flow while the command is held."""
        return np.asarray(_flow_of((), self, system)(x, t, tau))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.flow(_flow_of((), self, system))


class _FirstFlow(Force):
    """The flow of a sampled force that comes first in a step, and evaluates the laws of all on one state."""

    reversible = False

    def __init__(self, forces: tuple[Any, ...]) -> None:
        self._forces = forces

    def check(self, system: Any) -> None:
        self._forces[0].check(system)

    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        return self._forces[0].field(system, x, t)

    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        return np.asarray(_flow_of(self._forces, self._forces[0], system)(x, t, tau))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.flow(_flow_of(self._forces, self._forces[0], system))


def flows_of(forces: Sequence[Force]) -> tuple[tuple[int, Force], ...]:
    """Return the flows of forces with their positions: that of the first sampled one evaluates the laws of all."""
    numbered = tuple(enumerate(forces))
    sampled = [k for k, force in numbered if force.sampled]
    first = _FirstFlow(tuple(forces[k] for k in sampled))
    return ((sampled[0], first), *(pair for pair in numbered if pair[0] != sampled[0]))


# Systems are immutable, and forces too. Derivatives by differences return to some hundred systems in each step.
@lru_cache(maxsize=1024)
def _action(force: Sampled, system: Any) -> Callable[..., None]:
    """Return the function (y, t, tau) by which a held command moves a state in place."""
    return force._act(system, _begin(force, system))


@lru_cache(maxsize=1024)
def _flow_of(evaluated: tuple[Sampled, ...], force: Sampled, system: Any) -> Callable[..., Any]:
    """Return the flow of a force, at a sample after the evaluation of some laws, all on the state before it."""
    act = _action(force, system)
    if not evaluated:

        def held(x: Any, t: Any, tau: Any) -> Any:
            y = x.copy()
            act(y, t, tau)
            return y

        return held
    sample = _sample_of(evaluated[0], system)
    for other in evaluated[1:]:
        sample = _both(sample, _sample_of(other, system))

    def flow(x: Any, t: Any, tau: Any) -> Any:
        y = x.copy()
        sample(x, y, t, tau)
        act(y, t, tau)
        return y

    return flow


def _sample_of(force: Sampled, system: Any) -> Callable[..., None]:
    """Return the function that writes into y what a force holds after a sample of x."""
    begin, count, period = _begin(force, system), force._count(system), force.period
    law, command = force._law(system), force._command(system)
    waiting, remembered = count * force.delay, force._memory_size
    last, rounded = begin + waiting, force.resolution is not None
    unit = np.array(np.broadcast_to(force.resolution if rounded else 1.0, count), dtype=np.float64)

    def sample(x: Any, y: Any, t: Any, tau: Any) -> None:
        # The halves of a step begin at the multiples of tau, and whole steps at even ones.
        if np.abs(t - period * np.floor(t / period + 0.5)) < 0.25 * tau:
            found = law(x, t)
            values = command(found[:3], x, t)
            # The commands that wait follow the one that acts.
            for i in range(waiting):
                y[begin + i] = x[begin + count + i]
            for i in range(count):
                # Unlike rint, floor does not depend on the rounding mode.
                y[last + i] = unit[i] * np.floor(values[i] / unit[i] + 0.5) if rounded else values[i]
            for i in range(remembered):
                y[last + count + i] = found[3 + i]

    return sample


def _both(one: Callable[..., None], other: Callable[..., None]) -> Callable[..., None]:
    def both(x: Any, y: Any, t: Any, tau: Any) -> None:
        one(x, y, t, tau)
        other(x, y, t, tau)

    return both


def _read_memory(value: Any, what: str) -> tuple[tuple[str, int], ...]:
    """Validate names and sizes of what a law remembers, a mapping or pairs, and return pairs; None is no memory."""
    rule = 'give names of letters, each with a size: {"integral": 3}'
    try:
        pairs = {} if value is None else dict(value)
    except (TypeError, ValueError):
        raise TypeError(f"{what} is {short(value)}; {rule}") from None
    unnamed = [name for name in pairs if not re.fullmatch("[A-Za-z_]+", str(name)) or name == "held"]
    if unnamed:
        raise ValueError(f"{what} has the name {short(unnamed[0])}; {rule}, of other names than held")
    return tuple(
        (str(name), read_integer(size, f"{what}, the size of {name},", 1, MAX_MEMORY)) for name, size in pairs.items()
    )


def _begin(force: Sampled, system: Any) -> int:
    """Return the index of the first number that a force holds in the state."""
    return int(system.dim - system.held + force.first)


def _law_of(law: StateTorque, system: Any) -> Callable[..., Any]:
    """Return the torque of a law in the body frame, (3,), as a function of (x, t) for compiled functions."""
    function, arguments = law.law_on_state(system)
    forms: Mapping[str, Callable[..., Any]] = {
        "t": lambda x, t: function(t)[:3],
        "x": lambda x, t: function(x)[:3],
        "x, t": lambda x, t: function(x, t)[:3],
    }
    return forms[arguments]
