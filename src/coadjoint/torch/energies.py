"""Energies with parameters of PyTorch, and their derivatives for NumPy."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch.utils import _pytree

from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedEnergy, ParametrizedFeatures, Trees
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.user_functions import parameters_of_function
from coadjoint.validation import to_array


class TorchTrees(Trees):
    """Parameters as trees of PyTorch."""

    library, module = "PyTorch", _pytree

    def array(self, name: str, value: Any, owner: str) -> Any:
        return double(f"{name} of {owner}", value)


class TorchEnergy(ParametrizedEnergy):
    """An energy of PyTorch, of a function or of a module."""

    caller, trees = "co.torch.energy", TorchTrees()

    def __init__(self, function: Any, params: Any) -> None:
        if isinstance(function, torch.nn.Module):
            function, params = ModuleFunction(function), own_params(function) if params is None else params
        elif params is None:
            raise TypeError(
                f"{self.caller} was given a function without params; give co.torch.energy(function, params)"
            )
        super().__init__(function, params)
        self.params = _pytree.tree_map(lambda one: one.detach().clone(), self.params)

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        found = self.function(x, params, *time)
        if not torch.is_tensor(found) or found.numel() != 1 or found.dtype != torch.float64:
            given = f"{found.dtype} of the shape {tuple(found.shape)}" if torch.is_tensor(found) else short(found)
            raise TypeError(f"the energy given to {self.caller} returns {given}; it must return one number of float64")
        return found.reshape(())


class TorchFeatures(ParametrizedFeatures):
    """An energy of features of PyTorch."""

    caller, trees = "co.torch.features", TorchTrees()
    vmap, grad = staticmethod(torch.func.vmap), staticmethod(torch.func.grad)

    def __init__(self, function: Any, params: Any) -> None:
        super().__init__(function, params)
        self.params = _pytree.tree_map(lambda one: one.detach().clone(), self.params)


def own_params(module: Any) -> dict[str, Any]:
    """Return the parameters of a module by name."""
    return dict(module.named_parameters())


class ModuleFunction:
    """A module as a function of (x, params), or (x, params, t), by `torch.func.functional_call`."""

    def __init__(self, module: Any) -> None:
        self.module, self.__name__ = module, type(module).__name__
        given = [one.name for one in parameters_of_function(module.forward)]
        if len(given) not in (1, 2):
            raise TypeError(
                f"co.torch.energy was given a module of ({', '.join(given)}); it must be one of (x) or (x, t)"
            )
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


def double(name: str, value: Any) -> Any:
    """Convert numbers to a tensor, whole numbers to float64, and refuse lower precision and other devices."""
    if not torch.is_tensor(value):
        numbers = to_array(value, name)
        value = torch.from_numpy(numbers.astype(numbers.dtype if numbers.dtype.kind == "f" else np.float64))
    if value.dtype in (torch.int32, torch.int64):
        value = value.to(torch.float64)
    if value.dtype != torch.float64:
        raise TypeError(
            f"{name} has the dtype {value.dtype}; give torch.float64, which modules have by module.double()"
        )
    if value.device.type != "cpu":
        raise TypeError(
            f"{name} is on the device {value.device}; runs are computed on the processor, give {name}.cpu()"
        )
    return value
