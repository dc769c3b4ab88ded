"""Flows of forces as operations of a library of arrays, JAX or PyTorch, for states that are vectors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from coadjoint.systems.forces.base import Noise, SampleNoise, SpinTerms, ThermalNoise
from coadjoint.systems.forces.matrix_noise import QUANTA
from coadjoint.systems.forces.orbit_noise import NoiseTerms
from coadjoint.systems.forces.random_torque import Kicks
from coadjoint.systems.forces.torque import NODES, WEIGHTS, extrapolation_columns, extrapolation_weights
from coadjoint.systems.hamiltonians.parametrized_functions import ArrayLibrary
from coadjoint.systems.learned_forces import LearnedFlow, LearnedFunction

Flow = Callable[[Any, Any, Any, Any, Any], Any]
"""The flow of a force: of the numbers of the energy, state, time, duration and member."""
Function = Callable[[Any, Any, Any], Any]
"""A function of the state, the time and the params of the energy."""


class EnergyNumbers(NamedTuple):
    """The numbers of the energy of a run: coefficients of its monomials, and the params of its function or None."""

    coefficients: Any
    params: Any = None


def pair(flow: Any) -> tuple[Flow, Flow]:
    """Return the flows of a force before and after a substep."""
    return flow if type(flow) is tuple else (flow, flow)


def apply_half(flows: Sequence[tuple[Flow, Flow]], half: Iterable[Any], side: int, numbers: Any, x: Any, m: Any) -> Any:
    """Return a state after the flows on a side of a substep, as of `halves_of_step`, of the member m."""
    for j, time, duration in half:
        x = flows[j][side](numbers, x, time, duration, m)
    return x


def midpoint_on_orbit(
    library: ArrayLibrary, field: Any, direction: Callable[[Any, Any], Any], numbers: Any, x: Any
) -> Any:
    """Return exp(D_v) x with v = direction(numbers, y) at the midpoint y = exp(D_v / 2) x."""

    def prepare(numbers: Any, x: Any) -> Callable[[Any], Any]:
        return lambda middle: field.exponential(0.5 * direction(numbers, middle), x)

    middle = library.fixed_point(prepare, x, numbers, x)
    return field.exponential(direction(numbers, middle), x)


class ForceFlows:
    """A reader of a force that makes its flow in schemes of an order; `what` names its function in messages.

    `field` has ``at``, ``slopes``, ``product`` and ``exponential`` of the Hamiltonian part.
    """

    def __init__(self, library: ArrayLibrary, system: Any, field: Any, what: str, order: int) -> None:
        self.library, self.system, self.field, self.what, self.order = library, system, field, what, order

    @abstractmethod
    def traced(self, function: Any, arguments: str) -> Function:
        """Return a function of the user, of "t", "x" or "x, t", written with NumPy."""

    @abstractmethod
    def traced_flow(self, function: Any, noises: Sequence[SampleNoise]) -> Flow:
        """Return the flow of a function of the user, of "x, t, tau" and deviates."""

    def _own(self, function: Any, known: LearnedFunction) -> None:
        """Raise TypeError for a function of another library."""
        if known.library is not self.library:
            raise TypeError(
                f"{self.library.library} takes no force of {known.learned.caller}, as {self.what}; give that of its own"
            )

    def damping(self, rate: Any, toward: Any) -> Flow:
        """Return the flow of x' = -rate (x - toward), exact."""
        library, xp = self.library, self.library.xp
        rates, target = library.numbers(rate), library.numbers(toward)
        zeros = library.numbers(np.zeros((1, len(toward) + 1)))

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            deviation = x - target
            if rates.ndim < 2:
                return x + xp.expm1(-tau * rates) * deviation
            # The last column of this exponential is the displacement.
            moved = -tau * library.product(rates, deviation)
            generator = xp.concatenate([xp.concatenate([-tau * rates, moved[:, None]], axis=1), zeros])
            return x + library.expm(generator)[:-1, -1]

        return flow

    def constant(self, torque: Any) -> Flow:
        """Return the flow of a constant torque, exact."""
        change = self.library.numbers(torque)
        return lambda _, x, t, tau, member: x + tau * change

    def function(self, torque: Any, arguments: str) -> Flow:
        """Return the integral of a torque of the time by Gauss quadrature, or a step of an explicit method."""
        library, xp = self.library, self.library.xp
        if isinstance(torque, LearnedFunction):
            self._own(torque, torque)
            field: Function = lambda x, t, params: torque.at(params, x, t)  # noqa: E731
        else:
            field = self.traced(torque, arguments)

        def of_time(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            pairs = zip(NODES, WEIGHTS, strict=True)
            return x + 0.5 * tau * sum(w * field(x, t + 0.5 * tau * (1.0 + c), numbers.params) for c, w in pairs)

        def of_state(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            def stage(state: Any, c: Any, weight: Any) -> Any:
                slope, total = state
                slope = field(x + c * tau * slope, t + c * tau, numbers.params)
                return slope, total + weight * slope

            nodes, weights = np.array([0.0, 0.5, 0.5, 1.0]), np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
            zero = xp.zeros_like(x)
            return x + tau * library.iterate(stage, (zero, zero), (nodes, weights))[1]

        columns = extrapolation_columns(self.order)

        def extrapolated(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            first, change = field(x, t, numbers.params), xp.zeros_like(x)
            for k, weight in enumerate(extrapolation_weights(columns), 1):

                def midpoint(states: Any, node: Any, length: Any = tau / (2 * k)) -> Any:
                    before, now = states
                    return now, before + 2.0 * length * field(x + now, t + node * tau, numbers.params)

                start = xp.zeros_like(x), tau / (2 * k) * first
                change = change + weight * library.iterate(midpoint, start, (np.arange(1, 2 * k) / (2 * k),))[1]
            return x + change

        if arguments == "t":
            return of_time
        return extrapolated if columns else of_state

    def flow(self, function: Any, noises: Sequence[SampleNoise] = ()) -> Flow:
        """Return a given flow, also of the deviates of laws that measure with noise."""
        if not isinstance(function, LearnedFlow):
            return self.traced_flow(function, noises)
        self._own(function, function.root)

        def flow(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            def direction(numbers: Any, middle: Any) -> Any:
                return tau * function.direction_at(self.field, numbers, middle, t + 0.5 * tau)

            return midpoint_on_orbit(self.library, self.field, direction, numbers, x)

        return flow

    def kicks(self, kicks: Kicks, seed: int, stream: int) -> Flow:
        """Return additive noise, exact."""
        library, xp = self.library, self.library.xp
        factor, fixed = library.numbers(kicks.factor), library.numbers(kicks.state < 0)

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            deviates = library.normal_deviates(seed, stream + member, t, 0, kicks.motions)
            values = xp.where(fixed > 0.0, 1.0, x[kicks.state])
            return library.add_at(x, kicks.changed, factor * values * (tau**0.5 * deviates)[kicks.number])

        return flow

    def hamiltonian_noise(self, terms: NoiseTerms, seed: int, stream: int, levels: int) -> tuple[Flow, Flow]:
        """Return the noise of a step on each side of it: all or none."""
        library, xp = self.library, self.library.xp
        if not all(term.linear for term in terms.terms):
            raise TypeError(
                f"{library.library} takes noise of linear Hamiltonians, and {self.what} is of others; run it without "
                f"{library.library}"
            )
        count, n, parts = len(terms.terms), self.system.dim, 2**levels
        rows, sets = np.zeros((count, n)), np.zeros((len(terms.sets), count))
        for b, term in enumerate(terms.terms):
            rows[b, term.indices] = term.values
        for chosen, members in zip(sets, terms.sets, strict=True):
            chosen[list(members)] = 1.0
        directions, each = library.numbers(rows), library.numbers(np.arange(parts))

        def flow(side: int, x: Any, t: Any, h: Any, member: Any) -> Any:
            length = h / parts
            moments = xp.floor((t + each * length) / (length / QUANTA) + 0.5)
            drawn = library.normal_deviates(seed, stream + member, moments, 0, count + 1)
            increments = length**0.5 * drawn[:, :count].sum(0)

            def one(y: Any, chosen: Any) -> Any:
                return self.field.exponential(library.product((chosen * increments)[None], directions)[0], y)

            moved = library.iterate(one, x, (sets[::-1] if side else sets,))
            return xp.where((drawn[0, count] < 0.0) == (side == 0), moved, x)

        first, second = (lambda _, *given, side=side: flow(side, *given) for side in range(2))
        return first, second

    def thermal(self, rate: Any, noise: ThermalNoise | None) -> Flow:
        """Return the flow of an Ornstein-Uhlenbeck process, exact in distribution."""
        library, xp = self.library, self.library.xp
        rates, values = library.numbers(rate), None if noise is None else library.numbers(noise.values)

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            kept = x + xp.expm1(-tau * rates) * x
            if noise is None:
                return kept
            deviates = library.normal_deviates(noise.seed, noise.stream + member, t, 0, len(rates))
            kicks = library.add_at(xp.zeros_like(x), noise.rows, values * deviates[noise.columns])
            return kept + xp.sqrt(-xp.expm1(-2.0 * tau * rates)) * kicks

        return flow

    def on_orbit(self, metric: Any, root: Any, noise: Noise | None, spins: SpinTerms | None = None) -> Flow:
        """Return the midpoint rule of the damping on the orbit, between halves of the noise."""
        library, xp = self.library, self.library.xp
        metrics, roots = library.numbers(metric), library.numbers(root)
        added, unit = None if spins is None else library.numbers(spins.added), library.numbers(1.0)

        def applied(matrix: Any, y: Any) -> Any:
            return library.product(matrix, y) if matrix.ndim == 2 else matrix * y

        def inverse_lengths(x: Any) -> Any:
            if spins is None:
                return unit
            squares = (x[spins.spins] ** 2).sum(1)[:, None]
            moving = squares > 0.0
            inverse = xp.where(moving, 1.0 / xp.sqrt(xp.where(moving, squares, 1.0)), 0.0)
            return library.set_at(xp.zeros_like(x), spins.spins, inverse * xp.ones_like(x[spins.spins]))

        def damped(numbers: Any, x: Any, t: Any, tau: Any) -> Any:
            def rotation(given: Any, middle: Any) -> Any:
                numbers, shorter = given
                slopes = self.field.slopes(numbers, middle, t + 0.5 * tau)
                v = tau * shorter * applied(metrics, self.field.product(middle, slopes))
                return v if spins is None else v + tau * added * slopes

            return midpoint_on_orbit(library, self.field, rotation, (numbers, inverse_lengths(x)), x)

        if noise is None:
            return lambda numbers, x, t, tau, member: damped(numbers, x, t, tau)
        n = self.system.dim
        sets = np.zeros((len(noise.sets), n))
        for row, directions in zip(sets, noise.sets, strict=True):
            row[list(directions)] = 1.0

        def shaken(x: Any, t: Any, tau: Any, half: int, member: Any) -> Any:
            deviates = library.normal_deviates(noise.seed, noise.stream + member, t, half, n)
            size = noise.amplitude * (0.5 * tau) ** 0.5

            def one(x: Any, used: Any) -> Any:
                v = size * xp.sqrt(inverse_lengths(x)) * applied(roots, used * deviates)
                return self.field.exponential(v, x)

            return library.iterate(one, x, (sets[::-1] if half else sets,))

        def flow(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            x = shaken(x, t, tau, 0, member)
            return shaken(damped(numbers, x, t, tau), t, tau, 1, member)

        return flow
