"""Controllers that are sampled: their torque, or the command of an actuator, is held between samples."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial, reduce
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import sample_points
from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import inverse_of
from coadjoint.systems.forces.angular_velocity import velocity_map
from coadjoint.systems.forces.base import MEASURED, Force, ForceReader, SampleNoise, read_seed
from coadjoint.systems.forces.body_torque import Pointing, check_one_body, cross, limited_by, read_limits
from coadjoint.systems.forces.torque import StateTorque, check_attitude, law_with_memory, sample_state
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.validation import read_finite, read_integer, read_positive, set_fields

DIFFERENCE_TIME = 2.0**-16  # of differences of a flow, whose error is proportional to its square
MAX_DELAY, MAX_MEMORY = 1000, 4096  # periods, and numbers: far above those of controllers, and small in memory
COUNT = 3 * len(MEASURED)  # of the deviates of a law at a sample; those of its biases follow
MAX_ANGLE = 1.0  # radians: far above the errors of sensors, and below what degrees would be
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

    What the law measures may have errors: Gaussian noise, independent at each sample and about each axis, and a bias,
    drawn once for each member, from which the noise deviates. The law sees a body that is turned by a small rotation
    about its axes, and an angular velocity with an error added, also in its argument ``x``. The errors are a function
    of the seed, the number of the member and that of the sample only: they do not depend on the step, on the number of
    threads, on other members, or on how often a run is interrupted and resumed. Derivatives of runs are those with the
    same errors.

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
    noise : mapping, optional
        Standard deviations of the noise of what the law measures, a number or one for each axis of the body:
        ``"attitude"`` in radians, at most 1, and ``"angular_velocity"`` in radians per time. A rotation by the angle a
        about the unit vector n has the error ``2 tan(a/2) n``.
    bias : mapping, optional
        Standard deviations of the biases, constant in a run, by the same names.
    seed : int, optional
        Seed of the errors, from 0 to 2^62. It is required for noise and bias, so that no two runs share them by
        accident.
    stream : int
        Member m of a run has the errors number ``stream + m`` of the seed. With stream=m a single run is bit-identical
        to member m of an ensemble.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        The law is no torque, returns other shapes, or has a memory where none is given; there is noise without a seed,
        or of what is not measured; or the system is not made by `co.systems.body`. In runs: the step does not divide
        the period, the start is no whole number of steps, or time runs backward.

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

    A star tracker and a gyroscope, whose bias is that of the member:

    >>> law, errors = co.forces.Pointing(stiffness=0.5, damping=1.5), {"attitude": 1e-4, "angular_velocity": 2e-5}
    >>> flown = co.forces.Sampled(law, 0.5, noise=errors, bias={"angular_velocity": 1e-4}, seed=5)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(flown)
    >>> sol = co.integrate(sat, np.tile(sat.state(), (20, 1)), (0, 60), 0.125)
    >>> offset = sol.rotation[-20:].as_rotvec().std()  # about damping / stiffness times the bias
    >>> bool(2e-4 < offset < 4.5e-4)
    True
    """

    law: Any
    period: float
    max_torque: Any = None
    memory: Any = field(default=None, kw_only=True)
    delay: int = field(default=0, kw_only=True)
    resolution: Any = field(default=None, kw_only=True)
    noise: Any = field(default=None, kw_only=True)
    bias: Any = field(default=None, kw_only=True)
    seed: Any = field(default=None, kw_only=True)
    stream: int = field(default=0, kw_only=True)
    first: int = field(default=0, kw_only=True)

    example: ClassVar = {"law": Pointing(0.1, 0.2), "period": 0.25}
    reversible: ClassVar[bool] = False
    uses_energy: ClassVar[bool] = False
    sampled: ClassVar[bool] = True
    command_name: ClassVar[str] = "torque"
    selectors: ClassVar[tuple[str, ...]] = ("period", "memory", "delay", "first")
    named_values: ClassVar[tuple[str, ...]] = ("noise", "bias")
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
        self._read(noise=self._read_errors, bias=self._read_errors, stream=read_seed)
        set_fields(self, random=bool(self.noise or self.bias))
        if self.seed is not None:
            self._read(seed=read_seed)
        elif self.random:
            raise TypeError(f"noise of {self.label} needs a seed, a whole number: runs of one seed have the same noise")
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
    def _measured(self) -> tuple[str, ...]:
        """Names of what the law measures."""
        return "attitude", "angular_velocity"

    def _read_errors(self, value: Any, what: str) -> tuple[tuple[str, Any], ...]:
        """Validate standard deviations by name, a mapping or pairs, and return pairs; None is no error."""
        known = self._measured
        rule = f"give standard deviations of {' and '.join(known)}: {{{known[-1]!r}: 0.001}}"
        try:
            pairs = {} if value is None else dict(value)
        except (TypeError, ValueError):
            raise TypeError(f"{what} is {short(value)}; {rule}") from None
        if not {*pairs} <= {*known}:
            other = next(name for name in pairs if name not in known)
            raise ValueError(f"{what} has {short(other)}, which the law does not measure; {rule}")
        sizes = {name: read_finite(pairs[name], f"{name} in {what}") for name in known if name in pairs}
        found = {name: read_limits(size, f"{name} in {what}", zero=True) for name, size in sizes.items()}
        if np.max(found.get("attitude", 0.0)) > MAX_ANGLE:
            raise ValueError(f"attitude in {what} is {short(found['attitude'])}; it is in radians, at most {MAX_ANGLE}")
        return tuple(found.items())

    def _error(self, name: str) -> Callable[..., Any] | None:
        """Return the error of what is measured as a function of the deviates of the law; None if there is none."""
        if all(name not in dict(of) for of in (self.noise, self.bias)):
            return None
        noise, bias = (np.array(np.broadcast_to(dict(of).get(name, 0.0), 3)) for of in (self.noise, self.bias))
        first = 3 * MEASURED.index(name)

        def error(deviates: Any) -> Any:
            found = 0.0 * deviates[:3]
            for i in range(3):
                found[i] = noise[i] * deviates[first + i] + bias[i] * deviates[COUNT + first + i]
            return found

        return error

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
        if "attitude" in (errors := dict((*self.noise, *self.bias))):
            check_attitude(system, f"noise of {self.label}")
        if "angular_velocity" in errors:
            _moving_inertia(system, self.label)
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
        """Return the torque of the law, (3,), followed by its new memory, as a function of (x, t, deviates)."""
        if self.memory:
            law = law_with_memory(self.law, system, self._first_remembered(system), self._memory_size)
        else:
            law = _law_of(self.law, system)
        seen = _seen(self._error("attitude"), self._error("angular_velocity"), system, self.label)
        return lambda x, t, deviates: law(seen(x, deviates), t)

    def _first_remembered(self, system: Any) -> int:
        """Return the index in the state of the first number that the law remembers."""
        return _begin(self, system) + self._count(system) * (1 + self.delay)

    def demand(self, system: Any, x: NDArray[Any], t: Any) -> Any:
        """Return the torque of the law, (3,), followed by its new memory."""
        return self._law(system)(x.copy(), t, np.zeros(2 * COUNT))

    def _command(self, system: Any) -> Callable[..., Any]:
        """Return what is held, as a function of the torque (3,) of the law, the state, the time and the deviates."""
        limited = limited_by(self.max_torque)

        def command(torque: Any, x: Any, t: Any, deviates: Any) -> Any:
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
        torque = np.asarray(self.demand(system, x, sample_time_of(self)))[:3]
        if torque.shape != (3,):
            raise ValueError(f"the law of {self.label} returns {short(torque.tolist())}; it must return (3,)")

    def _check_memory(self, system: Any, x: NDArray[Any]) -> None:
        """Raise an error unless a law with a memory returns a torque and a memory of its shape."""
        if self.law.sees_attitude:
            check_attitude(system)
        size, first = self._memory_size, self._first_remembered(system)
        rule = f"give the torque, (3,), and the new memory, ({size},)"
        try:
            torque, memory = self.law.values_with_memory(
                system, x, sample_time_of(self), x[first : first + size].copy()
            )
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
        drawn = [np.concatenate([noise.deviates(t) for noise in noises])] if (noises := self._noises()) else []
        return np.asarray(_flow_of(self._forces, self._forces[0], system)(x, t, tau, *drawn))

    def describe_to(self, reader: ForceReader, system: Any) -> Any:
        return reader.flow(_flow_of(self._forces, self._forces[0], system), self._noises())

    def _noises(self) -> tuple[SampleNoise, ...]:
        return tuple(SampleNoise(force.seed, force.stream, force.period) for force in self._forces if force.random)


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
    noisy = [other for other in evaluated if other.random]
    samples = [_sample_of(other, system, 2 * COUNT * noisy.index(other) if other.random else 0) for other in evaluated]
    sample = reduce(_both, samples)

    def flow(x: Any, t: Any, tau: Any, deviates: Any) -> Any:
        y = x.copy()
        sample(x, y, t, tau, deviates)
        act(y, t, tau)
        return y

    # Laws without noise take the deviates too, and do not read them.
    return flow if noisy else lambda x, t, tau: flow(x, t, tau, x)


def _sample_of(force: Sampled, system: Any, place: int) -> Callable[..., None]:
    """Return the function that writes into y what a force holds after a sample of x; `place` is that of deviates."""
    begin, count, period = _begin(force, system), force._count(system), force.period
    law, command = force._law(system), force._command(system)
    waiting, remembered = count * force.delay, force._memory_size
    last, rounded = begin + waiting, force.resolution is not None
    unit = np.array(np.broadcast_to(force.resolution if rounded else 1.0, count), dtype=np.float64)

    def sample(x: Any, y: Any, t: Any, tau: Any, deviates: Any) -> None:
        # The halves of a step begin at the multiples of tau, and whole steps at even ones.
        if np.abs(t - period * np.floor(t / period + 0.5)) < 0.25 * tau:
            own = deviates[place : place + 2 * COUNT]
            found = law(x, t, own)
            values = command(found[:3], x, t, own)
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
    def both(x: Any, y: Any, t: Any, tau: Any, deviates: Any) -> None:
        one(x, y, t, tau, deviates)
        other(x, y, t, tau, deviates)

    return both


def _moving_inertia(system: Any, label: str) -> NDArray[np.float64]:
    """Return the change of the momentum by the angular velocity, with rotors at their momenta; refuse a rod."""
    M = velocity_map(system)[0][:, :3]
    try:
        return inverse_of(0.5 * (M + M.T), "inertia")
    except ValueError:
        raise ValueError(
            f"noise of {label} is that of an angular velocity, and {system.name} is a rod, which has none about its "
            "axis; give noise of the attitude alone"
        ) from None


def _seen(turning: Any, changing: Any, system: Any, label: str) -> Callable[..., Any]:
    """Return the state that a law sees, as a function of the state and the deviates, from the errors of both."""

    def true(x: Any, deviates: Any) -> Any:
        return x

    turned = true if turning is None else _turned_by(turning)
    accelerated = true if changing is None else _accelerated_by(changing, _moving_inertia(system, label))
    return lambda x, deviates: accelerated(turned(x, deviates), deviates)


def _turned_by(turning: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function that turns the attitude in a state by an error, twice the Gibbs vector of a rotation."""

    def turned(x: Any, deviates: Any) -> Any:
        y, half = x.copy(), 0.5 * turning(deviates)
        factor = 2.0 / (1.0 + half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
        for k in range(1, 4):
            across = cross(x[3 * k : 3 * k + 3], half)
            further = cross(across, half)
            for i in range(3):
                y[3 * k + i] += factor * (across[i] + further[i])
        return y

    return turned


def _accelerated_by(changing: Callable[..., Any], inertia: NDArray[np.float64]) -> Callable[..., Any]:
    """Return the function that changes the momentum in a state by that of an error of the angular velocity."""

    def accelerated(x: Any, deviates: Any) -> Any:
        y, error = x.copy(), changing(deviates)
        for i in range(3):
            y[i] += inertia[i, 0] * error[0] + inertia[i, 1] * error[1] + inertia[i, 2] * error[2]
        return y

    return accelerated


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
