"""Forces as operations of JAX: their flows, the noise of the compiled runs, and steps between half flows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.scipy.linalg import expm
from jax.scipy.special import ndtri

from coadjoint.jax.learned_forces import LearnedFlow, LearnedFunction
from coadjoint.jax.matrix_forces import MatrixForceReader
from coadjoint.jax.stage_steps import StageField, Steps, midpoint_on_orbit
from coadjoint.jax.table_steps import product
from coadjoint.jax.traced_functions import Reference, TracedFunction, on_jax
from coadjoint.kernels.tables.forces import compiled_force_function
from coadjoint.methods.forced import Forced, halves_of_step, substeps_of
from coadjoint.systems.forces.base import MEASURED, OF_RUN, OF_SAMPLE, Noise, SampleNoise, SpinTerms, ThermalNoise
from coadjoint.systems.forces.matrix_noise import QUANTA
from coadjoint.systems.forces.orbit_noise import NoiseTerms
from coadjoint.systems.forces.random_torque import Kicks
from coadjoint.systems.forces.torque import NODES, WEIGHTS, extrapolation_columns, extrapolation_weights

Flow = Callable[[Any, Any, Any, Any, Any], Any]
"""The flow of a force: of constants, state, time, duration and member."""


def steps_between_forces(inner: Steps, system: Any, field: Any, scheme: Forced) -> Steps:
    """Return steps between half flows of forces, as `methods.Forced`; constants: the scheme's, then coefficients."""
    plain = system.unforced
    readers: list[Any] = [
        MatrixForceReader(plain, system.labels[k])
        if plain.has_matrices
        else ForceReaders(plain, field, f"a function of {system.labels[k]}", scheme.order)
        for k, _ in system.flows
    ]
    described = [force.describe_to(reader, plain) for reader, (_, force) in zip(readers, system.flows, strict=True)]
    # Before and after a substep.
    flows: list[tuple[Flow, Flow]] = [flow if type(flow) is tuple else (flow, flow) for flow in described]

    # Unfinished states of matrices have the stages of earlier steps of one length, beside their numbers.
    unfinished = plain.has_matrices and len(scheme.fractions) == 1
    advance = inner.step if unfinished else inner.whole

    def step(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        own, energy = constants

        def substep(state: Any, at: Any) -> Any:
            (x, attitude), (begin, length, halves) = state, at
            for j, time, duration in halves[0]:
                x = flows[j][0](energy, x, time, duration, member)
            x, attitude = advance(own, (x, attitude), begin, length, member)
            for j, time, duration in halves[1]:
                x = flows[j][1](energy, x, time, duration, member)
            return x, attitude

        if len(scheme.fractions) == 1 or any(flow.around_steps for _, flow in system.flows):
            for at in halves_of_step(system.flows, scheme.fractions, t, h):
                state = substep(state, at)
            return state

        def scanned(state: Any, at: Any) -> Any:
            return substep(state, next(halves_of_step(system.flows, (1.0,), *at))), None

        each = substeps_of(scheme.fractions, t, h)
        return lax.scan(scanned, state, tuple(map(jnp.array, zip(*each, strict=True))))[0]

    functions = *inner.functions, *(one for reader in readers for one in reader.functions)

    def constants_of(energy: Any) -> Any:
        return inner.constants(energy), energy

    if not unfinished:
        return Steps(constants_of, step, step, functions=functions)

    def begin(constants: Any, state: Any, t: Any, h: Any) -> Any:
        return inner.begin(constants[0], state, t, h)

    def whole(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        return inner.finish(constants, step(constants, begin(constants, state, t, h), t, h, member))

    return Steps(constants_of, step, whole, begin, inner.finish, functions)


class ForceReaders:
    """A reader of a force that makes its flow in schemes of an order; `what` names its `functions` in messages."""

    def __init__(self, system: Any, field: StageField, what: str, order: int) -> None:
        self.system, self.field, self.what, self.order = system, field, what, order
        self.functions: tuple[TracedFunction, ...] = ()

    def _traced(self, function: Any, arguments: str, behind: int = 0) -> TracedFunction:
        """Return a function of some arguments as one of the state, with those of a flow behind it, and the time."""
        what, n = self.what, self.system.dim
        if isinstance(function, LearnedFunction):
            traced = TracedFunction(lambda y, t, params: function.at(params, y, t), None, np.arange(n), what)
            self.functions = (traced,)
            return traced
        of_jax = on_jax(function, what)
        forms: dict[str, Callable[[Any, Any], Any]] = {
            "t": lambda y, t: of_jax(t),
            "x": lambda y, t: of_jax(y),
            "x, t": of_jax,
            "x, t, tau": lambda y, t: of_jax(y[:n], t, y[n]),
            "x, t, tau, deviates": lambda y, t: of_jax(y[:n], t, y[n], y[n + 1 :]),
        }

        def reference() -> Reference:
            compiled = compiled_force_function(function, arguments, n + behind, n, what)
            return partial(compiled.values, results=n)

        traced = TracedFunction(
            lambda y, t, params=None: jnp.reshape(forms[arguments](y, t), n), reference, np.arange(n), what, behind
        )
        self.functions = (traced,)
        return traced

    def damping(self, rate: Any, toward: Any) -> Flow:
        """Return the flow of x' = -rate (x - toward), exact."""

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            deviation = x - toward
            if rate.ndim < 2:
                return x + jnp.expm1(-tau * rate) * deviation
            # The last column of this exponential is the displacement.
            n = len(rate)
            generator = jnp.zeros((n + 1, n + 1)).at[:n, :n].set(-tau * rate)
            return x + expm(generator.at[:n, n].set(-tau * product(rate, deviation)))[:n, n]

        return flow

    def constant(self, torque: Any) -> Flow:
        """Return the flow of a constant torque, exact."""
        return lambda _, x, t, tau, member: x + tau * torque

    def function(self, torque: Any, arguments: str) -> Flow:
        """Return the integral of a torque of the time by Gauss quadrature, or a step of an explicit method."""
        field = self._traced(torque, arguments).at

        def of_time(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            pairs = zip(NODES, WEIGHTS, strict=True)
            return x + 0.5 * tau * sum(w * field(x, t + 0.5 * tau * (1.0 + c), numbers.params) for c, w in pairs)

        def of_state(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            def stage(state: Any, node: Any) -> Any:
                slope, total = state
                c, weight = node
                slope = field(x + c * tau * slope, t + c * tau, numbers.params)
                return (slope, total + weight * slope), None

            nodes = jnp.array([0.0, 0.5, 0.5, 1.0]), jnp.array([1.0, 2.0, 2.0, 1.0]) / 6.0
            zero = jnp.zeros_like(x)
            return x + tau * lax.scan(stage, (zero, zero), nodes)[0][1]

        columns = extrapolation_columns(self.order)

        def extrapolated(numbers: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            first, change = field(x, t, numbers.params), jnp.zeros_like(x)
            for k, weight in enumerate(extrapolation_weights(columns), 1):

                def midpoint(states: Any, node: Any, length: Any = tau / (2 * k)) -> Any:
                    before, now = states
                    return (now, before + 2.0 * length * field(x + now, t + node * tau, numbers.params)), None

                nodes = jnp.arange(1, 2 * k) / (2 * k)
                start = jnp.zeros_like(x), tau / (2 * k) * first
                change = change + weight * lax.scan(midpoint, start, nodes)[0][1]
            return x + change

        if arguments == "t":
            return of_time
        return extrapolated if columns else of_state

    def flow(self, function: Any, noises: Sequence[SampleNoise] = ()) -> Flow:
        """Return a given flow, also of the deviates of laws that measure with noise."""
        if isinstance(function, LearnedFlow):
            self.functions = self.field.functions
            return function.on_jax(self.field)
        if not noises:
            traced = self._traced(function, "x, t, tau", 1).at
            return lambda _, x, t, tau, member: traced(jnp.append(x, tau), t)
        count = 3 * len(MEASURED)
        noisy = self._traced(function, "x, t, tau, deviates", 1 + 2 * count * len(noises)).at

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            drawn = []
            for one in noises:
                number, stream = jnp.floor(t / one.period + 0.5), one.stream + member
                drawn.append(normal_deviates(one.seed, stream, number, OF_SAMPLE, count))
                drawn.append(normal_deviates(one.seed, stream, 0.0, OF_RUN, count))
            return noisy(jnp.concatenate([x, jnp.atleast_1d(tau), *drawn]), t)

        return flow

    def kicks(self, kicks: Kicks, seed: int, stream: int) -> Flow:
        """Return additive noise, exact."""

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            drawn = jnp.sqrt(tau) * normal_deviates(seed, stream + member, t, 0, kicks.motions)
            values = jnp.where(kicks.state < 0, 1.0, x[kicks.state])
            return x.at[kicks.changed].add(kicks.factor * values * drawn[kicks.number])

        return flow

    def hamiltonian_noise(self, terms: NoiseTerms, seed: int, stream: int, levels: int) -> tuple[Flow, Flow]:
        """Return the noise of a step on each side of it: all or none."""
        if not all(term.linear for term in terms.terms):
            raise TypeError(f"JAX takes noise of linear Hamiltonians, and {self.what} is of others; run it without JAX")
        count, n, parts = len(terms.terms), self.system.dim, 2**levels
        rows, sets = np.zeros((count, n)), np.zeros((len(terms.sets), count))
        for b, term in enumerate(terms.terms):
            rows[b, term.indices] = term.values
        for chosen, members in zip(sets, terms.sets, strict=True):
            chosen[list(members)] = 1.0

        def flow(side: int, x: Any, t: Any, h: Any, member: Any) -> Any:
            length = h / parts
            numbers = jnp.floor((t + jnp.arange(parts) * length) / (length / QUANTA) + 0.5)
            drawn = jax.vmap(lambda number: normal_deviates(seed, stream + member, number, 0, count + 1))(numbers)
            increments = jnp.sqrt(length) * jnp.sum(drawn[:, :count], axis=0)

            def one(y: Any, chosen: Any) -> Any:
                return self.field.exponential(product((chosen * increments)[None], rows)[0], y), None

            moved = lax.scan(one, x, sets[::-1] if side else sets)[0]
            return jnp.where((drawn[0, count] < 0.0) == (side == 0), moved, x)

        first, second = (lambda _, *given, side=side: flow(side, *given) for side in range(2))
        return first, second

    def thermal(self, rate: Any, noise: ThermalNoise | None) -> Flow:
        """Return the flow of an Ornstein-Uhlenbeck process, exact in distribution."""

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            kept = x + jnp.expm1(-tau * rate) * x
            if noise is None:
                return kept
            deviates = normal_deviates(noise.seed, noise.stream + member, t, 0, len(rate))
            kicks = jnp.zeros_like(x).at[noise.rows].add(noise.values * deviates[noise.columns])
            return kept + jnp.sqrt(-jnp.expm1(-2.0 * tau * rate)) * kicks

        return flow

    def on_orbit(self, metric: Any, root: Any, noise: Noise | None, spins: SpinTerms | None = None) -> Flow:
        """Return the midpoint rule of the damping on the orbit, between halves of the noise."""
        self.functions = self.field.functions

        def inverse_lengths(x: Any) -> Any:
            if spins is None:
                return 1.0
            squares = jnp.sum(x[spins.spins] ** 2, axis=1, keepdims=True)
            moving = squares > 0.0
            inverse = jnp.where(moving, 1.0 / jnp.sqrt(jnp.where(moving, squares, 1.0)), 0.0)
            return jnp.zeros_like(x).at[spins.spins].set(inverse)

        def damped(energy: Any, x: Any, t: Any, tau: Any) -> Any:
            shorter = inverse_lengths(x)

            def rotation(middle: Any) -> Any:
                slopes = self.field.slopes(energy, middle, t + 0.5 * tau)
                v = tau * shorter * _applied(metric, self.field.product(middle, slopes))
                return v if spins is None else v + tau * spins.added * slopes

            return midpoint_on_orbit(self.field, rotation, x)

        if noise is None:
            return lambda energy, x, t, tau, member: damped(energy, x, t, tau)
        n = self.system.dim
        sets = np.zeros((len(noise.sets), n))
        for row, directions in zip(sets, noise.sets, strict=True):
            row[list(directions)] = 1.0

        def shaken(x: Any, t: Any, tau: Any, half: int, member: Any) -> Any:
            deviates = normal_deviates(noise.seed, noise.stream + member, t, half, n)
            size = noise.amplitude * jnp.sqrt(0.5 * tau)

            def one(x: Any, used: Any) -> Any:
                v = size * jnp.sqrt(inverse_lengths(x)) * _applied(root, used * deviates)
                return self.field.exponential(v, x), None

            return lax.scan(one, x, sets[::-1] if half else sets)[0]

        def flow(energy: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            x = shaken(x, t, tau, 0, member)
            return shaken(damped(energy, x, t, tau), t, tau, 1, member)

        return flow


def _applied(matrix: Any, y: Any) -> Any:
    return product(matrix, y) if np.ndim(matrix) == 2 else matrix * y


def normal_deviates(seed: Any, stream: Any, moment: Any, part: int, count: int) -> Any:
    """Return the deviates of `systems.forces.base.normal_deviates`, equal to round-off."""
    time = lax.bitcast_convert_type(jnp.asarray(moment, jnp.float64) + 0.0, jnp.uint64)
    blocks = jnp.arange(-(-count // 4), dtype=jnp.uint64)
    words = jax.vmap(partial(philox, key=seed), (0, None, None, None))(
        blocks, time, jnp.asarray(stream, jnp.uint64), jnp.uint64(part)
    )
    words = words.ravel()[:count]
    size = -ndtri((jnp.asarray(words >> jnp.uint64(12), jnp.float64) + 0.5) * 2.0**-53)
    return jnp.where(words & jnp.uint64(1), -size, size)


def philox(*counter: Any, key: Any) -> Any:
    """Return four random words by Philox4x64-10; see `forces/random.hpp`."""
    a, b, c, d = counter
    first, second = (jnp.uint64(word) for word in (0xD2E7470EE14C6C93, 0xCA5A826395121157))
    for k in range(10):
        one = jnp.uint64((key + k * 0x9E3779B97F4A7C15) % 2**64)
        two = jnp.uint64(k * 0xBB67AE8584CAA73B % 2**64)
        a, b, c, d = _high(second, c) ^ b ^ one, second * c, _high(first, a) ^ d ^ two, first * a
    return jnp.stack([a, b, c, d])


def _high(a: Any, b: Any) -> Any:
    low, half = jnp.uint64(2**32 - 1), jnp.uint64(32)
    a0, a1, b0, b1 = a & low, a >> half, b & low, b >> half
    middle = a1 * b0 + (a0 * b0 >> half)
    return a1 * b1 + (middle >> half) + (a0 * b1 + (middle & low) >> half)
