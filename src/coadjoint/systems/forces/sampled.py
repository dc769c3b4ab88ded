"""Controllers that are sampled: their torque, or the command of an actuator, is held between samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, sample_points
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force, ForceReader
from coadjoint.systems.forces.body_torque import Pointing, check_one_body, limited_by, read_limits
from coadjoint.systems.forces.torque import StateTorque, sample_state
from coadjoint.validation import read_integer, read_positive

DIFFERENCE_TIME = 2.0**-16  # of differences of a flow, whose error is proportional to its square
ON_GRID = 1e-9  # part of a step by which a time may miss a whole number of steps, by rounding


@suggest_keywords
@dataclass(frozen=True)
class Sampled(Force):
    """A torque that is sampled at a rate and held constant in the body frame between samples (zero-order hold).

    Samples are at the multiples of the period: the law is evaluated on the state at the start of the step that begins
    there, before any force acts, and the held torque acts exactly. It is in the state, whose last numbers are those
    that forces hold: ``with_forces`` makes room for them, and ``system.state(...)`` of its result makes states, where
    nothing is held. So runs continue, are stored, and are differentiated as others.

    Parameters
    ----------
    law : Torque, Pointing or another torque on a body
        The torque in the body frame of the state and the time at a sample.
    period : float
        Time between samples, a whole number of steps. Runs start at a whole number of steps.
    max_torque : float or (3,), optional
        Limit of each component.
    first : int
        Index of its first number among those that forces hold; ``with_forces`` sets it.

    Raises
    ------
    TypeError, ValueError
        The law is no torque, or the system is not made by `co.systems.body`. In runs: the step does not divide the
        period, the start is no whole number of steps, or time runs backward.

    Examples
    --------
    >>> import coadjoint as co
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(co.forces.Sampled(law, period=0.5))
    >>> x0 = sat.state([0.6, 0.0, 0.0, 0.8], angular_velocity=(0.1, 0.2, 0.3))
    >>> sol = co.integrate(sat, x0, (0, 60), 0.05)
    >>> bool(sol.rotation[-1].magnitude() < 1e-5), bool((sol.x[21:30, -3:] == sol.x[21, -3:]).all())
    (True, True)
    """

    law: Any
    period: float
    max_torque: Any = None
    first: int = field(default=0, kw_only=True)

    example: ClassVar = {"law": Pointing(0.1, 0.2), "period": 0.25}
    reversible: ClassVar[bool] = False
    uses_energy: ClassVar[bool] = False
    sampled: ClassVar[bool] = True
    command_name: ClassVar[str] = "torque"
    selectors: ClassVar[tuple[str, ...]] = ("period", "first")
    _limits: ClassVar[Mapping[str, Callable[..., Any]]] = {"max_torque": read_limits}

    def __post_init__(self) -> None:
        if not isinstance(self.law, StateTorque):
            raise TypeError(
                f"law of {self.label} is {short(self.law)}; give a torque of co.forces, such as Pointing(...) or "
                "Torque(function)"
            )
        self._read(period=read_positive, first=partial(read_integer, minimum=0), **self._limits)

    def held_numbers(self, system: Any) -> int:
        check_one_body(system, self.label)
        if not hasattr(system, "with_held"):
            raise TypeError(
                f"{self.label} is held in the state, and that of {system.name} has no room for it; take "
                "co.systems.body(inertia), or body(inertia, attitude=False), in place of a top with gravity as a "
                "co.forces.Torque"
            )
        return self._count(system)

    def _count(self, system: Any) -> int:
        """Return how many numbers are held."""
        return 3

    def held_at(self, system: Any, x: NDArray[Any]) -> NDArray[Any]:
        """Return the command that is held at states (..., dim), (..., count)."""
        begin = _begin(self, system)
        return x[..., begin : begin + self._count(system)]

    def _command(self, system: Any) -> Callable[..., Any]:
        """Return what is held, as a function of the torque (3,) of the law and of the state."""
        limited = limited_by(self.max_torque)

        def command(torque: Any, x: Any) -> Any:
            return limited(torque)

        return command

    def _act(self, system: Any, begin: int) -> Callable[..., None]:
        """Return the function (y, t, tau) that moves a state in place; what is held begins at `begin`."""

        def act(y: Any, t: Any, tau: Any) -> None:
            for i in range(3):
                y[i] += tau * y[begin + i]

        return act

    def check(self, system: Any) -> None:
        self.held_numbers(system)
        if getattr(self.law, "sees_attitude", False):
            self.law.check(system)
        x = sample_points(system.dim)[0]
        x = sample_state(x, system)
        torque = np.asarray(_law_of(self.law, system)(x, SAMPLE_TIME))
        if torque.shape != (3,):
            raise ValueError(f"the law of {self.label} returns {short(torque.tolist())}; it must return (3,)")

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
    law, command = _law_of(force.law, system), force._command(system)

    def sample(x: Any, y: Any, t: Any, tau: Any) -> None:
        # The halves of a step begin at the multiples of tau, and whole steps at even ones.
        if np.abs(t - period * np.floor(t / period + 0.5)) < 0.25 * tau:
            values = command(law(x, t), x)
            for i in range(count):
                y[begin + i] = values[i]

    return sample


def _both(one: Callable[..., None], other: Callable[..., None]) -> Callable[..., None]:
    def both(x: Any, y: Any, t: Any, tau: Any) -> None:
        one(x, y, t, tau)
        other(x, y, t, tau)

    return both


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
