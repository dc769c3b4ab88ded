"""Runs as differentiable functions of PyTorch (``co.torch``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from coadjoint.errors import refuse_others
from coadjoint.keyword_hints import not_by_position
from coadjoint.optional_packages import require_packages
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.validation import to_array

__all__ = ["function"]

TYPE_CHECKING = False


def function(
    ready: PreparedRun, t_span: tuple[float, float], save_every: int = 1, *, t_eval: Any = None
) -> Callable[..., Any]:
    """Return a run as a function of PyTorch, of the initial state and parameters of the system.

    Use it to fit parameters or initial states, alone or together with a network. ``backward``, ``torch.autograd.grad``,
    forward mode and ``torch.func.jvp`` apply to it; ``torch.func.vmap`` does not, since x0 may have an axis of members.

    Parameters
    ----------
    ready : PreparedRun
        The prepared run, with a step, of a scheme with derivatives.
    t_span, save_every, t_eval
        As in `PreparedRun.run`.

    Returns
    -------
    callable
        A function ``g(x0, *, attitude0=None, **parameters)`` of tensors of float64 on the processor, or numbers. It
        returns the states, (k, n) for x0 of shape (n,) and (k, members, n) for (members, n); for a run prepared with an
        attitude the pair of states and attitudes. The parameters are those of ``ready.parameters``, in their shapes,
        and default to these values. A system with other values is prepared in each call, and the last one is cached.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        The run has no derivatives; a tensor is not of float64, or on another device; or the callable is given
        parameters by position.
    ValueError
        For unknown names and wrong shapes.
    IntegrationError
        As in `integrate`.

    See Also
    --------
    coadjoint.PreparedRun.vjp : Gradients without PyTorch.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        body = co.prepare(co.systems.rigid_body(inertia=(1, 2, 2.5)), co.Splitting(order=4), step=0.05)
        g = co.torch.function(body, (0, 10), save_every=50)
        inertia = torch.tensor([1.1, 2.0, 2.4], dtype=torch.float64, requires_grad=True)
        g((1.0, 0.2, 0.5), inertia=inertia)[-1, 0].backward()
        inertia.grad
    """
    require_packages("co.torch.function", "torch")
    run = ParametrizedRun(ready, t_span, save_every, t_eval, "co.torch.function")

    def solution_of(x0: Any, *others: Any, attitude0: Any = None, **parameters: Any) -> Any:
        """Return the states of the run, and the attitudes if it was prepared with one; see `co.torch.function`."""
        if others:
            known = ready.parameters if ready.inputs is None else ready.inputs.indices
            raise not_by_position("the function of co.torch.function", others, known)
        import torch

        values = {name: _double(name, value) for name, value in run.arguments(x0, attitude0, parameters).items()}
        run.check({name: tuple(value.shape) for name, value in values.items()})
        if "attitude0" in values:
            d = values["attitude0"].shape[-1]
            values["attitude0"] = values["attitude0"].expand(*values["x0"].shape[:-1], d, d)
        for_gradient = torch.is_grad_enabled() and any(value.requires_grad for value in values.values())
        outputs = _run_function().apply(run, tuple(values), for_gradient, *values.values())
        return outputs if len(outputs) > 1 else outputs[0]

    return solution_of


def _double(name: str, value: Any) -> Any:
    """Convert numbers to a tensor, whole numbers to float64, and refuse lower precision and other devices."""
    import torch

    if not isinstance(value, torch.Tensor):
        numbers = to_array(value, name)
        value = torch.from_numpy(numbers.astype(numbers.dtype if numbers.dtype.kind == "f" else np.float64))
    if value.dtype in (torch.int32, torch.int64):
        value = value.to(torch.float64)
    if value.dtype != torch.float64:
        raise TypeError(f"{name} has the dtype {value.dtype}; give torch.float64")
    if value.device.type != "cpu":
        raise TypeError(
            f"{name} is on the device {value.device}; runs are computed on the processor, give {name}.cpu()"
        )
    return value


@cache
def _run_function() -> Any:
    """Return the `torch.autograd.Function` of runs."""
    import torch

    class OnHost(torch.autograd.Function):  # type: ignore[misc,name-defined]
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

    class RunFunction(torch.autograd.Function):  # type: ignore[misc,name-defined]
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

    return RunFunction


if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.torch", __all__)
