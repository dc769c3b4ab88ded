"""Derivatives of runs by any scheme, step by step in Python, from the derivative of its step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.derivatives import DIFFERENCES, DerivativeTables
from coadjoint.methods.protocol.method import Method
from coadjoint.program.added_part import CoefficientMap
from coadjoint.systems.parameters import Parameter, with_entry_moved

if TYPE_CHECKING:
    from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun

Floats = NDArray[np.float64]

# Nodes and weights of the derivative at zero by interpolation; relative distance of the nodes in a parameter. A step is
# an analytic function of its parameters, and changes by the step times their change.
NODES = np.array([1.0, 2.0, 3.0, 4.0])
WEIGHTS = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])
DISTANCE = 2.0**-7


class StepwiseDerivatives:
    """The derivatives of the steps of a scheme by the state and by the entries of parameters.

    The former is that of `Method.tangent`. The latter are central differences of order 8 of the step in Python, with
    about twelve digits.
    """

    def __init__(self, method: Method, system: Any, parameters: Mapping[str, Parameter]) -> None:
        self._method, self._system = method, system
        self._changed: list[tuple[float, list[tuple[Any, Any]]]] = []
        for name, parameter in parameters.items():
            value = parameter.value
            for index in np.ndindex(value.shape):
                distance = DISTANCE * (abs(float(value[index])) or float(np.max(np.abs(value))) or 1.0)
                pairs = []
                for node in NODES.tolist():
                    plus, minus = (
                        with_entry_moved(system, name, value, index, sign * node * distance) for sign in (1.0, -1.0)
                    )
                    pairs.append((plus, minus))
                self._changed.append((distance, pairs))

    def step(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the state after a step and its derivative by the state."""
        return self._method.tangent(self._system, x, t, h)

    def by_parameters(self, x: Floats, t: float, h: float) -> Floats:
        """Return the derivatives (n, entries) of a step by the entries of the parameters."""
        columns = [
            sum(
                weight * (self._after(plus, x, t, h) - self._after(minus, x, t, h))
                for weight, (plus, minus) in zip(WEIGHTS, pairs, strict=True)
            )
            / distance
            for distance, pairs in self._changed
        ]
        return np.array(columns).reshape(len(columns), len(x)).T

    def _after(self, system: Any, x: Floats, t: float, h: float) -> Floats:
        return np.asarray(self._method.step(system, x, t, h), dtype=np.float64)

    def forward(self, run: ForwardRun) -> None:
        """Carry tangent vectors, as the compiled kernels do."""
        directed = bool(run.coefficients.any())
        for member in range(run.members):
            x, vectors, mark = run.momenta[member], run.tangents[member].T, 0
            for k in range(run.k0 + 1, run.k1 + 1):
                t = run.t0 + (k - 1) * run.h
                note_progress(f"the derivative of step {k} of {run.k1}")
                after, derivative = self.step(x, t, run.h)
                vectors = derivative @ vectors
                if directed:
                    vectors = vectors + self.by_parameters(x, t, run.h) @ run.coefficients.T
                x = after
                if mark < run.marked and run.marks[mark] == k:
                    run.at_points[mark, member] = vectors.T
                    mark += 1
            run.tangents[member] = vectors.T

    def backward(self, run: BackwardRun) -> None:
        """Carry cotangents, as the compiled kernels do."""
        for member in range(run.members):
            x, states, derivatives = run.momenta[member], [], []
            for k in range(run.k0 + 1, run.k1 + 1):
                note_progress(f"the derivative of step {k} of {run.k1}")
                states.append(x)
                x, derivative = self.step(x, run.t0 + (k - 1) * run.h, run.h)
                derivatives.append(derivative)
            cotangent, mark = run.cotangents[member].copy(), run.marked
            for k in range(run.k1, run.k0, -1):
                if mark > 0 and run.marks[mark - 1] == k:
                    mark -= 1
                    cotangent = cotangent + run.at_points[mark, member]
                state, derivative = states[k - run.k0 - 1], derivatives[k - run.k0 - 1]
                if self._changed:
                    changes = self.by_parameters(state, run.t0 + (k - 1) * run.h, run.h)
                    run.coefficients[member] += cotangent @ changes
                cotangent = cotangent @ derivative
            run.cotangents[member] = cotangent


def stepwise_derivatives(method: Method, system: Any, parameters: Mapping[str, Parameter]) -> DerivativeTables:
    """Return the derivatives of a scheme without compiled ones, in the form of these."""
    steps = StepwiseDerivatives(method, system, parameters)
    coefficients, start = {}, 0
    for name, parameter in parameters.items():
        entries = np.arange(parameter.value.size)
        coefficients[name] = CoefficientMap(start + entries, entries, np.ones(len(entries)))
        start += len(entries)
    return DerivativeTables(
        tables_at=lambda h: None,
        keepalive=(),
        forward=steps.forward,
        backward=steps.backward,
        coefficient_count=start,
        coefficients=coefficients,
        factors=dict.fromkeys(parameters, CoefficientMap.of_triplets(())),
        rules=dict.fromkeys(parameters, DIFFERENCES),
        shift=(),
        reversible=False,
    )
