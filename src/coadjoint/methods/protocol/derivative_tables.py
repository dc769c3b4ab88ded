"""Derivatives of whole runs, forward and backward: by tables of compiled loops, or step by step in Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.loop import CompiledLoop
from coadjoint.kernels.tables.cotangents import (
    BackwardRun,
    ForwardRun,
    flow_cotangents,
    runge_kutta_cotangents,
    with_step,
)
from coadjoint.kernels.tables.structures import unrecorded
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.step_derivatives import LinearizedStep
from coadjoint.program.added_part import Places, terms_of, with_added_part
from coadjoint.program.multiples import NO_MULTIPLES, Multiples, concatenated
from coadjoint.program.sources import Sources
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.parameter_differences import NearbySystems, differences, nearby_systems
from coadjoint.systems.parameters import Parameter, with_entry_moved
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

EXACT = "exact"
ADDED_PART = "added part"
DIFFERENCES = "differences"
COEFFICIENTS = ("base.terms.offset", "base.terms.weight", "base.terms.coefficient")

Kernel = str | Callable[[Any, Any, int, int], None]


class DerivativeTables(NamedTuple):
    """Tables of a scheme by step (and inputs), their kernels, and maps from coefficients to entries of parameters."""

    # `factors`: of Casimirs subtracted from H; `of_members`: those of a batch; `located`: differentiated fields.

    tables_at: Callable[..., Any]
    forward: Kernel
    backward: Kernel
    coefficient_count: int
    coefficients: Mapping[str, Multiples]
    factors: Mapping[str, Multiples]
    rules: Mapping[str, str]
    keepalive: tuple[Any, ...] = ()
    shift: tuple[Any, ...] = ()
    reversible: bool = False
    located: tuple[str, ...] = ()
    monomials: Mapping[str, tuple[Multiples, Multiples]] = {}
    of_members: NDArray[np.float64] | None = None
    sources: Callable[[], Sources] = unrecorded


def flow_derivatives(
    method: FlowMethod,
    system: LiePoissonSystem,
    h: float,
    representation: Any,
    energies: Mapping[str, EnergyDerivative],
) -> DerivativeTables:
    """Return the tables of flows and of their transposes."""
    # Parameters that are in no coefficient, as those of functions, are differentiated as an added part of size zero.
    program = method.program(system, group=representation)
    apart = {name: G.apart for name, G in energies.items()}
    places = Places(program)
    found = {name: places.of(G) for name, G in apart.items()}
    own = {name: (of_parts, of_shift) for name, (of_parts, of_shift, missing) in found.items() if not len(missing)}
    others, added = [name for name in found if name not in own], None
    in_added = [G if name in others else G.of_functions for name, G in apart.items()]
    monomials = {name: own.get(name, (NO_MULTIPLES, NO_MULTIPLES)) for name in found}
    if others or any(G.functions for G in in_added):
        added = with_added_part(program, method, system, representation, EnergyDerivative.joined(in_added))
        split = added.split({name: G.size for name, G in apart.items()})
        monomials = {
            name: (concatenated([split[name], added.renumbered(of_parts)]), of_shift)
            for name, (of_parts, of_shift) in monomials.items()
        }
    built = flow_cotangents(program, system, representation, h, method.compensates, added)
    terms = built.tables.base.terms

    def tables_at(step: float) -> Any:
        return built.tables if step == h else with_step(built.tables, step)

    return DerivativeTables(
        tables_at=tables_at,
        keepalive=built.keepalive,
        forward="flow_directions",
        backward="flow_cotangents",
        coefficient_count=len(terms.offset) + len(terms.weight) + len(terms.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, (one, _) in monomials.items()},
        factors={name: one.of_energy(energies[name]) for name, (_, one) in monomials.items()},
        rules={name: ADDED_PART if name in others else EXACT for name in energies},
        shift=program.shift,
        reversible=True,
        located=COEFFICIENTS,
        monomials=monomials,
        sources=lambda: built.sources().within("base."),
    )


def runge_kutta_derivatives(
    loop: CompiledLoop, system: System, energies: Mapping[str, EnergyDerivative]
) -> DerivativeTables:
    """Return the tables of stages and of their transposes; derivatives by parameters are those of the computed map."""
    apart = {name: energy.apart for name, energy in energies.items()}
    joined = EnergyDerivative.joined(list(apart.values()))
    added, coefficients = terms_of(joined, system.dim)
    of_monomials = coefficients.split({name: G.size for name, G in apart.items()})
    built = runge_kutta_cotangents(loop, system, added, joined.functions)
    return DerivativeTables(
        tables_at=lambda step: built.tables,
        keepalive=built.keepalive,
        forward="runge_kutta_directions",
        backward="runge_kutta_cotangents",
        coefficient_count=len(added.offset) + len(added.weight) + len(added.coefficient),
        coefficients={name: one.of_energy(energies[name]) for name, one in of_monomials.items()},
        factors=dict.fromkeys(energies, NO_MULTIPLES),
        rules=dict.fromkeys(energies, EXACT),
        monomials={name: (one, NO_MULTIPLES) for name, one in of_monomials.items()},
        sources=lambda: loop.sources().within("base."),
    )


def nearby_parameters(system: Any, parameters: Mapping[str, Parameter]) -> list[NearbySystems]:
    """Return the systems with moved entries of parameters, one parameter after the other."""
    return [
        nearby
        for name, parameter in parameters.items()
        for nearby in nearby_systems(name, parameter.value, partial(with_entry_moved, system, name, parameter))
    ]


class StepwiseDerivatives:
    """Derivatives of steps by the state (`Method.linearized`) and by parameters (central differences of order 8).

    `elements` computes the group element g of a step, A -> A g: elements (m, d, d) `at` states (m, n), and one
    `with_derivative` (n, d, d) by the state.
    """

    def __init__(
        self,
        method: Method,
        system: Any,
        nearby: Sequence[NearbySystems],
        elements: Any = None,
        method_of: Callable[[Any], Method] | None = None,
    ) -> None:
        self._method_of: Callable[[Any], Method] = (lambda _: method) if method_of is None else method_of
        self._method, self._system, self._nearby, self._elements = method, system, nearby, elements

    def step(self, x: Floats, t: float, h: float) -> LinearizedStep:
        """Return a step with its derivative by the state."""
        return self._method.linearized(self._system, x, t, h)

    def element(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the element (d, d) of a step, and its derivative (n, d, d) by the state; empty without an attitude."""
        if self._elements is None:
            return np.zeros((0, 0)), np.zeros((len(x), 0, 0))
        return self._elements.with_derivative(self._system, x, t, h)

    def by_parameters(self, x: Floats, t: float, h: float) -> tuple[Floats, Floats]:
        """Return the derivatives (entries, n) of a step and (entries, d, d) of its element by entries of parameters."""

        def after(system: Any) -> Floats:
            return np.asarray(self._method_of(system).step(system, x, t, h), dtype=np.float64)

        def turned(system: Any) -> Floats:
            return np.zeros((0, 0)) if self._elements is None else self._elements.at(system, x[None], t, h)[0]

        rows, of_element = differences(self._nearby, after), differences(self._nearby, turned)
        return np.array(rows).reshape(len(rows), len(x)), np.array(of_element)

    @np.errstate(over="ignore", invalid="ignore")
    def forward(self, run: ForwardRun, first: int, last: int) -> None:
        """Carry tangent vectors of members, as the compiled kernels do."""
        directed = bool(run.coefficients.any())
        for member in range(first, last):
            x, vectors, mark = run.momenta[member], run.tangents[member], 0
            group, of_group = matrix_of(run, member), run.group_tangents[member]
            for k in range(run.k0 + 1, run.k1 + 1):
                t = run.t0 + (k - 1) * run.h
                note_progress(f"the derivative of step {k} of {run.k1}")
                step, (g, by_state) = self.step(x, t, run.h), self.element(x, t, run.h)
                of_g = np.tensordot(vectors, by_state, axes=1)
                vectors = step.tangents(vectors)
                if directed:
                    by_entries, of_elements = self.by_parameters(x, t, run.h)
                    vectors = vectors + run.coefficients @ by_entries
                    of_g = of_g + np.tensordot(run.coefficients, of_elements, axes=1)
                # Elements are stored transposed.
                of_group, group = g.T @ of_group + np.swapaxes(of_g, 1, 2) @ group, g.T @ group
                x = step.end
                if mark < run.marked and run.marks[mark] == k:
                    run.at_points[mark, member], run.at_groups[mark, member] = vectors, of_group
                    mark += 1
            run.tangents[member], run.group_tangents[member] = vectors, of_group

    @np.errstate(over="ignore", invalid="ignore")
    def backward(self, run: BackwardRun, first: int, last: int) -> None:
        """Carry cotangents of members, as the compiled kernels do."""
        for member in range(first, last):
            x, group, states, groups = run.momenta[member], matrix_of(run, member), [], []
            steps: list[LinearizedStep] = []
            elements: list[tuple[Floats, Floats]] = []
            for k in range(run.k0 + 1, run.k1 + 1):
                note_progress(f"the derivative of step {k} of {run.k1}")
                t = run.t0 + (k - 1) * run.h
                states.append(x)
                groups.append(group)
                steps.append(self.step(x, t, run.h))
                elements.append(self.element(x, t, run.h))
                x, group = steps[-1].end, elements[-1][0].T @ group
            cotangent, mark = run.cotangents[member], run.marked
            of_group = run.group_cotangents[member]
            for k in range(run.k1, run.k0, -1):
                if mark > 0 and run.marks[mark - 1] == k:
                    mark -= 1
                    cotangent = cotangent + run.at_points[mark, member]
                    of_group = of_group + run.at_groups[mark, member]
                number = k - run.k0 - 1
                g, by_state = elements[number]
                of_g = groups[number] @ of_group.T
                if self._nearby:
                    by_entries, of_elements = self.by_parameters(states[number], run.t0 + (k - 1) * run.h, run.h)
                    run.coefficients[member] += by_entries @ cotangent + np.tensordot(of_elements, of_g, axes=2)
                cotangent = steps[number].cotangent(cotangent) + np.tensordot(by_state, of_g, axes=2)
                of_group = g @ of_group
            run.cotangents[member], run.group_cotangents[member] = cotangent, of_group


def matrix_of(run: ForwardRun | BackwardRun, member: int) -> Floats:
    """Return the element of a member before the steps, transposed as in the loops."""
    side = round(run.square**0.5)
    return np.asarray(run.groups[member]).reshape(side, side)


def stepwise_derivatives(steps_at: Callable[..., StepwiseDerivatives], sizes: Mapping[str, int]) -> DerivativeTables:
    """Return the derivatives of a scheme without compiled ones, in the form of these; `sizes` are of parameters."""
    coefficients, start = {}, 0
    for name, size in sizes.items():
        entries = np.arange(size)
        coefficients[name] = Multiples(start + entries, entries, np.ones(size))
        start += size
    return DerivativeTables(
        tables_at=lambda h, *values: steps_at(*values),
        forward=StepwiseDerivatives.forward,
        backward=StepwiseDerivatives.backward,
        coefficient_count=start,
        coefficients=coefficients,
        factors=dict.fromkeys(sizes, NO_MULTIPLES),
        rules=dict.fromkeys(sizes, DIFFERENCES),
    )
