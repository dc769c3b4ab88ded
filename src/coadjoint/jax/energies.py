"""Functions of the state and of parameters that a run takes as an argument, such as the weights of a network."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from coadjoint.jax.primitives import doubles
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.user_functions import parameters_of_function, without_multiples
from coadjoint.validation import is_real

NAME = "params"
"""The argument of a run with the parameters of its energy and forces."""


class ParametrizedFunction:
    """A function of (x, params), or of (x, params, t), at the params given, which are arrays of float64."""

    caller: str
    symbol: str
    counts: tuple[int, ...] = (2, 3)
    taken = "(x, params) or (x, params, t)"

    def __init__(self, function: Callable[..., Any], params: Any) -> None:
        self.function, self.params = function, read_params(params, self.caller)
        arguments = self._arguments(function)
        self.__signature__ = inspect.Signature(arguments)
        self.__name__ = getattr(function, "__name__", type(function).__name__)

    def _arguments(self, function: Any) -> list[inspect.Parameter]:
        """Return the arguments at fixed params, which are the second one."""
        if not callable(function) or _is_of_torch(function):
            hint = "; a module of PyTorch is no function of JAX" if _is_of_torch(function) else ""
            raise TypeError(
                f"{self.caller} was given {short(function)}{hint}; give a function {self.symbol}(x, params) of JAX"
            )
        names = [one.name for one in parameters_of_function(function)]
        if names[:1] == ["params"] or len(names) not in self.counts:
            raise TypeError(
                f"{self.caller} was given a function of ({', '.join(names)}); it must be one of {self.taken}, in "
                "this order"
            )
        return [inspect.Parameter(name, inspect.Parameter.POSITIONAL_ONLY) for name in ("x", "t")[: len(names) - 1]]

    def __call__(self, x: Any, *time: Any) -> Any:
        """Return the value at the params given."""
        return self.at(self.params, x, *time)

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        """Return the value at other params."""
        return self.function(x, params, *time)

    def checked(self, params: Any) -> Any:
        """Return params of a call as arrays; raise an error if they have another structure or other shapes."""
        return params_like(self.params, params, f"as given to {self.caller}")


class ParametrizedEnergy(ParametrizedFunction):
    """An energy H(x), or H(x, t), with params."""

    caller, symbol, of_jax = "co.jax.energy", "H", True


class FeatureEnergy(ParametrizedEnergy):
    """The energy sum_k f(<a_k, x>, w_k) of directions a (features, n), and w with a first axis of features."""

    caller = "co.jax.features"
    counts, taken = (2,), "(y, params)"

    def __init__(self, function: Callable[..., Any], params: Any) -> None:
        super().__init__(function, params)
        directions, own = self.params
        if directions.ndim != 2 or not len(directions):
            raise ValueError(f"directions have the shape {directions.shape}; they must be (features, n)")
        for path, one in jax.tree.leaves_with_path(own):
            if one.shape[:1] != directions.shape[:1]:
                raise ValueError(
                    f"{_name(path)} has the shape {one.shape}; its first axis must be that of the "
                    f"{len(directions)} features"
                )

    def at(self, params: Any, x: Any, *time: Any) -> Any:
        directions, own = params
        if directions.shape[1:] != x.shape:
            raise ValueError(f"directions have {directions.shape[1]} coordinates, and states {len(x)}")
        return jnp.sum(jax.vmap(self.function)(directions @ x, own))

    def angle(self, y: Any, own: Any) -> Any:
        """Return the derivative of the function of a feature at y = <a, x>, constant along its flow."""
        return jax.grad(self.function)(y, own)


def read_params(params: Any, owner: str) -> Any:
    """Return parameters, a pytree, as arrays of float64; `owner` names them in messages."""

    def leaf(path: Any, one: Any) -> Any:
        if _is_of_torch(one) or not (is_real(one) or hasattr(one, "dtype")):
            raise TypeError(
                f"{_name(path)} of {owner} is {short(one)}; parameters are arrays of JAX or NumPy, in lists, "
                "dictionaries and the like: keep functions in the function itself, and convert tensors of PyTorch"
            )
        return doubles({_name(path): one})[_name(path)]

    return jax.tree.map_with_path(leaf, params)


def params_like(known: Any, params: Any, source: str) -> Any:
    """Return params of a call as arrays; raise an error unless they have the structure and shapes of known ones."""
    found = read_params(params, NAME)
    own, given = jax.tree.structure(known), jax.tree.structure(found)
    if own != given:
        raise ValueError(f"params have the structure {short(given)}; it must be {own}, {source}")
    for (path, mine), one in zip(jax.tree.leaves_with_path(known), jax.tree.leaves(found), strict=True):
        if mine.shape != one.shape:
            raise ValueError(f"{_name(path)} has the shape {one.shape}; it must be {mine.shape}, {source}")
    return found


def function_with_params(system: Any) -> ParametrizedFunction | None:
    """Return an energy or the function of a force of a system that has params, or None; all must have the same."""
    functions = [function_of(term)[0] for one in system.distinct for term in one.unforced.hamiltonian.terms()]
    functions += [getattr(force, "learned", None) for one in system.distinct for force in one.forces]
    found = [one for one in functions if isinstance(one, ParametrizedFunction)]
    for one in found[1:]:
        if not _same(found[0].params, one.params):
            raise TypeError(
                f"{system.name} has energies and forces of different params, of {found[0].caller} and {one.caller}; "
                "give all parameters of the run to each of them, in one pytree"
            )
    return found[0] if found else None


def _same(params: Any, others: Any) -> bool:
    """Return whether params have the same structure and numbers."""
    if jax.tree.structure(params) != jax.tree.structure(others):
        return False
    return all(map(np.array_equal, jax.tree.leaves(params), jax.tree.leaves(others)))


def features_of(system: Any) -> tuple[FeatureEnergy | None, float]:
    """Return the energy of features of which that of a system is a multiple, or None, and the factor."""
    first, *others = system.hamiltonian.terms()
    function, factor = function_of(first)
    whole = isinstance(function, FeatureEnergy) and not others and len(first.coordinates) == system.dim
    return (function if whole else None), factor


def function_of(term: Any) -> tuple[Any, float]:
    """Return the function of JAX of which the value of a term is a multiple, or None, and the factor."""
    value, outer = without_multiples(getattr(term, "value", None))
    function, inner = without_multiples(value.function if isinstance(value, JaxFunction) else None)
    return function, math.prod(float(one.factor) for one in (*inner, *outer))


def _name(path: Any) -> str:
    return NAME + jax.tree_util.keystr(path)


def _is_of_torch(value: Any) -> bool:
    return any(kind.__module__.partition(".")[0] == "torch" for kind in type(value).__mro__)
