"""Flows of features f(<a, x>): x moves by the group element exp(tau f'(<a, x>) a), exact on every algebra."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import lax

from coadjoint.jax.stage_steps import CoadjointAction, Steps
from coadjoint.methods.force_flows import EnergyNumbers
from coadjoint.program.sweeps import JoinRules, stages_of
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedFeatures


def feature_flow(bracket: CoadjointAction, energy: ParametrizedFeatures) -> Callable[[Any, Any, Any], Any]:
    """Return the flow of one feature, of its direction and parameters, the state, and the time tau."""

    def flow(feature: Any, x: Any, tau: Any) -> Any:
        direction, own = feature
        return bracket.exponential(tau * energy.angle(direction @ x, own) * direction, x)

    return jax.checkpoint(flow, prevent_cse=False)


def feature_steps(bracket: CoadjointAction, scheme: Any, energy: ParametrizedFeatures, factor: float) -> Steps:
    """Return the steps of a splitting of a multiple of an energy, each part of which is a feature."""
    flow, count = feature_flow(bracket, energy), len(energy.params[0])
    stages = stages_of(scheme, JoinRules(*np.zeros((2, count), dtype=bool)), 1, float)
    first, steps, finish = (np.arange(*stages.section[k : k + 2].tolist()) for k in range(3))

    def flows(numbers: EnergyNumbers, rows: Any, x: Any, h: Any) -> Any:
        def stage(x: Any, row: Any) -> Any:
            part, coefficient = row
            return flow(jax.tree.map(lambda one: one[part], numbers.params), x, coefficient * h), None

        columns = stages.part[rows].astype(np.int64), factor * stages.coefficient[rows]
        return lax.scan(stage, x, columns)[0]

    def begin(numbers: Any, start: Any, t: Any, h: Any) -> Any:
        # Undoes the finish, so that all steps have the same flows.
        return flows(numbers, finish[::-1], start[0], -h), None

    def step(numbers: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        return flows(numbers, steps, state[0], h), None

    def finished(numbers: Any, state: Any, t: Any, h: Any, start: Any, elapsed: Any) -> Any:
        return flows(numbers, finish, state[0], h), None

    def whole(numbers: Any, start: Any, t: Any, h: Any, member: Any) -> Any:
        return finished(numbers, (flows(numbers, first, start[0], h), None), t, h, start, h)

    def undo(numbers: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        return flows(numbers, steps[::-1], state[0], -h), None

    return Steps(lambda numbers: numbers, step, whole, begin, finished, undo=undo)
