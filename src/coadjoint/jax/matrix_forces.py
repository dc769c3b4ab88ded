"""Forces on matrices as operations of JAX: rates of modes, damping, and constant torques."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from coadjoint.jax.matrix_streams import harmonics_by_diagonal, scale_harmonics, scale_waves
from coadjoint.systems.forces.mode_force import Harmonics


class MatrixForceReader:
    """A reader of a force on matrices that makes its flow; `what` names it in messages."""

    functions = ()

    def __init__(self, system: Any, what: str) -> None:
        self.system, self.what = system, what

    def _state(self, x: Any) -> Any:
        """Return numbers of a state, (n,), as an array of its shape."""
        return self.system.from_vector(np.broadcast_to(x, self.system.dim))

    def damping(self, rate: Any, toward: Any) -> Any:
        """Return the flow of x' = -rate (x - toward), exact."""
        if np.ndim(rate):
            raise TypeError(
                f"JAX takes damping of matrices by one rate, not {self.what}; take Friction, or prepared.run"
            )
        target = self._state(toward)
        return lambda _, x, t, tau, member: x + jnp.expm1(-tau * rate) * (x - target)

    def constant(self, torque: Any) -> Any:
        """Return the flow of a constant torque, exact."""
        change = self._state(torque)
        return lambda _, x, t, tau, member: x + tau * change

    def mode_rates(self, modes: Any, numbers: Any, rates: Any, changes: Any, rest: Any, buoyancy: Any) -> Any:
        """Return the flow of c' = -rate c for modes by diagonal, exact."""
        if buoyancy is not None:
            raise TypeError(f"JAX takes no rates of modes of {self.system.name}, not {self.what}; take prepared.run")
        N, on_sphere = modes.N, modes.kind == Harmonics.kind
        table = np.zeros((N, N), dtype=np.result_type(*rates))
        for d, (of_diagonal, rate) in enumerate(zip(numbers, rates, strict=True)):
            if on_sphere:
                table[d, of_diagonal] = rate
                continue
            k = 2 * of_diagonal % N
            table[k, d] = rate
            if d:  # the conjugate modes
                table[-k % N, N - d] = np.conj(rate)
        vectors = harmonics_by_diagonal(N) if on_sphere else None
        still, layer = (
            None if rest is None else self._state(rest),
            changes[0].changed,
        )  # layered flows are refused before

        def flow(_: Any, x: Any, t: Any, tau: Any, member: Any) -> Any:
            moving = x if still is None else x - still
            factors = jnp.expm1(-tau * table)
            one = moving if moving.ndim == 2 else moving[layer]
            change = scale_waves(factors, one) if vectors is None else scale_harmonics(vectors, factors, one)
            return x + change if x.ndim == 2 else x.at[layer].add(change)

        return flow

    def __getattr__(self, form: str) -> Any:
        raise TypeError(
            f"JAX takes rates of modes, damping and constant torques on matrices, not {self.what}; take prepared.run"
        )
