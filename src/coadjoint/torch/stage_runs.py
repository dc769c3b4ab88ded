"""Runs of energies of PyTorch by implicit stages, or by flows of features, as operations of PyTorch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch.utils import _pytree

from coadjoint.memory import check_available_memory
from coadjoint.methods.force_flows import EnergyNumbers, Flow, ForceFlows, Function, apply_half, pair
from coadjoint.methods.forced import Forced, halves_of_step
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.coadjoint_exponential import common_square, exponential
from coadjoint.program.public_table import energy_and_parameters
from coadjoint.program.sweeps import JoinRules, stages_of
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.forces.base import SampleNoise
from coadjoint.systems.hamiltonians.parametrized_functions import (
    NAME,
    ParametrizedEnergy,
    features_of,
    function_of,
    function_with_params,
)
from coadjoint.systems.hamiltonians.terms import PolynomialTerm
from coadjoint.systems.registry import UNIT_TOLERANCE, unit_coordinate
from coadjoint.torch.autograd_functions import FixedPoint, MemberNumbers
from coadjoint.torch.library import LIBRARY, TorchFunction, double

CALLER = "co.torch.solution"
FLOW_STATES = 16  # numbers of the size of a state that a flow of a feature stores for reverse mode


class StageRun:
    """A prepared run over a time span as operations of PyTorch, for x0 and params."""

    def __init__(self, prepared: PreparedRun, t_span: Any, save_every: Any, t_eval: Any) -> None:
        system = prepared.system
        if system.is_batch or prepared.representation is not None or prepared.inputs is not None:
            raise TypeError(
                f"{CALLER} takes runs with params without batches, inputs and attitudes, not that of {system.name}; "
                "members are an axis of x0; co.jax.solution takes some of these"
            )
        self._prepared, self._function = prepared, function_with_params(system, TorchFunction, LIBRARY)
        forced = cast(Forced, prepared.scheme) if system.forces else None
        self._fractions = (1.0,) if forced is None else forced.fractions
        self._forced, system = system, system.unforced
        scheme = (prepared.method if forced is None else forced.inner).expanded
        self._run = ParametrizedRun(prepared, t_span, save_every, t_eval, CALLER, compiled=False)
        self._unit, self._guesses = unit_coordinate(system), 0
        features, factor = features_of(system, TorchFunction)
        if features is not None and isinstance(scheme, FlowMethod):
            if scheme.compensates:
                raise TypeError(f"{CALLER} has no compensated sums, as {prepared.method} wants; take compensated=False")
            rules = JoinRules(*np.zeros((2, len(features.params[0])), dtype=bool))
            self._inner, stages = self._flows_of_features, stages_of(scheme, rules, 1, float)
            # The first step, and the finish before output: a whole step.
            rows = np.r_[slice(*stages.section[:2].tolist()), slice(*stages.section[2:4].tolist())]
            lengths = factor * stages.coefficient[rows]
            self._angle, self._features = features.angle, list(zip(stages.part[rows].tolist(), lengths, strict=True))
            self._stored = len(rows) * FLOW_STATES
        elif isinstance(scheme, RungeKuttaMethod) and scheme.solver == "implicit":
            self._inner, tableau = self._stages, scheme.coefficients()
            # Made here, since functions of fixed points may not contain tensors that transformations of PyTorch wrap.
            numbers = (np.array(one, dtype=np.float64) for one in (tableau.scale, tableau.node, tableau.mix))
            self._tableau = [torch.from_numpy(one) for one in numbers]
            self._guesses = len(tableau.node)
            self._stored = self._guesses + 1
        else:
            raise TypeError(
                f"{CALLER} takes GaussLegendre for runs with params, and splittings for energies of co.torch.features, "
                f"not {prepared.method}"
            )
        polynomial = energy_and_parameters(system)["energy"]
        self._coefficients = LIBRARY.numbers(polynomial["coefficients"])
        self._field = TorchField(system, polynomial["monomials"])
        learned = [one for _, one, _ in self._field.terms]
        if not all(isinstance(one, ParametrizedEnergy) for one in learned):
            raise TypeError(
                f"{system.name} has functions that are not of PyTorch; write them into that given to co.torch.energy"
            )
        self._learned = next(iter(learned), None)
        order = 0 if forced is None else forced.order
        self._flows = [
            pair(
                force.describe_to(TorchForceFlows(LIBRARY, system, self._field, self._forced.labels[k], order), system)
            )
            for k, force in self._forced.flows
        ]
        self._stored += 2 * FLOW_STATES * len(self._flows)

    def __call__(self, x0: Any, attitude0: Any, parameters: Mapping[str, Any]) -> Any:
        """Return the states (points, n) or (points, members, n)."""
        rest = dict(parameters)
        params = self._function.checked(rest.pop(NAME, self._function.params))
        if rest:
            raise ValueError(
                f"{next(iter(rest))} of {self._prepared.system.name} has the value of the prepared run beside energies "
                "with params; prepare a run of a system with another one"
            )
        x0 = double("x0", x0)
        self._run.check({name: tuple(one.shape) for name, one in self._run.arguments(x0, attitude0, {}).items()})
        stored = 8 * self._run.times.steps * x0.numel() * self._stored * len(self._fractions)
        check_available_memory(stored, f"the stages of all steps, with {CALLER},")
        known = _known_numbers(x0, *_pytree.tree_leaves(params))
        if known is not None:
            self._prepared.start(known[0])
            self._check_differentiable(known[0], params)
        if self._unit is not None:
            near = (x0[..., self._unit] - 1.0).abs() <= UNIT_TOLERANCE
            x0 = torch.where(near[..., None], x0, torch.nan)
        leaves, structure = _pytree.tree_flatten(EnergyNumbers(self._coefficients, params))

        def trajectory(x0: Any, member: Any, *leaves: Any) -> Any:
            return self._trajectory(x0, member, leaves, structure)

        members = MemberNumbers.apply(x0, *leaves) if self._forced.has_noise else torch.zeros(x0.shape[:-1])
        if x0.ndim == 1:
            found = trajectory(x0, members, *leaves)
        else:
            found = torch.func.vmap(trajectory, (0, 0, *[None] * len(leaves)), 1)(x0, members, *leaves)
        if known is not None and self._run.is_checked and self._is_compiled(params):
            self._run.check_first_step({"x0": known[0]})
        states = _known_numbers(found)
        self._run.warn_of_nan(None if states is None else states[0])
        return found

    def _is_compiled(self, params: Any) -> bool:
        """Return whether compiled loops have the run at these params: if they are those of the system."""
        own = LIBRARY.are_same(self._function.params, _pytree.tree_map(lambda one: one.detach(), params))
        return own and self._inner != self._flows_of_features

    def _check_differentiable(self, start: Any, params: Any) -> None:
        """Raise ValueError if the energy has no first or second derivatives at an initial state."""
        if self._learned is None:
            return
        time, numbers = LIBRARY.numbers(self._run.times.t0), EnergyNumbers(self._coefficients, params)

        def at(x: Any) -> Any:
            along = torch.cos(torch.arange(1.0, len(x) + 1.0, dtype=torch.float64))
            slopes, pullback = torch.func.vjp(torch.func.grad(lambda x: self._field.energy(numbers, x, time, False)), x)
            return slopes, pullback(along)[0]

        with torch.no_grad():
            rows = torch.from_numpy(start.reshape(-1, start.shape[-1]))
            derivatives = [one.numpy() for one in torch.func.vmap(at)(rows)]
        self._learned.check_differentiable(start, derivatives)

    def _trajectory(self, x0: Any, member: Any, leaves: Any, structure: Any) -> Any:
        times, moments = self._run.times, self._run.moments
        marks = times.saved if moments is None else moments.number
        lengths = np.zeros(len(marks)) if moments is None else moments.length
        outputs = {int(k): np.flatnonzero(marks == k) for k in marks}
        x, saved, starts = x0, dict[int, Any](), times.at(np.arange(times.steps + 1))
        guess, given = x0.new_zeros(self._guesses, x0.shape[-1]), (member, leaves, structure)
        for k in range(int(marks[-1]) + 1):
            t = float(starts[k])
            for point in outputs.get(k, ()):
                saved[int(point)] = self._step(x, t, float(lengths[point]), *given, 0.0 * guess)[0]
            if k < marks[-1]:
                x, guess = self._step(x, t, float(times.h), *given, guess)
        return torch.stack([saved[point] for point in range(len(marks))])

    def _step(
        self, x: Any, t: float, h: float, member: Any, leaves: Any, structure: Any, guess: Any
    ) -> tuple[Any, Any]:
        """Return the state after a step of any length, between half flows of forces, and changes of its stages."""
        if h == 0.0:
            return x, guess
        numbers, alone = _pytree.tree_unflatten(leaves, structure), len(self._fractions) == 1
        for begin, length, halves in halves_of_step(self._forced.flows, self._fractions, t, h):
            x = apply_half(self._flows, halves[0], 0, numbers, x, member)
            x, guess = self._inner(x, begin, length, leaves, structure, guess if alone else 0.0 * guess)
            x = apply_half(self._flows, halves[1], 1, numbers, x, member)
        return x, guess

    def _flows_of_features(
        self, x: Any, t: float, h: float, leaves: Any, structure: Any, guess: Any
    ) -> tuple[Any, Any]:
        """Return the state after a step by flows of features, x -> exp(tau f'(<a, x>) D_a) x with D_a x = J(x) a."""
        directions, params = _pytree.tree_unflatten(leaves, structure).params
        for feature, length in self._features:
            own = _pytree.tree_map(lambda one, feature=feature: one[feature], params)
            a = directions[feature]
            x = self._field.exponential(float(length) * h * self._angle(a @ x, own) * a, x)
        return x, guess

    def _stages(self, x: Any, t: float, h: float, leaves: Any, structure: Any, guess: Any) -> tuple[Any, Any]:
        """Return the state after a step of any length, and the changes of its stages, from a guess of these."""
        scale, node, mix = self._tableau

        def prepare(x: Any, *leaves: Any) -> Any:
            numbers = _pytree.tree_unflatten(leaves, structure)
            fields = torch.func.vmap(lambda x, t: self._field.at(numbers, x, t))
            return lambda changes: (h * scale)[:, None] * fields(x + mix @ changes, t + h * node)

        changes = FixedPoint.apply(prepare, guess.detach(), x.detach().abs().expand(guess.shape), x, *leaves)
        return x + changes.sum(0), changes


class TorchField:
    """The field of a Hamiltonian of monomials and functions of PyTorch, whose numbers are arguments of the methods."""

    def __init__(self, system: Any, monomials: Any) -> None:
        keys = [tuple(key) for key in monomials]
        degree = max(map(len, keys), default=0)
        self._monomials = torch.tensor([[*key, *[system.dim] * (degree - len(key))] for key in keys])
        terms = [term for term in system.hamiltonian.terms() if term.form is None]
        self.terms = [
            (term, *function_of(term, TorchFunction)) for term in terms if not isinstance(term, PolynomialTerm)
        ]
        i, j, k, c = (torch.from_numpy(np.array(one)) for one in system.algebra.triples)
        self._products = torch.cat([i, j]), torch.cat([j, i]), torch.cat([k, k]), system.sign * torch.cat([c, -c])
        square = common_square(system.algebra)
        self._square = None if square is None else (torch.from_numpy(square[0]), square[1])

    def energy(self, numbers: EnergyNumbers, x: Any, t: Any, whole: bool = True) -> Any:
        """Return H(x, t), or the part of functions of PyTorch alone."""
        total = x.new_zeros(())
        if whole and len(self._monomials):
            padded = torch.cat([x, x.new_ones(1)])
            factors = (padded[one] for one in self._monomials.T)  # torch.prod has no second derivatives in vmap
            total = total + numbers.coefficients @ math.prod(factors)
        for term, function, factor in self.terms:
            y = x[int(term.coordinates[0])] if term.scalar else x[torch.from_numpy(np.array(term.coordinates))]
            total = total + factor * function.at(numbers.params, y, *((LIBRARY.numbers(t),) if term.timed else ()))
        return total

    def slopes(self, numbers: EnergyNumbers, x: Any, t: Any) -> Any:
        """Return grad H(x, t)."""
        return torch.func.grad(lambda x: self.energy(numbers, x, t))(x)

    def at(self, numbers: EnergyNumbers, x: Any, t: Any) -> Any:
        """Return sign J(x) grad H(x, t)."""
        return self.product(x, self.slopes(numbers, x, t))

    def product(self, x: Any, u: Any) -> Any:
        """Return sign J(x) u."""
        row, column, k, c = self._products
        return torch.zeros_like(x).index_add(0, row, c * x[k] * u[column])

    def exponential(self, v: Any, x: Any) -> Any:
        """Return exp(D_v) x with D_v x = sign J(x) v."""
        if self._square is not None:
            return exponential(torch, torch.func.grad, self.product, self._square, v, x)
        (row, column, k, c), n = self._products, x.shape[-1]
        entries = torch.zeros_like(x).repeat(n).index_add(0, row * n + k, c * v[column])
        return torch.linalg.matrix_exp(entries.reshape(n, n)) @ x


class TorchForceFlows(ForceFlows):
    """A reader of a force that makes its flow of PyTorch, which takes no functions of the state that are of NumPy."""

    def traced(self, function: Any, arguments: str) -> Function:
        if arguments == "t":
            return lambda x, t, params: LIBRARY.numbers(function(t))
        raise self._not_of_torch()

    def traced_flow(self, function: Any, noises: Sequence[SampleNoise]) -> Flow:
        raise self._not_of_torch()

    def _not_of_torch(self) -> TypeError:
        return TypeError(
            f"{CALLER} beside params takes forces in closed form and those of co.torch, and {self.what} has a function "
            "of NumPy; write it as co.torch.torque(function, params), or take co.jax.solution"
        )


def _known_numbers(*tensors: Any) -> list[Any] | None:
    """Return the numbers of tensors; None inside of `vmap` and other transformations."""
    try:
        return [np.array(one.detach().numpy()) for one in tensors]
    except RuntimeError:
        return None
