"""Derivatives of runs by any scheme, step by step in Python, from the derivative of its step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.derivatives import DIFFERENCES, DerivativeTables
from coadjoint.methods.protocol.linearized import LinearizedStep, linearized
from coadjoint.methods.protocol.method import Method
from coadjoint.program.added_part import CoefficientMap
from coadjoint.systems.parameter_differences import NearbySystems, nearby_systems
from coadjoint.systems.parameters import Parameter, with_entry_moved

if TYPE_CHECKING:
    from coadjoint.kernels.tables.cotangents import BackwardRun, ForwardRun

Floats = NDArray[np.float64]


def nearby_parameters(system: Any, parameters: Mapping[str, Parameter]) -> list[NearbySystems]:
    """Return the systems with moved entries of parameters, one parameter after the other."""
    return [
        nearby
        for name, parameter in parameters.items()
        for nearby in nearby_systems(parameter.radii(), partial(with_entry_moved, system, name, parameter.value))
    ]


class StepwiseDerivatives:
    """The derivatives of the steps of a scheme by the state and by the entries of parameters.

    The former is that of `linearized`. The latter are central differences of order 8 of the step in Python, with
    about twelve digits.
    """

    def __init__(self, method: Method, system: Any, nearby: Sequence[NearbySystems]) -> None:
        self._method, self._system, self._nearby = method, system, nearby

    def step(self, x: Floats, t: float, h: float) -> LinearizedStep:
        """Return a step with its derivative by the state."""
        return linearized(self._method, self._system, x, t, h)

    def by_parameters(self, x: Floats, t: float, h: float) -> Floats:
        """Return the derivatives (entries, n) of a step by the entries of the parameters."""

        def after(system: Any) -> Floats:
            return np.asarray(self._method.step(system, x, t, h), dtype=np.float64)

        rows = [nearby.difference(after) for nearby in self._nearby]
        return np.array(rows).reshape(len(rows), len(x))

    @np.errstate(over="ignore", invalid="ignore")
    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        """Carry tangent vectors of members, as the compiled kernels do."""
        directed = bool(run.coefficients.any())
        for member in range(first, last):
            x, vectors, mark = run.momenta[member], run.tangents[member], 0
            for k in range(run.k0 + 1, run.k1 + 1):
                t = run.t0 + (k - 1) * run.h
                note_progress(f"the derivative of step {k} of {run.k1}")
                step = self.step(x, t, run.h)
                vectors = step.tangents(vectors)
                if directed:
                    vectors = vectors + run.coefficients @ self.by_parameters(x, t, run.h)
                x = step.end
                if mark < run.marked and run.marks[mark] == k:
                    run.at_points[mark, member] = vectors
                    mark += 1
            run.tangents[member] = vectors

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        """Carry cotangents of members, as the compiled kernels do."""
        for member in range(first, last):
            x, states = run.momenta[member], []
            steps: list[LinearizedStep] = []
            for k in range(run.k0 + 1, run.k1 + 1):
                note_progress(f"the derivative of step {k} of {run.k1}")
                states.append(x)
                steps.append(self.step(x, run.t0 + (k - 1) * run.h, run.h))
                x = steps[-1].end
            cotangent, mark = run.cotangents[member].copy(), run.marked
            for k in range(run.k1, run.k0, -1):
                if mark > 0 and run.marks[mark - 1] == k:
                    mark -= 1
                    cotangent = cotangent + run.at_points[mark, member]
                if self._nearby:
                    changes = self.by_parameters(states[k - run.k0 - 1], run.t0 + (k - 1) * run.h, run.h)
                    run.coefficients[member] += changes @ cotangent
                cotangent = steps[k - run.k0 - 1].cotangent(cotangent)
            run.cotangents[member] = cotangent


def stepwise_derivatives(steps_at: Callable[..., StepwiseDerivatives], sizes: Mapping[str, int]) -> DerivativeTables:
    """Return the derivatives of a scheme without compiled ones, in the form of these.

    `steps_at(*values)` are the steps, with inputs if there are any, and `sizes` the numbers of entries of the
    parameters, in their order.
    """
    coefficients, start = {}, 0
    for name, size in sizes.items():
        entries = np.arange(size)
        coefficients[name] = CoefficientMap(start + entries, entries, np.ones(size))
        start += size
    return DerivativeTables(
        tables_at=lambda h, *values: steps_at(*values),
        keepalive=(),
        forward=StepwiseDerivatives.forward,
        backward=StepwiseDerivatives.backward,
        coefficient_count=start,
        coefficients=coefficients,
        factors=dict.fromkeys(sizes, CoefficientMap.of_triplets(())),
        rules=dict.fromkeys(sizes, DIFFERENCES),
        shift=(),
        reversible=False,
    )
