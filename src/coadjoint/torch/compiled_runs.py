"""Runs of compiled loops as functions of PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.torch.autograd_functions import OnHost, in_turn
from coadjoint.torch.library import double


def solve(run: ParametrizedRun, x0: Any, attitude0: Any, parameters: Mapping[str, Any]) -> Any:
    """Return the states of a run, and the attitudes if it has them, as functions of tensors."""
    values = {name: double(name, value) for name, value in run.arguments(x0, attitude0, parameters).items()}
    run.check({name: tuple(value.shape) for name, value in values.items()})
    if "attitude0" in values:
        d = values["attitude0"].shape[-1]
        values["attitude0"] = values["attitude0"].expand(*values["x0"].shape[:-1], d, d)
    for_gradient = torch.is_grad_enabled() and any(value.requires_grad for value in values.values())
    outputs = RunFunction.apply(run, tuple(values), for_gradient, *values.values())
    return outputs if len(outputs) > 1 else outputs[0]


class RunFunction(torch.autograd.Function):  # type: ignore[misc]
    """A run of values by their names, of which derivatives are those of compiled loops."""

    @staticmethod
    def forward(run: Any, names: Any, for_gradient: bool, *values: Any) -> Any:
        def compute(*arrays: Any) -> Any:
            return run.solve(dict(zip(names, arrays, strict=True)), for_gradient)

        return OnHost.apply(compute, *values)

    @staticmethod
    def setup_context(context: Any, inputs: Any, output: Any) -> None:
        context.run, context.names, _, *values = inputs
        context.save_for_backward(*values)
        context.save_for_forward(*values)

    @staticmethod
    def backward(context: Any, *cotangents: Any) -> Any:
        names, needed = context.names, context.needs_input_grad[3:]
        by = [name for name, is_needed in zip(names, needed, strict=True) if is_needed]

        def compute(*arrays: Any) -> Any:
            values, given = dict(zip(names, arrays[: len(names)], strict=True)), arrays[len(names) :]
            return [one[0] for one in context.run.gradients(values, [one[None] for one in given], by)]

        found = iter(OnHost.apply(compute, *context.saved_tensors, *cotangents))
        return None, None, None, *(next(found) if is_needed else None for is_needed in needed)

    @staticmethod
    def jvp(context: Any, *tangents: Any) -> Any:
        names = context.names
        given = {name: one for name, one in zip(names, tangents[3:], strict=True) if one is not None}

        def compute(*arrays: Any) -> Any:
            values = dict(zip(names, arrays[: len(names)], strict=True))
            directions = zip(given, arrays[len(names) :], strict=True)
            return [one[0] for one in context.run.tangents(values, {name: one[None] for name, one in directions})]

        return OnHost.apply(compute, *context.saved_tensors, *given.values())

    @staticmethod
    def vmap(info: Any, in_dims: Any, run: Any, names: Any, for_gradient: Any, *values: Any) -> Any:
        dims, x0, shared = in_dims[3:], values[0], not run.has_batch
        of_parameters = any(d is not None for name, d in zip(names, in_dims[3:], strict=True) if run.is_parameter(name))
        if of_parameters or x0.ndim > (1 if dims[0] is None else 2) or not shared:
            own = lambda *one: RunFunction.apply(run, names, for_gradient, *one)  # noqa: E731
            return in_turn(own, info.batch_size, dims, values)
        # Initial states become members of one ensemble.
        members = [
            value
            if run.is_parameter(name)
            else value.expand(info.batch_size, *value.shape)
            if d is None
            else value.movedim(d, 0)
            for name, value, d in zip(names, values, dims, strict=True)
        ]
        found = RunFunction.apply(run, names, for_gradient, *members)
        return found, (1,) * len(found)
