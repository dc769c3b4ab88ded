"""Functions of tensors with their own derivatives: fixed points, to every order, functions of NumPy, and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from coadjoint.methods.numerics.fixed_point import (
    allowed_change,
    corrections,
    is_undecided,
    is_unfinished,
    sampled,
)
from coadjoint.methods.numerics.solvers import MOST_ITERATIONS


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
    least, correction, stalled, k = torch.inf, torch.inf, 0, 0
    change = torch.zeros_like(z)
    while is_unfinished(correction, stalled) and k < MOST_ITERATIONS:
        found = function(z)
        change, correction = found - z, float(corrections(torch, z, found, size).amax())
        z, stalled, least, k = found, 0 if correction < least else stalled + 1, min(least, correction), k + 1
    change, extent, own = _largest(change), _largest(z), _largest(size.expand(z.shape))
    allowed, sample = allowed_change(extent, own), 1
    entries = torch.arange(1.0, z.numel() + 1.0, dtype=z.dtype).reshape(z.shape)
    while bool(is_undecided(change, allowed, extent, own, sample).any()):
        z, change, allowed = sampled(torch, _largest, function, entries, size, sample, z, change, allowed)
        sample += 1
    return torch.where(change <= allowed, z, torch.nan)


def in_turn(function: Callable[..., Any], size: int, dims: Any, tensors: Any) -> tuple[Any, Any]:
    """Apply a function to the entries of a batch, one after the other."""
    each = [
        function(*(one if d is None else one.select(d, k) for one, d in zip(tensors, dims, strict=True)))
        for k in range(size)
    ]
    found = tuple(torch.stack(own) for own in zip(*each, strict=True))
    return found, (0,) * len(found)


class OnHost(torch.autograd.Function):  # type: ignore[misc]
    """A function of NumPy arrays, for tensors: transforms of PyTorch unwrap the arguments of `forward` alone."""

    @staticmethod
    def forward(compute: Any, *tensors: Any) -> Any:
        found = compute(*(tensor.detach().numpy() for tensor in tensors))
        # Copies: tensors may not share memory with cached runs.
        return tuple(torch.from_numpy(np.array(one)) for one in found)

    @staticmethod
    def setup_context(context: Any, inputs: Any, output: Any) -> None:
        pass

    @staticmethod
    def backward(context: Any, *cotangents: Any) -> Any:
        raise NotImplementedError("runs have first derivatives only; take differences of gradients")

    jvp = backward

    @staticmethod
    def vmap(info: Any, in_dims: Any, compute: Any, *tensors: Any) -> Any:
        return in_turn(lambda *own: OnHost.apply(compute, *own), info.batch_size, in_dims[1:], tensors)


class MemberNumbers(torch.autograd.Function):  # type: ignore[misc]
    """Numbers of the members of x0, from which their noise follows; `vmap` over x0 alone makes one ensemble."""

    @staticmethod
    def forward(x0: Any, *leaves: Any) -> Any:
        return torch.arange(math.prod(x0.shape[:-1]), dtype=torch.float64).reshape(x0.shape[:-1])

    @staticmethod
    def setup_context(context: Any, inputs: Any, output: Any) -> None:
        context.mark_non_differentiable(output)

    @staticmethod
    def backward(context: Any, *cotangents: Any) -> Any:
        return (None,) * len(context.needs_input_grad)

    @staticmethod
    def jvp(context: Any, *tangents: Any) -> Any:
        return None

    @staticmethod
    def vmap(info: Any, in_dims: Any, x0: Any, *leaves: Any) -> Any:
        # Other parameters are other ensembles, as in the compiled runs.
        own = in_dims[0] is not None and all(d is None for d in in_dims[1:])
        if own:
            return MemberNumbers.apply(x0.movedim(in_dims[0], 0)), 0
        return MemberNumbers.apply(x0 if in_dims[0] is None else x0.select(in_dims[0], 0)), None
