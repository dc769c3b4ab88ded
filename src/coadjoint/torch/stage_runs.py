"""Runs of energies of PyTorch by implicit stages, or by flows of features, as operations of PyTorch."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch.utils import _pytree

from coadjoint.memory import check_available_memory
from coadjoint.methods.numerics.solvers import (
    LARGEST_CORRECTION,
    LARGEST_ROUNDOFF,
    LARGEST_SAMPLED,
    MOST_ITERATIONS,
    SAMPLED,
    SAMPLES,
    STALLED,
)
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.runge_kutta import RungeKuttaMethod
from coadjoint.program.coadjoint_exponential import common_square, exponential
from coadjoint.program.public_table import energy_and_parameters
from coadjoint.program.sweeps import JoinRules, stages_of
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.hamiltonians.parametrized_functions import (
    NAME,
    ParametrizedEnergy,
    features_of,
    function_of,
    function_with_params,
)
from coadjoint.systems.hamiltonians.terms import PolynomialTerm
from coadjoint.systems.registry import UNIT_TOLERANCE, unit_coordinate
from coadjoint.torch.energies import TorchFunction, double

CALLER = "co.torch.solution"
FLOW_STATES = 16  # numbers of the size of a state that a flow of a feature stores for reverse mode


class FixedPoint(torch.autograd.Function):  # type: ignore[misc]
    """The solution z of z = prepare(*arguments)(z) by iterations, differentiated as this equation to every order."""

    # Arguments: `prepare`, the first guess, sizes whose round-off entries of z have too, and tensors.

    @staticmethod
    def forward(prepare: Any, first: Any, size: Any, *arguments: Any) -> Any:
        return _iterated(prepare(*arguments), first, size)

    @staticmethod
    def setup_context(context: Any, inputs: Any, output: Any) -> None:
        context.prepare = inputs[0]
        context.save_for_backward(output, *inputs[3:])
        context.save_for_forward(output, *inputs[3:])

    @staticmethod
    def backward(context: Any, of_z: Any) -> Any:
        (z, *arguments), prepare = context.saved_tensors, context.prepare

        def transposed(of_z: Any, z: Any, *arguments: Any) -> Any:
            pullback = torch.func.vjp(prepare(*arguments), z)[1]
            return lambda w: of_z + pullback(w)[0]

        w = FixedPoint.apply(transposed, of_z, _largest(of_z), of_z, z, *arguments)
        return None, None, None, *torch.func.vjp(lambda *own: prepare(*own)(z), *arguments)[1](w)

    @staticmethod
    def jvp(context: Any, *tangents: Any) -> Any:
        (z, *arguments), prepare = context.saved_tensors, context.prepare
        along = [torch.zeros_like(a) if one is None else one for a, one in zip(arguments, tangents[3:], strict=True)]

        def linear(known: Any, z: Any, *arguments: Any) -> Any:
            change = _derivative(prepare(*arguments), z)
            return lambda dz: known + change(dz)

        known = _derivative(lambda *own: prepare(*own)(z), *arguments)(*along)
        return FixedPoint.apply(linear, known, _largest(known), known, z, *arguments)

    @staticmethod
    def vmap(info: Any, in_dims: Any, prepare: Any, *tensors: Any) -> Any:
        dims = in_dims[1:]
        moved = [one if d is None else one.movedim(d, 0) for one, d in zip(tensors, dims, strict=True)]
        first, size = (
            one.expand(info.batch_size, *one.shape) if d is None else one
            for one, d in zip(moved[:2], dims[:2], strict=True)
        )
        own_dims = 0, *(None if d is None else 0 for d in dims[2:])

        def batched(*arguments: Any) -> Any:
            each = torch.func.vmap(lambda z, *own: prepare(*own)(z), own_dims)
            return lambda z: each(z, *arguments)

        return FixedPoint.apply(batched, first, size, *moved[2:]), 0


def _derivative(function: Callable[..., Any], *at: Any) -> Callable[..., Any]:
    """Return the derivative along directions: that of the transposed one, which is linear, along its cotangent."""
    value, pullback = torch.func.vjp(function, *at)
    twice = torch.func.vjp(pullback, torch.zeros_like(value))[1]
    return lambda *along: twice(tuple(along))[0]


def _largest(values: Any) -> Any:
    """Return the largest size of an entry of a solution, which has two axes, beside those of members."""
    return values.detach().abs().amax((-2, -1), keepdim=True)


def _iterated(function: Callable[[Any], Any], z: Any, size: Any) -> Any:
    """Return the limit of iterations, NaN of members without one."""
    least, stalled = torch.inf, 0
    for _ in range(MOST_ITERATIONS):
        found = function(z)
        change, reach = (found - z).abs(), found.abs() + size
        z, correction = found, float(torch.where(change > 0.0, change / reach, 0.0).amax())
        stalled, least = 0 if correction < least else stalled + 1, min(least, correction)
        patience = STALLED if correction <= LARGEST_ROUNDOFF else MOST_ITERATIONS
        patience = 1 if correction <= LARGEST_CORRECTION else patience
        if not (stalled < patience and correction > 2.0 * UNIT_ROUNDOFF):
            break
    change, extent, own = _largest(change), _largest(z), _largest(size.expand(z.shape))
    allowed = LARGEST_CORRECTION * extent + 16.0 * UNIT_ROUNDOFF * own
    # Where terms of the function cancel, its round-off is larger: the distance of its values at disturbed points.
    entries = torch.arange(1.0, z.numel() + 1.0, dtype=z.dtype).reshape(z.shape)
    for sample in range(1, SAMPLES + 1):
        if not bool(((change > allowed) & (change <= LARGEST_SAMPLED * (extent + own))).any()):
            break
        roundings = UNIT_ROUNDOFF * torch.round(8.0 * torch.cos(sample * entries)) * (z.abs() + size)
        found = function(z)
        distance = _largest(function(z + roundings) - found)
        change, allowed = torch.minimum(change, _largest(found - z)), torch.maximum(allowed, SAMPLED * distance)
        z = found
    return torch.where(change <= allowed, z, torch.nan)


class StageRun:
    """A prepared run over a time span as operations of PyTorch, for x0 and params."""

    def __init__(self, prepared: PreparedRun, t_span: Any, save_every: Any, t_eval: Any) -> None:
        system, scheme = prepared.system, prepared.method.expanded
        if system.is_batch or system.forces or prepared.representation is not None or prepared.inputs is not None:
            raise TypeError(
                f"{CALLER} takes runs of energies with params without forces, batches, inputs and attitudes, not "
                f"that of {system.name}; members are an axis of x0; co.jax.solution takes some of these"
            )
        self._prepared, self._function = prepared, function_with_params(system, TorchFunction)
        self._run = ParametrizedRun(prepared, t_span, save_every, t_eval, CALLER, compiled=False)
        self._unit, self._guesses = unit_coordinate(system), 0
        features, factor = features_of(system, TorchFunction)
        if features is not None and isinstance(scheme, FlowMethod):
            if scheme.compensates:
                raise TypeError(f"{CALLER} has no compensated sums, as {prepared.method} wants; take compensated=False")
            rules = JoinRules(*np.zeros((2, len(features.params[0])), dtype=bool))
            self._step, stages = self._flows_of_features, stages_of(scheme, rules, 1, float)
            # The first step, and the finish before output: a whole step.
            rows = np.r_[slice(*stages.section[:2].tolist()), slice(*stages.section[2:4].tolist())]
            lengths = factor * stages.coefficient[rows]
            self._angle, self._flows = features.angle, list(zip(stages.part[rows].tolist(), lengths, strict=True))
            square = common_square(system.algebra)
            self._square = None if square is None else (torch.from_numpy(square[0]), square[1])
            self._stored = len(rows) * FLOW_STATES
        elif isinstance(scheme, RungeKuttaMethod) and scheme.solver == "implicit":
            self._step, tableau = self._stages, scheme.coefficients()
            # Made here, since functions of fixed points may not contain tensors that transformations of PyTorch wrap.
            numbers = (np.array(one, dtype=np.float64) for one in (tableau.scale, tableau.node, tableau.mix))
            self._tableau = [torch.from_numpy(one) for one in numbers]
            self._guesses = len(tableau.node)
            self._stored = self._guesses + 1
        else:
            raise TypeError(
                f"{CALLER} takes GaussLegendre for energies with params, and splittings for those of "
                f"co.torch.features, not {prepared.method}"
            )
        polynomial = energy_and_parameters(system)["energy"]
        monomials = [tuple(key) for key in polynomial["monomials"]]
        degree = max(map(len, monomials), default=0)
        self._monomials = torch.tensor([[*key, *[system.dim] * (degree - len(key))] for key in monomials])
        self._coefficients = torch.tensor(np.array(polynomial["coefficients"], dtype=np.float64))
        terms = [term for term in system.hamiltonian.terms() if term.form is None]
        self._terms = [
            (term, *function_of(term, TorchFunction)) for term in terms if not isinstance(term, PolynomialTerm)
        ]
        if any(not isinstance(function, ParametrizedEnergy) for _, function, _ in self._terms):
            raise TypeError(
                f"{system.name} has functions that are not of PyTorch; write them into that given to co.torch.energy"
            )
        i, j, k, c = (torch.from_numpy(np.array(one)) for one in system.algebra.triples)
        self._products = torch.cat([i, j]), torch.cat([j, i]), torch.cat([k, k]), system.sign * torch.cat([c, -c])

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
        stored = 8 * self._run.times.steps * x0.numel() * self._stored
        check_available_memory(stored, f"the stages of all steps, with {CALLER},")
        known = _known_numbers(x0, *_pytree.tree_leaves(params))
        if known is not None:
            self._prepared.start(known[0])
            self._check_differentiable(known[0], params)
        if self._unit is not None:
            near = (x0[..., self._unit] - 1.0).abs() <= UNIT_TOLERANCE
            x0 = torch.where(near[..., None], x0, torch.nan)
        leaves, structure = _pytree.tree_flatten(params)

        def trajectory(x0: Any, *leaves: Any) -> Any:
            return self._trajectory(x0, leaves, structure)

        if x0.ndim == 1:
            found = trajectory(x0, *leaves)
        else:
            found = torch.func.vmap(trajectory, (0, *[None] * len(leaves)), 1)(x0, *leaves)
        if known is not None and NAME not in parameters:
            self._run.check_first_step({"x0": known[0]})
        return found

    def _check_differentiable(self, start: Any, params: Any) -> None:
        """Raise ValueError if the energy has no first or second derivatives at an initial state."""
        time = torch.tensor(self._run.times.t0, dtype=torch.float64)

        def at(x: Any) -> Any:
            along = torch.cos(torch.arange(1.0, len(x) + 1.0, dtype=torch.float64))
            slopes, pullback = torch.func.vjp(torch.func.grad(lambda x: self._energy(x, time, params, False)), x)
            return slopes, pullback(along)[0]

        with torch.no_grad():
            rows = torch.from_numpy(start.reshape(-1, start.shape[-1]))
            derivatives = [one.numpy() for one in torch.func.vmap(at)(rows)]
        self._function.check_differentiable(start, derivatives)

    def _energy(self, x: Any, t: Any, params: Any, whole: bool = True) -> Any:
        """Return H(x, t), or the part of functions of PyTorch alone."""
        total = x.new_zeros(())
        if whole and len(self._monomials):
            padded = torch.cat([x, x.new_ones(1)])
            factors = (padded[one] for one in self._monomials.T)  # torch.prod has no second derivatives in vmap
            total = total + self._coefficients @ math.prod(factors)
        for term, function, factor in self._terms:
            y = x[int(term.coordinates[0])] if term.scalar else x[torch.from_numpy(np.array(term.coordinates))]
            total = total + factor * function.at(params, y, *((t,) if term.timed else ()))
        return total

    def _field(self, x: Any, t: Any, params: Any) -> Any:
        """Return sign J(x) grad H(x, t)."""
        return self._product(x, torch.func.grad(self._energy)(x, t, params))

    def _product(self, x: Any, u: Any) -> Any:
        """Return sign J(x) u."""
        row, column, k, c = self._products
        return torch.zeros_like(x).index_add(0, row, c * x[k] * u[column])

    def _exponential(self, v: Any, x: Any) -> Any:
        """Return exp(D_v) x with D_v x = sign J(x) v."""
        if self._square is not None:
            return exponential(torch, torch.func.grad, self._product, self._square, v, x)
        (row, column, k, c), n = self._products, x.shape[-1]
        entries = torch.zeros_like(x).repeat(n).index_add(0, row * n + k, c * v[column])
        return torch.linalg.matrix_exp(entries.reshape(n, n)) @ x

    def _trajectory(self, x0: Any, leaves: Any, structure: Any) -> Any:
        times, moments = self._run.times, self._run.moments
        marks = times.saved if moments is None else moments.number
        lengths = np.zeros(len(marks)) if moments is None else moments.length
        outputs = {int(k): np.flatnonzero(marks == k) for k in marks}
        x, saved, starts = x0, dict[int, Any](), times.at(np.arange(times.steps + 1))
        guess = x0.new_zeros(self._guesses, x0.shape[-1])
        for k in range(int(marks[-1]) + 1):
            t = float(starts[k])
            for point in outputs.get(k, ()):
                saved[int(point)] = self._step(x, t, float(lengths[point]), leaves, structure, 0.0 * guess)[0]
            if k < marks[-1]:
                x, guess = self._step(x, t, times.h, leaves, structure, guess)
        return torch.stack([saved[point] for point in range(len(marks))])

    def _flows_of_features(
        self, x: Any, t: float, h: float, leaves: Any, structure: Any, guess: Any
    ) -> tuple[Any, Any]:
        """Return the state after a step by flows of features, x -> exp(tau f'(<a, x>) D_a) x with D_a x = J(x) a."""
        directions, params = _pytree.tree_unflatten(leaves, structure)
        for feature, length in self._flows:
            own = _pytree.tree_map(lambda one, feature=feature: one[feature], params)
            a = directions[feature]
            x = self._exponential(float(length) * h * self._angle(a @ x, own) * a, x)
        return x, guess

    def _stages(self, x: Any, t: float, h: float, leaves: Any, structure: Any, guess: Any) -> tuple[Any, Any]:
        """Return the state after a step of any length, and the changes of its stages, from a guess of these."""
        if h == 0.0:
            return x, guess
        scale, node, mix = self._tableau

        def prepare(x: Any, *leaves: Any) -> Any:
            params = _pytree.tree_unflatten(leaves, structure)
            fields = torch.func.vmap(lambda x, t: self._field(x, t, params))
            return lambda changes: (h * scale)[:, None] * fields(x + mix @ changes, t + h * node)

        changes = FixedPoint.apply(prepare, guess.detach(), x.detach().abs().expand(guess.shape), x, *leaves)
        return x + changes.sum(0), changes


def _known_numbers(*tensors: Any) -> list[Any] | None:
    """Return the numbers of tensors; None inside of `vmap` and other transformations."""
    try:
        return [np.array(one.detach().numpy()) for one in tensors]
    except RuntimeError:
        return None
