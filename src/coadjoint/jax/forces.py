"""Forces as operations of JAX: functions of the user in their flows, and steps between half flows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.jax.library import LIBRARY
from coadjoint.jax.matrix_forces import MatrixForceReader
from coadjoint.jax.stage_steps import Steps
from coadjoint.jax.traced_functions import Reference, TracedFunction, on_jax
from coadjoint.kernels.tables.forces import compiled_force_function
from coadjoint.methods.force_flows import Flow, ForceFlows, Function, apply_half, pair
from coadjoint.methods.forced import Forced, halves_of_step, substeps_of
from coadjoint.systems.forces.base import MEASURED, OF_RUN, OF_SAMPLE, SampleNoise


def steps_between_forces(inner: Steps, system: Any, field: Any, scheme: Forced) -> Steps:
    """Return steps between half flows of forces, as `methods.Forced`; constants: the scheme's, then coefficients."""
    plain = system.unforced
    readers: list[Any] = [
        MatrixForceReader(plain, system.labels[k])
        if plain.has_matrices
        else JaxForceFlows(LIBRARY, plain, field, f"a function of {system.labels[k]}", scheme.order)
        for k, _ in system.flows
    ]
    described = [force.describe_to(reader, plain) for reader, (_, force) in zip(readers, system.flows, strict=True)]
    flows = list(map(pair, described))

    # Unfinished states of matrices have the stages of earlier steps of one length, beside their numbers.
    unfinished = plain.has_matrices and len(scheme.fractions) == 1
    advance = inner.step if unfinished else inner.whole

    def step(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        own, energy = constants

        def substep(state: Any, at: Any) -> Any:
            (x, attitude), (begin, length, halves) = state, at
            x = apply_half(flows, halves[0], 0, energy, x, member)
            x, attitude = advance(own, (x, attitude), begin, length, member)
            return apply_half(flows, halves[1], 1, energy, x, member), attitude

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


class JaxForceFlows(ForceFlows):
    """A reader of a force that makes its flow of JAX; `functions` are those of the user."""

    functions: tuple[TracedFunction, ...] = ()

    def _traced(self, function: Any, arguments: str, behind: int = 0) -> TracedFunction:
        """Return a function of some arguments as one of the state, with those of a flow behind it, and the time."""
        what, n = self.what, self.system.dim
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

    def traced(self, function: Any, arguments: str) -> Function:
        return self._traced(function, arguments).at

    def traced_flow(self, function: Any, noises: Sequence[SampleNoise]) -> Flow:
        if not noises:
            traced = self._traced(function, "x, t, tau", 1).at
            return lambda _, x, t, tau, member: traced(jnp.append(x, tau), t)
        count = 3 * len(MEASURED)
        noisy = self._traced(function, "x, t, tau, deviates", 1 + 2 * count * len(noises)).at

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            drawn = []
            for one in noises:
                number, stream = jnp.floor(t / one.period + 0.5), one.stream + member
                drawn.append(LIBRARY.normal_deviates(one.seed, stream, number, OF_SAMPLE, count))
                drawn.append(LIBRARY.normal_deviates(one.seed, stream, 0.0, OF_RUN, count))
            return noisy(jnp.concatenate([x, jnp.atleast_1d(tau), *drawn]), t)

        return flow
