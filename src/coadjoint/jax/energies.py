"""Energies with parameters of JAX, and what their forces share with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from coadjoint.jax.primitives import doubles
from coadjoint.short_repr import short
from coadjoint.systems.hamiltonians.parametrized_functions import ParametrizedEnergy, Trees, function_of
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.validation import is_of_torch, is_real


class JaxTrees(Trees):
    """Parameters as pytrees of JAX."""

    library, module = "JAX", jax.tree_util

    def array(self, name: str, value: Any, owner: str) -> Any:
        if is_of_torch(value) or not (is_real(value) or hasattr(value, "dtype")):
            raise TypeError(
                f"{name} of {owner} is {short(value)}; parameters are arrays of JAX or NumPy, in lists, "
                "dictionaries and the like: keep functions in the function itself, and convert tensors of PyTorch"
            )
        return doubles({name: value})[name]


TREES = JaxTrees()


class JaxEnergy(ParametrizedEnergy):
    """An energy of JAX."""

    caller, trees = "co.jax.energy", TREES
    of_jax = True


class FeatureEnergy(JaxEnergy):
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
                    f"{self.trees.name(path)} has the shape {one.shape}; its first axis must be that of the "
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


def features_of(system: Any) -> tuple[FeatureEnergy | None, float]:
    """Return the energy of features of which that of a system is a multiple, or None, and the factor."""
    first, *others = system.hamiltonian.terms()
    function, factor = function_of(first, JaxFunction)
    whole = isinstance(function, FeatureEnergy) and not others and len(first.coordinates) == system.dim
    return (function if whole else None), factor
