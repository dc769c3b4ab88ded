"""PyTorch as a library of arrays, of tensors of float64 on the processor, and its functions with parameters."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch.utils import _pytree

from coadjoint.short_repr import short
from coadjoint.systems.forces.base import normal_deviates
from coadjoint.systems.hamiltonians.parametrized_functions import (
    ArrayLibrary,
    ParametrizedEnergy,
    ParametrizedFeatures,
    ParametrizedFunction,
)
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.learned_forces import ParametrizedRoot, ParametrizedTorque
from coadjoint.systems.user_functions import parameters_of_function
from coadjoint.torch.autograd_functions import FixedPoint, OnHost
from coadjoint.validation import to_array


class TorchLibrary(ArrayLibrary):
    """PyTorch; times and durations are numbers of Python."""

    library, module, xp = "PyTorch", _pytree, torch
    float64_hint = ", which modules have by module.double()"
    tree_hint = "; those of a module are dict(module.named_parameters())"
    vjp, jvp = staticmethod(torch.func.vjp), staticmethod(torch.func.jvp)
    expm, product = staticmethod(torch.linalg.matrix_exp), staticmethod(torch.matmul)

    def array(self, name: str, value: Any, owner: str) -> Any:
        if hasattr(value, "named_parameters"):
            raise TypeError(f"{name} of {owner} is a module; give dict(module.named_parameters())")
        return double(f"{name} of {owner}", value, self.float64_hint)

    def numbers(self, value: Any) -> Any:
        return value if torch.is_tensor(value) else torch.from_numpy(np.array(value, dtype=np.float64))

    def result(self, value: Any) -> Any:
        return value if torch.is_tensor(value) else torch.as_tensor(value)

    def set_at(self, x: Any, places: Any, values: Any) -> Any:
        return x.index_put((torch.from_numpy(places),), values)

    def add_at(self, x: Any, places: Any, values: Any) -> Any:
        return x.index_add(0, torch.from_numpy(places), values)

    def iterate(self, body: Callable[..., Any], carry: Any, rows: Sequence[Any]) -> Any:
        for row in zip(*rows, strict=True):
            carry = body(carry, *map(self.numbers, row))
        return carry

    def fixed_point(self, prepare: Callable[..., Any], first: Any, *arguments: Any) -> Any:
        leaves, structure = _pytree.tree_flatten(arguments)

        def of_leaves(*leaves: Any) -> Callable[[Any], Any]:
            improved = prepare(*_pytree.tree_unflatten(leaves, structure))
            return lambda z: improved(z[0])[None]

        start = first.detach()[None]
        return FixedPoint.apply(of_leaves, start, start.abs(), *leaves)[0]

    def normal_deviates(self, seed: int, stream: Any, moments: Any, part: int, count: int) -> Any:
        def drawn(stream: Any, moments: Any) -> Any:
            rows = [normal_deviates(seed, int(stream), float(one), part, count) for one in moments.ravel()]
            return [np.reshape(rows, (*moments.shape, count))]

        return OnHost.apply(drawn, torch.as_tensor(stream), self.numbers(moments))[0]

    def type_of(self, function: Callable[..., Any], params: Any, n: int) -> tuple[tuple[int, ...], str]:
        with torch.no_grad():
            found = function(params, torch.zeros(n, dtype=torch.float64), 0.0)
        return tuple(found.shape), str(found.dtype).rpartition(".")[2]

    def may_hide(self, function: Callable[..., Any], params: Any, n: int) -> bool:
        return True  # nothing is known of a function before it is called

    def in_numpy(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            with torch.no_grad():
                return np.array(function(*map(self.numbers, arguments)).numpy())

        return call


def double(name: str, value: Any, hint: str = ", as by x.double()") -> Any:
    """Convert numbers to a tensor, whole numbers to float64, and refuse lower precision and other devices."""
    if not torch.is_tensor(value):
        numbers = to_array(value, name)
        value = torch.from_numpy(numbers.astype(numbers.dtype if numbers.dtype.kind == "f" else np.float64))
    if value.dtype in (torch.int32, torch.int64):
        value = value.to(torch.float64)
    if value.dtype != torch.float64:
        raise TypeError(f"{name} has the dtype {value.dtype}; give torch.float64{hint}")
    if value.device.type != "cpu":
        raise TypeError(
            f"{name} is on the device {value.device}; runs are computed on the processor, give {name}.cpu()"
        )
    return value


LIBRARY = TorchLibrary()


class OwnedParams(ParametrizedFunction):
    """A function, or a module, of PyTorch with a copy of its parameters."""

    trees = LIBRARY

    def __init__(self, function: Any, params: Any) -> None:
        if isinstance(function, torch.nn.Module):
            params = dict(function.named_parameters()) if params is None else params
            function = ModuleFunction(function, self.caller)
        elif params is None:
            raise TypeError(f"{self.caller} was given a function without params; give {self.caller}(function, params)")
        super().__init__(function, params)
        self.params = _pytree.tree_map(lambda one: one.detach().clone(), self.params)


class TorchEnergy(OwnedParams, ParametrizedEnergy):
    """An energy of PyTorch, of a function or of a module."""

    caller = "co.torch.energy"

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        found = self.function(x, params, *time)
        if not torch.is_tensor(found) or found.numel() != 1 or found.dtype != torch.float64:
            given = f"{found.dtype} of the shape {tuple(found.shape)}" if torch.is_tensor(found) else short(found)
            raise TypeError(f"the energy given to {self.caller} returns {given}; it must return one number of float64")
        return found.reshape(())


class TorchFeatures(ParametrizedFeatures):
    """An energy of features of PyTorch."""

    caller, trees = "co.torch.features", LIBRARY
    vmap, grad = staticmethod(torch.func.vmap), staticmethod(torch.func.grad)

    def __init__(self, function: Any, params: Any) -> None:
        super().__init__(function, params)
        self.params = _pytree.tree_map(lambda one: one.detach().clone(), self.params)


class TorchTorque(OwnedParams, ParametrizedTorque):
    """A torque of PyTorch."""

    caller = "co.torch.torque"


class TorchRoot(OwnedParams, ParametrizedRoot):
    """A root of a metric of PyTorch."""

    caller = "co.torch.double_bracket"


def as_it_is(module: Any) -> Any:
    """Return a module with the same tensors that keeps its modes, such as that of dropout, if these are changed."""
    found = {one: copy.copy(one) for one in module.modules()}
    for one in found.values():
        parts = {name: getattr(one, name).copy() for name in ("_parameters", "_buffers", "_modules")}
        parts["_modules"].update({name: found.get(part) for name, part in one._modules.items()})
        one.__dict__.update(parts)
    return found[module]


class ModuleFunction:
    """A module as a function of (x, params), or (x, params, t), by `torch.func.functional_call`."""

    def __init__(self, module: Any, caller: str) -> None:
        self.module, self.__name__ = as_it_is(module), type(module).__name__
        given = [one.name for one in parameters_of_function(module.forward)]
        if len(given) not in (1, 2):
            raise TypeError(f"{caller} was given a module of ({', '.join(given)}); it must be one of (x) or (x, t)")
        names = ("x", "weights", "t")[: len(given) + 1]
        self.__signature__ = inspect.Signature(
            [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in names]
        )

    def __call__(self, x: Any, params: Any, *time: Any) -> Any:
        return torch.func.functional_call(self.module, params, (x, *time))


@dataclass(frozen=True)
class TorchFunction:
    """The derivative of some order, 0 to 2, of an energy of PyTorch, as a function of arrays of NumPy."""

    function: Any
    order: int

    called_in_python: ClassVar[bool] = True
    automatic: ClassVar[bool] = True

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(self.function)

    @property
    def __name__(self) -> str:
        return str(self.function.__name__)

    def __call__(self, x: Any, *time: Any) -> npt.NDArray[np.float64]:
        """Return the derivative at x and t; raise TypeError for numbers of another type than float64."""
        y = np.asarray(x)
        if y.dtype == object:  # of a recorded function
            raise TracingError(
                "a function of PyTorch has no parts; take GaussLegendre, or co.torch.features, in co.torch.solution"
            )
        if y.dtype != np.float64:
            raise TypeError(f"a function of PyTorch is given numbers of {y.dtype}; its derivatives are of float64 only")
        time = time[: len(self.__signature__.parameters) - 1]  # loops always give it
        function: Callable[..., Any] = self.function
        for derivative in (torch.func.grad, torch.func.jacrev)[: self.order]:
            function = derivative(function)
        with torch.no_grad():
            found = function(
                torch.from_numpy(np.array(y)), *(torch.tensor(float(t), dtype=torch.float64) for t in time)
            )
        return np.array(found.numpy())


def check_outside_of_derivatives() -> None:
    """Raise TypeError inside of a derivative of `torch.func`, where no tensor has numbers that can be read."""
    try:
        torch.zeros(()).numpy()
    except RuntimeError:
        raise TypeError(
            "co.torch.solution was called inside of torch.func.grad, jvp or another derivative; call it before, and "
            "the function that it returns inside"
        ) from None
